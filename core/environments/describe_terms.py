"""Makes docs/tasks.md, a page of every term: `python -m core.environments.describe_terms`. With the name of a
plugin, it prints the plugin's terms instead."""

import sys
from collections.abc import Iterator
from inspect import cleandoc, getdoc
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from core.environments.plugins import LISTS, Plugin, installed, list_of
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.task import TaskOptions
from core.environments.terms.term import CostTerm, RewardTerm
from core.patterns import PATTERNS

_HEAD = ("| kind | what it is | fields |", "|---|---|---|")
PAGE = Path(__file__).parents[2] / "docs" / "tasks.md"
_BEGINNING = """# Tasks: every term

<!-- `python -m core.environments.describe_terms` makes this page from the classes of terms. -->

A task is a list of terms in the job's `environment.options`. [`mjcf`](environments/mjcf.md) says how
they work together for a model of your own, [`g1` and `go1`](environments/robots.md) are tasks to begin
with, and `GET /openapi.json` has every bound. `q` are positions, `v` and `q̇` velocities, `g` the
direction of gravity in the root's frame, `c` the command, `φ` a foot's phase, `dt` a control step.
Joints, bodies and feet are named by patterns: names, or regular expressions that match whole names.
Numbers in brackets are defaults.
"""
_SHARED: dict[type[BaseModel], str] = {
    ObservationTerm: "Every observation has these; noise and bias, then scale, clip, delay and history:",
    RewardTerm: "Every reward has these, and costs are subtracted. A usual weight is a first guess for\n"
    "a robot that walks by command:",
}
# Options that are one thing and not terms, and are described where they are used.
_ELSEWHERE = {"root", "feet", "n_frames", "timestep", "solver", "iterations", "ls_iterations", "nconmax"}


def page() -> str:
    """The page, in Markdown."""
    sections = [_section(name, field) for name, field in TaskOptions.model_fields.items()]
    return "\n".join([_BEGINNING, *filter(None, sections)])


def page_of_plugin(plugin: Plugin) -> str:
    """The plugin's terms, in Markdown."""
    lines = [f"# {plugin.label}"]
    for option in LISTS:
        if terms := [term for term in plugin.terms if list_of(term) == option]:
            lines += ["", f"## `{option}`", "", *_HEAD, *map(_row, terms)]
    for row in plugin.rows:
        lines += ["", f"## `{row.id}`", "", row.description]
    return "\n".join(lines) + "\n"


def members(annotation: Any) -> Iterator[type[BaseModel]]:
    """The classes that an annotation allows, in its order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Annotated, Union, UnionType, list):
        for argument in get_args(annotation):
            yield from members(argument)


def _section(option: str, field: FieldInfo) -> str:
    classes = list(members(field.annotation))
    if option in _ELSEWHERE or not classes:
        return ""
    if option == "critic":  # It has those of the observation besides.
        observed = set(members(TaskOptions.model_fields["observation"].annotation))
        classes = [one for one in classes if one not in observed]
    lines = [f"## `{option}`", "", _escaped(field.description or _told(classes[0])), ""]
    for base, text in _SHARED.items():
        if issubclass(classes[0], base) and option != "critic":
            lines += [text, "", "| field | default | |", "|---|---|---|"]
            lines += [_field(name, one) for name, one in base.model_fields.items()] + [""]
    if "kind" not in classes[0].model_fields:
        [single] = classes
        lines += ["| field | default | |", "|---|---|---|"]
        return "\n".join([*lines, *(_field(name, one) for name, one in single.model_fields.items()), ""])
    return "\n".join([*lines, *_HEAD, *map(_row, classes), ""])


def _row(term: type[BaseModel]) -> str:
    shared = {name for base in _SHARED if issubclass(term, base) for name in base.model_fields}
    own = {name: field for name, field in term.model_fields.items() if name not in {*shared, "kind"}}
    cost = "cost: " if issubclass(term, CostTerm) else ""
    fields = "; ".join([*_weight(term), *(_briefly(name, field) for name, field in own.items())])
    return f"| `{term.model_fields['kind'].default}` | {cost}{_told(term)} | {fields} |"


def _weight(term: type[BaseModel]) -> list[str]:
    """The weight to begin with, where that is not the default."""
    usual = term.usual_weight if issubclass(term, RewardTerm) else 1.0
    return [] if usual == 1.0 else [f"`weight`, usually {usual:g}"]


def _told(term: type[BaseModel]) -> str:
    """Its docstring without sources and notes for readers of the code."""
    return _escaped(" ".join(cleandoc(getdoc(term) or "").split("\n\n")[0].split()))


def _briefly(name: str, field: FieldInfo) -> str:
    default = "" if field.is_required() else f" ({_default(field)})"
    about = f": {_escaped(field.description)}" if field.description else ""
    return f"`{name}`{default}{about}".rstrip(".")


def _field(name: str, field: FieldInfo) -> str:
    return f"| `{name}` | {_default(field)} | {_escaped(field.description or '')} |"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, BaseModel):
        return "see below"
    return "null" if default is None else f"{list(default) if isinstance(default, tuple) else default}"


def _escaped(text: str) -> str:
    return text.replace(PATTERNS, "").replace("|", "\\|").strip()


if __name__ == "__main__":
    if names := sys.argv[1:]:
        print(*(page_of_plugin(plugin) for plugin in installed() if plugin.name in names), sep="\n", end="")  # noqa: T201
    else:
        PAGE.write_text(page())
