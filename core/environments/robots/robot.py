"""A robot as the catalog knows it before its file is read; no numerical code."""

from dataclasses import dataclass

from core.environments.mjcf.edit_options import ModelEdits


@dataclass(frozen=True)
class Robot:
    """A file of a package, and how it becomes a body that can be trained.

    package: its import name. file: its place in the package. edits: what is changed before it is compiled.
    timestep: s; None: the file's. feet: in the order of terms.
    """

    name: str
    package: str
    file: str
    edits: ModelEdits
    timestep: float | None = None
    feet: tuple[str, ...] = ()
