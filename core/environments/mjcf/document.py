"""A model's XML document, read for the files that it names; entities and non-finite numbers are refused."""

from dataclasses import dataclass, field
from xml.parsers import expat

from core.errors import BadModel

# Root elements.
MJCF, URDF = "mujoco", "robot"
# Elements whose file is also a document.
INCLUDING = ("include", "model")
_MAX_ELEMENTS, _MAX_DEPTH = 200_000, 200
_NOT_FINITE = {"nan", "inf", "infinity"}
# Attributes that may be one of these words without being a number.
_WORDS = {"name", "class", "childclass", "model", "filename", "file"}


@dataclass(frozen=True)
class FileReference:
    """A file that an element names."""

    element: str
    file: str


@dataclass
class Document:
    """root: the outermost element. folders: where the compiler looks for files."""

    root: str = ""
    references: list[FileReference] = field(default_factory=list[FileReference])
    folders: list[str] = field(default_factory=list[str])


class _Refused(Exception):
    """Raised while a document is being parsed."""


def parse(name: str, body: bytes) -> Document:
    """The names in the document. Raises BadModel if it is not XML, or declares a type or entities.

    Without a document type only XML's own five entities exist, so nothing can be expanded.
    """
    document = Document()
    parser = expat.ParserCreate()
    depth, count = 0, 0

    def refuse_type(*_: object) -> None:
        raise _Refused("it declares a document type (<!DOCTYPE); entities are not allowed")

    def begin(element: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MAX_DEPTH or count > _MAX_ELEMENTS:
            raise _Refused(
                f"it has more than {_MAX_ELEMENTS:,} elements, or more than {_MAX_DEPTH} nested ones"
            )
        document.root = document.root or element
        for attribute, value in attributes.items():
            _note(document, element, attribute, value)

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse_type
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(body, True)
    except _Refused as refusal:
        raise BadModel(f"{name}, line {parser.CurrentLineNumber}: {refusal}.") from None
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise BadModel(f"{name} is not XML: {error}.") from None
    return document


def _note(document: Document, element: str, attribute: str, value: str) -> None:
    if attribute.startswith("file") and value:
        document.references.append(FileReference(element, value))
    elif attribute in ("meshdir", "texturedir", "assetdir"):
        document.folders.append(value)
    elif attribute not in _WORDS:
        wrong = [word for word in value.split() if word.lstrip("+-").lower() in _NOT_FINITE]
        if wrong:
            raise _Refused(f"{attribute} of <{element}> is {wrong[0]}, but must be a finite number")
