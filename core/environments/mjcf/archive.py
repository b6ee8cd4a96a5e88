"""A model's uploaded file: one XML, or a zip of it and its meshes and textures.

The confined processes that read models check it, before they unpack it and before MuJoCo sees it.
"""

import io
import posixpath
import stat
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from uuid import uuid4

from core.environments.mjcf.document import INCLUDING, MJCF, URDF, Document, parse
from core.environments.mjcf.main_document import main_of, named_main, read_from
from core.errors import BadModel

MAX_FILES = 1000
MAX_DOCUMENTS = 50
MAX_REFERENCES, MAX_FOLDERS = 5000, 8
MAX_FILE_BYTES = 64 * 2**20
MAX_TOTAL_BYTES = 256 * 2**20
MAX_XML_BYTES = 16 * 2**20
# No mesh or texture compresses this well; a small file that does is harmless.
_MAX_RATIO, _HARMLESS_BYTES = 100, 2**20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DOCUMENTS = (".xml", ".mjcf", ".urdf")
# MuJoCo reads a main document by these endings alone, in small letters.
_KNOWN_ENDINGS = (".xml", ".urdf")
# The longest name that every file system accepts.
_MAX_NAME_BYTES = 255
_ZIP = b"PK\x03\x04"
# zipfile raises these for a file that is not a zip, or is damaged.
_BROKEN = (zipfile.BadZipFile, EOFError, OSError, RuntimeError, ValueError)
_LITTER = ("__MACOSX", ".DS_Store")


@dataclass(frozen=True)
class ModelArchive:
    """main: the main document's path; is_urdf: whether it is URDF. names: of all files in the archive."""

    body: bytes
    main: str
    is_urdf: bool
    names: tuple[str, ...]

    def unpack(self, folder: Path) -> Path:
        """Write the files below an empty folder; returns the path of the main document."""
        for name in self.names:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(_content(self.body, name))
        return self._readable(folder)

    def _readable(self, folder: Path) -> Path:
        """The main document, by a name with an ending that MuJoCo knows."""
        if self.main.endswith(_KNOWN_ENDINGS):
            return folder / self.main
        ending = ".urdf" if self.is_urdf else ".xml"
        copy = (folder / self.main).with_name(f"{PurePosixPath(self.main).stem[:50]}-{uuid4().hex}{ending}")
        (folder / self.main).rename(copy)
        return copy


def is_zip(body: bytes) -> bool:
    return body.startswith(_ZIP)


def examine(body: bytes) -> ModelArchive:
    """The file's content. Raises BadModel if it may not be unpacked, or lacks files that it names."""
    if not is_zip(body):
        if len(body) > MAX_XML_BYTES:
            raise BadModel(f"The document has {len(body):,} bytes; {MAX_XML_BYTES:,} are allowed.")
        document = parse("the document", body)
        main = "model.xml"
        if document.references:
            raise BadModel(
                f"The document names the file {document.references[0].file!r}: send both in a zip."
            )
        _check_root(main, document)
        return ModelArchive(body, main, document.root == URDF, (main,))
    entries, comment = _entries(body)
    names = [entry.filename for entry in entries]
    sizes = {entry.filename: entry.file_size for entry in entries if _is_document(entry.filename)}
    if len(sizes) > MAX_DOCUMENTS:
        raise BadModel(f"The zip has {len(sizes)} documents; {MAX_DOCUMENTS} are allowed.")
    documents = {name: _read(name, body) for name in sizes}
    main = main_of(documents, sizes, named_main(comment))
    surely, possibly = read_from(main, documents)
    # Files that the main document does not reach are neither read nor checked.
    reached = {name: _sound(documents[name]) for name in documents if name in possibly}
    _check_root(main, reached[main])
    _check_references(main, reached, surely, names)
    return ModelArchive(body, main, reached[main].root == URDF, tuple(names))


def _is_document(name: str) -> bool:
    return name.lower().endswith(_DOCUMENTS)


def _read(name: str, body: bytes) -> Document | BadModel:
    try:
        return parse(name, _content(body, name))
    except BadModel as error:
        return error


def _sound(document: Document | BadModel) -> Document:
    if isinstance(document, BadModel):
        raise document
    return document


def _content(body: bytes, name: str) -> bytes:
    if not is_zip(body):
        return body
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive, archive.open(name) as file:
            # zipfile never reads more than the announced size.
            return file.read(MAX_FILE_BYTES)
    except (*_BROKEN, zlib.error) as error:
        raise BadModel(f"{name!r} cannot be unpacked: {error}.") from None


def _entries(body: bytes) -> tuple[list[zipfile.ZipInfo], bytes]:
    """The files in a zip, and its comment. Raises BadModel for anything that would be harmful to unpack."""
    if body.count(b"PK\x01\x02") > 2 * MAX_FILES:  # An entry's signature; a mesh may hold it, too.
        raise BadModel(f"The zip has more than {MAX_FILES:,} entries.")
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            entries, comment = archive.infolist(), archive.comment
    except _BROKEN as error:
        raise BadModel(f"The zip cannot be read: {error}.") from None
    if len(entries) > MAX_FILES:
        raise BadModel(f"The zip has {len(entries):,} entries; {MAX_FILES:,} are allowed.")
    files = [entry for entry in entries if not entry.is_dir() and not _is_litter(entry.filename)]
    for entry in entries:
        _check_entry(entry)
    total, packed = sum(entry.file_size for entry in files), max(1, len(body))
    if total > MAX_TOTAL_BYTES:
        raise BadModel(f"Unpacked, the zip has {total:,} bytes; {MAX_TOTAL_BYTES:,} are allowed.")
    if total > _HARMLESS_BYTES and total / packed > _MAX_RATIO:
        raise BadModel(f"The zip unpacks to {total / packed:.0f} times its size; {_MAX_RATIO} are allowed.")
    names = [entry.filename for entry in files]
    folded = [name.casefold() for name in names]
    if twice := next((name for name in names if folded.count(name.casefold()) > 1), None):
        raise BadModel(f"The zip has {twice!r} more than once.")
    folders = {str(folder) for name in names for folder in PurePosixPath(name).parents}
    if both := next((name for name in names if name in folders), None):
        raise BadModel(f"The zip has {both!r} as a file and as a folder.")
    return files, comment


def _is_litter(name: str) -> bool:
    return any(part in _LITTER for part in name.split("/"))


def _check_entry(entry: zipfile.ZipInfo) -> None:
    name = entry.filename
    parts = name.removesuffix("/").split("/")
    if name.startswith("/") or "\\" in name or ":" in name or not name.isprintable():
        raise BadModel(f"{name!r} is not a path inside the archive.")
    if any(part in ("", ".", "..") for part in parts) or len(parts) > 20:
        raise BadModel(f"{name!r} is not a path inside the archive.")
    if any(len(part.encode()) > _MAX_NAME_BYTES for part in parts):
        raise BadModel(f"{name[:60]!r}… is too long: {_MAX_NAME_BYTES} bytes are allowed in a file's name.")
    kind = stat.S_IFMT(entry.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise BadModel(f"{name!r} is a link or a device; only files and folders are allowed.")
    if entry.flag_bits & 1:
        raise BadModel(f"{name!r} is encrypted.")
    if entry.compress_type not in _METHODS:
        raise BadModel(f"{name!r} is not compressed with `deflate`.")
    limit = MAX_XML_BYTES if _is_document(name) else MAX_FILE_BYTES
    if entry.file_size > limit:
        raise BadModel(f"{name!r} has {entry.file_size:,} bytes; {limit:,} are allowed.")


def _check_root(name: str, document: Document) -> None:
    if document.root not in (MJCF, URDF):
        raise BadModel(f"{name}: its root is <{document.root[:60]}>, but MJCF's is <mujoco>, URDF's <robot>.")


def _check_references(
    main: str, documents: Mapping[str, Document], surely: set[str], names: list[str]
) -> None:
    """Raises BadModel unless every file that a document names lies in the archive, whichever folder MuJoCo
    starts from; and is there, if MuJoCo surely reads the document."""
    folders = ["", *{folder for document in documents.values() for folder in document.folders}]
    if len(folders) > MAX_FOLDERS:
        raise BadModel(f"The documents look for files in {len(folders)} folders; {MAX_FOLDERS} are allowed.")
    if (number := sum(len(document.references) for document in documents.values())) > MAX_REFERENCES:
        raise BadModel(f"The documents name {number:,} files; {MAX_REFERENCES:,} are allowed.")
    known = set(names)
    # Paths in an included document may start from the folder of the main document or of any included one.
    least_deep = min(_depth(name) for name in documents)
    for name, document in documents.items():
        bases = {posixpath.dirname(main), posixpath.dirname(name)}
        depth = _depth(main) if name == main else least_deep
        for reference in document.references:
            is_document = reference.element in INCLUDING
            if is_document and not _is_document(reference.file):
                raise BadModel(
                    f"{name} includes {reference.file!r}: a document's name must end with "
                    f"{', '.join(_DOCUMENTS[:-1])} or {_DOCUMENTS[-1]}."
                )
            if reference.element == "model" and not reference.file.endswith(_KNOWN_ENDINGS):
                raise BadModel(
                    f"{name} attaches the model {reference.file!r}: MuJoCo reads it only if its name ends "
                    f"with {' or '.join(_KNOWN_ENDINGS)}, in small letters."
                )
            file = reference.file.removeprefix("package://")
            # The compiler's folders are those of meshes and textures.
            starts = [""] if reference.element == "include" else folders
            for folder in starts:
                _check_inside(name, folder, file, depth)
            # The basename alone counts with the compiler's `strippath`, and in every URDF.
            paths = {
                posixpath.normpath(posixpath.join(base, folder, said))
                for base in bases
                for folder in starts
                for said in (file, posixpath.basename(file))
            }
            if name in surely and not known.intersection(paths):
                raise BadModel(f"{name} names the file {reference.file!r}, which is not in the zip.")


def _depth(name: str) -> int:
    """How many folders of the archive the file is below."""
    return name.count("/")


def _check_inside(name: str, folder: str, file: str, depth: int) -> None:
    """Raises BadModel if the path leaves the archive when it starts in a folder of this depth."""
    climbs = posixpath.normpath(posixpath.join(folder, file)).split("/").count("..")
    for said in (file, folder):
        if said.startswith("/") or "\\" in said or ":" in said or climbs > depth:
            raise BadModel(f"{name} names {said!r}, which is outside the archive.")
