"""Which document of a zip is the model, and which others it reaches.

A zip's comment may name the main document (`with_main`), so that the file alone says what it means.
"""

import posixpath
from collections.abc import Iterable, Iterator, Mapping

from core.environments.mjcf.document import INCLUDING, MJCF, URDF, Document
from core.errors import BadModel

MAX_MAIN_CHARACTERS = 1000
_COMMENT = b"gaitway main: "
# Names of the main document, if several are included by no other.
_MAIN = ("scene", "model")
_MOST_LISTED = 10
# The end of a zip's directory: its mark, its length, and where the length of the comment stands in it.
_END, _END_BYTES, _COMMENT_LENGTH_AT, _MOST_COMMENT = b"PK\x05\x06", 22, 20, 2**16 - 1


def with_main(end: bytes, main: str) -> bytes | None:
    """The end of a zip with a comment that names its main document; None where it is no end of a zip.

    end: the file's last bytes, from which the whole end of the directory is found.
    """
    at = end.rfind(_END)
    if at < 0 or len(end) - at < _END_BYTES:
        return None
    comment = _COMMENT + main.encode()
    length = len(comment).to_bytes(2, "little")
    return end[: at + _COMMENT_LENGTH_AT] + length + comment


def named_main(comment: bytes) -> str | None:
    """The document that a zip's comment names."""
    said = comment.removeprefix(_COMMENT).decode(errors="replace")
    return said[:MAX_MAIN_CHARACTERS] if comment.startswith(_COMMENT) else None


def main_of(
    documents: Mapping[str, Document | BadModel], sizes: Mapping[str, int], wanted: str | None
) -> str:
    """The path of the main document. wanted: its path, or the end of it; if None, no other includes it.

    documents: by path; one that cannot be read is a BadModel. Raises BadModel, with the candidates, if it is
    not clear.
    """
    if wanted is not None:
        found = [name for name in documents if name == wanted] or [
            name for name in documents if name.endswith("/" + wanted)
        ]
        if len(found) == 1:
            return found[0]
        what = f"has {len(found)} documents" if found else "has no document"
        raise BadModel(f"The zip {what} {wanted[:200]!r}; it has {_listed(found or documents, sizes)}.")
    included = {name for one in documents for name in _may_include(one, documents)}
    free = [name for name, document in documents.items() if name not in included and _is_model(document)]
    if len(free) == 1:
        return free[0]
    if not free:
        raise BadModel("The zip has no .xml, .mjcf or .urdf that no other includes.")
    for word in _MAIN:
        named = [name for name in free if posixpath.basename(name).partition(".")[0].lower() == word]
        least_deep = min((name.count("/") for name in named), default=0)
        if len(highest := [name for name in named if name.count("/") == least_deep]) == 1:
            return highest[0]
    more = f" (others include {_listed(included, sizes)})" if included else ""
    raise BadModel(
        f"The zip has {len(free)} documents that no other includes: {_listed(free, sizes)}{more}. Say which "
        "one is the model: `gaitway models add --main FILE`, `main` of POST /models, or the page's field."
    )


def read_from(main: str, documents: Mapping[str, Document | BadModel]) -> tuple[set[str], set[str]]:
    """The documents that MuJoCo reads if it begins with this one; and those that it may, whichever folder it
    starts from."""
    bases, read, more = {posixpath.dirname(main)}, set[str](), {main}
    while more:
        read |= more
        bases |= {posixpath.dirname(name) for name in more}
        named = [reference for name in read for reference in _included_by(name, documents)]
        paths = {posixpath.normpath(posixpath.join(base, said)) for base in bases for said in named}
        more = (paths & documents.keys()) - read
    possible, more = set[str](), {main}
    while more:
        possible |= more
        more = {name for one in more for name in _may_include(one, documents)} - possible
    return read, possible | read


def _included_by(name: str, documents: Mapping[str, Document | BadModel]) -> Iterator[str]:
    document = documents[name]
    if isinstance(document, Document):
        yield from (one.file for one in document.references if one.element in INCLUDING)


def _may_include(name: str, documents: Mapping[str, Document | BadModel]) -> list[str]:
    """The documents that this one may include, whichever folder its paths start from."""
    meant = {posixpath.basename(said) for said in _included_by(name, documents)}
    return [other for other in documents if posixpath.basename(other) in meant]


def _is_model(document: Document | BadModel) -> bool:
    """A package.xml of ROS, say, is none; a document that cannot be read may be one."""
    return isinstance(document, BadModel) or document.root in (MJCF, URDF)


def _listed(names: Iterable[str], sizes: Mapping[str, int]) -> str:
    """The largest first, with their sizes."""
    ordered = sorted(names, key=lambda name: (-sizes[name], name))
    more = f", and {len(ordered) - _MOST_LISTED} more" if len(ordered) > _MOST_LISTED else ""
    return ", ".join(f"{name[:200]} ({sizes[name]:,} bytes)" for name in ordered[:_MOST_LISTED]) + more
