"""A robot as the catalog knows it before its file is read; no numerical code."""

from dataclasses import dataclass

from core.environments.mjcf.edit_options import ModelEdits


@dataclass(frozen=True)
class Robot:
    """A file of a package, and how it becomes a body that can be trained.

    package: its import name; it is never imported. file: its place in the package. edits: what is changed
    before it is compiled. timestep: s. root: the body with the free joint. feet: in the order of terms.
    """

    name: str
    package: str
    file: str
    edits: ModelEdits
    timestep: float
    root: str
    feet: tuple[str, ...]
