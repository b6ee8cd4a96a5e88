"""Terms and bodies of other packages, which an entry point of the group `gaitway.environments` names.

The name of the entry point comes before those of its terms and bodies: `mylab/soft_steps`, `mylab/dog`. So no
name of ours can be in their way, today or later, and a job says whose they are.
"""

import hashlib
import json
import re
import sys
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import getfile
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import structlog
from pydantic import Field, TypeAdapter, create_model

from core.bounds import LONGEST_NAME
from core.environments.info import Device, EnvironmentInfo
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_options import HOME, ModelEdits
from core.environments.robots.info import ROBOTS, robot_page
from core.environments.robots.robot import Robot
from core.environments.terms.actions import ACTIONS
from core.environments.terms.commands import COMMANDS, EVENTS
from core.environments.terms.inventory import OF_PLUGINS, Inventory
from core.environments.terms.metrics import METRICS
from core.environments.terms.rewards import Healthy
from core.environments.terms.task import TaskOptions
from core.environments.terms.term import Kinds, Term
from core.environments.terms.terminations import TERMINATIONS
from core.environments.terms.vocabulary import OBSERVATIONS, REWARDS
from core.nearest import nearest

log = structlog.get_logger()
GROUP = "gaitway.environments"
# Beside a plugin's module; `gaitway plugins NAME --describe` makes it.
TABLE = "inventories.json"
LISTS: Mapping[str, Kinds] = {
    "reward": REWARDS,
    "observation": OBSERVATIONS,
    "termination": TERMINATIONS,
    "metrics": METRICS,
    "action": ACTIONS,
    "command": COMMANDS,
    "events": EVENTS,
}
# Names of what environments and workers' packages are called already.
_TAKEN = {"gaitway", "playground", "brax", "biorobot", "dm_control", "llvmlite", "mjlab", "warp"}
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
# Code that the API does without: it makes each of its processes hundreds of megabytes larger.
_HEAVY = ("jax", "mujoco", "numpy", "tensorflow", "torch")
_MOST_TOLD = 600


@dataclass(frozen=True)
class Body:
    """A body of a package. file: its MJCF, beside the module. options: those of a job on `mjcf` but for the
    model: `edits`, and the terms that a job on this body begins with. tuned: hyperparameters that such a job
    takes unless it says otherwise, by algorithm and device; what they do not say is as on `mjcf`."""

    name: str
    file: str
    description: str
    options: Mapping[str, Any]
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]] = field(
        default_factory=dict[str, Mapping[Device, Mapping[str, Any]]]
    )


@dataclass(frozen=True)
class Plugin:
    """An entry point. package, version: of the distribution that has it. code: a few digits of the hash of
    its module, of what defines its terms, and of its bodies' files: an editable installation changes these
    and keeps its version. problem: why it could not be loaded; then it has nothing. loads: the heavy modules
    that it imported."""

    name: str
    package: str
    version: str
    code: str = ""
    module: ModuleType | None = field(default=None, repr=False)
    terms: tuple[type[Term], ...] = ()
    rows: tuple[EnvironmentInfo, ...] = ()
    problem: str = ""
    loads: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The distribution and its version."""
        return f"{self.package} {self.version}"

    @property
    def exact_version(self) -> str:
        """The version, and the hash of the code."""
        return f"{self.version} (code {self.code})"

    @property
    def kinds(self) -> list[str]:
        """Those of its terms."""
        return [kind_of(term) for term in self.terms]


class BadPlugin(Exception):
    """A sentence on what is wrong with a plugin's terms or bodies."""


def kind_of(term: type[Term]) -> str:
    return str(term.model_fields["kind"].default)


def list_of(term: type[Term]) -> str:
    """The option of a task that holds terms of this class. Raises BadPlugin."""
    for option, kinds in LISTS.items():
        if issubclass(term, kinds.base):
            return option
    bases = ", ".join(kinds.base.__name__ for kinds in LISTS.values())
    raise BadPlugin(f"The term {term.__name__} has none of the bases {bases}.")


def installed() -> tuple[Plugin, ...]:
    """All plugins here, loaded; a broken one says why."""
    return load(entry_points(group=GROUP))


def load(points: Iterable[EntryPoint]) -> tuple[Plugin, ...]:
    """The plugins of these entry points, whose terms tasks may name from now on. Nothing that a plugin does
    makes this fail."""
    ordered = sorted(points, key=lambda point: (point.name, point.value))
    times = Counter(point.name for point in ordered)
    return tuple(_loaded(point, times[point.name] > 1) for point in ordered)


def _loaded(point: EntryPoint, is_double: bool) -> Plugin:
    here = _described(point)
    before = [kinds.added for kinds in LISTS.values()]
    known = set(sys.modules)
    try:
        if not _NAME.fullmatch(point.name) or point.name in _TAKEN:
            raise BadPlugin("Its entry point needs another name: letters, digits and _, and none of ours.")
        if is_double:
            raise BadPlugin("Several installed packages have an entry point of this name.")
        module = point.load()
        if not isinstance(module, ModuleType):
            raise BadPlugin(f"The entry point must name a module, and {point.value} is none.")
        loads = tuple(name for name in _HEAVY if name in sys.modules and name not in known)
        here = replace(here, module=module, loads=loads)
        terms = tuple(_terms(point.name, module))
        for term in terms:
            LISTS[list_of(term)].added += (term,)
        if terms:
            build_again()
        rows = tuple(_rows(point, module))
        return replace(here, terms=terms, rows=rows, code=_code(module, terms))
    except (Exception, SystemExit) as error:
        hold_only(before)
        return replace(here, problem=_told(error))


def log_each(plugins: Iterable[Plugin]) -> None:
    """One line of log for each plugin, at the start of a process."""
    for plugin in plugins:
        facts = {"plugin": plugin.name, "package": plugin.package, "version": plugin.version}
        if plugin.problem:
            log.error("plugin_failed", problem=plugin.problem, **facts)
        else:
            log.info("plugin_loaded", kinds=plugin.kinds, bodies=[row.id for row in plugin.rows], **facts)
        if plugin.loads:
            log.warning("plugin_is_heavy", loads=list(plugin.loads), **facts)


def _described(point: EntryPoint) -> Plugin:
    distribution = point.dist
    package, version = (distribution.name, distribution.version) if distribution else (point.module, "?")
    return Plugin(point.name, package, version)


def hold_only(added: Sequence[tuple[type[Term], ...]]) -> None:
    """Take back what was added since. added: what each of `LISTS` had."""
    if added != [kinds.added for kinds in LISTS.values()]:
        for kinds, had in zip(LISTS.values(), added, strict=True):
            kinds.added = had
        build_again()


def build_again() -> None:
    """Let the models that hold terms see those that were added."""
    for model in (Healthy, TaskOptions, *_descendants(TaskOptions)):
        model.model_rebuild(force=True)


def _descendants(model: type[Any]) -> Iterator[type[Any]]:
    for child in model.__subclasses__():
        yield child
        yield from _descendants(child)


def _terms(plugin: str, module: ModuleType) -> Iterator[type[Term]]:
    """The classes of terms that the module holds, except ours. Raises BadPlugin."""
    kinds: set[tuple[str, str]] = set()
    for value in dict.fromkeys(value for value in vars(module).values() if isinstance(value, type)):
        if not issubclass(value, Term) or "kind" not in value.model_fields or _is_ours(value):
            continue
        kind, option = kind_of(value), list_of(value)
        if not re.fullmatch(rf"{plugin}/[a-z][a-z0-9_]{{0,39}}", kind):
            raise BadPlugin(f'The kind of {value.__name__} is {kind!r}: call it "{plugin}/…", in lower case.')
        if (option, kind) in kinds:
            raise BadPlugin(f"Two terms of `{option}` are of the kind {kind}.")
        for method in LISTS[option].methods:
            if getattr(value, method, None) is getattr(LISTS[option].base, method, None):
                raise BadPlugin(f"The {value.noun} {value.__name__} has no `{method}`.")
        TypeAdapter(value).json_schema()
        kinds.add((option, kind))
        yield value


def _is_ours(term: type[Term]) -> bool:
    return term.__module__.partition(".")[0] == "core"


def _rows(point: EntryPoint, module: ModuleType) -> Iterator[EnvironmentInfo]:
    """The rows of the module's bodies. Raises BadPlugin."""
    bodies = bodies_of(module)
    table = _table(module) if bodies else {}
    for body in bodies:
        robot, options = robot_of(point.name, body, module), _options(body)
        if table.get(body.name, {}).get("of") != digest_of(robot):
            raise BadPlugin(
                f"{TABLE} lacks the body {body.name} as it is now: `gaitway plugins {point.name} --describe` "
                "writes that file beside the module, where MuJoCo is installed."
            )
        parts = Inventory.model_validate(table[body.name]["parts"])
        if found := problems(options(), parts):
            raise BadPlugin(f"The options of the body {body.name}: {found[0].detail}")
        ROBOTS[robot.name], OF_PLUGINS[robot.name] = robot, parts
        row = robot_page(robot, options, body.description, tuned=body.tuned)
        if body.tuned and (wrong := import_module("core.algorithms.catalog").wrong_tuned(row)):
            raise BadPlugin(f"The body {body.name}: {wrong}")
        yield row


def bodies_of(module: ModuleType) -> list[Body]:
    """Raises BadPlugin."""
    bodies = list({id(one): one for one in vars(module).values() if isinstance(one, Body)}.values())
    for name, times in Counter(body.name for body in bodies).items():
        if times > 1 or not _NAME.fullmatch(name):
            raise BadPlugin(f"The name of the body {name!r} must be its own, in lower case, digits and _.")
    return bodies


def robot_of(plugin: str, body: Body, module: ModuleType) -> Robot:
    """The body before its file is read. Raises BadPlugin."""
    path = _folder(module) / body.file
    if not path.is_file():
        raise BadPlugin(f"The body {body.name} has no file {body.file} beside the module.")
    edits = ModelEdits.model_validate(body.options.get("edits", {}))
    return Robot(f"{plugin}/{body.name}", module.__name__.partition(".")[0], str(path), edits)


def digest_of(robot: Robot) -> str:
    """The hash of what an inventory is made from: the file and the edits."""
    edits = robot.edits.model_dump_json().encode()
    return hashlib.sha256(Path(robot.file).read_bytes() + edits).hexdigest()


def _options(body: Body) -> type[TaskOptions]:
    """The class of the body's options, with its own as defaults. Raises ValidationError."""
    document = {name: value for name, value in body.options.items() if name != "edits"}
    task = TaskOptions.model_validate(document)
    edits = body.options.get("edits", {})
    if edits.get("pose") is not None and task.reset.keyframe is None and task.reset.qpos is None:
        reset = task.reset.model_copy(update={"keyframe": HOME})
        task = task.model_copy(update={"reset": reset})
        document["reset"] = reset
    fields: dict[str, Any] = {}
    for name in document:
        had = TaskOptions.model_fields[name]
        annotation: Any = Annotated[(had.annotation, *had.metadata)] if had.metadata else had.annotation
        fields[name] = (annotation, Field(default=getattr(task, name), description=had.description))
    return create_model(body.name, __base__=TaskOptions, __doc__=body.description, **fields)


def _table(module: ModuleType) -> dict[str, Any]:
    path = _folder(module) / TABLE
    return json.loads(path.read_text()) if path.is_file() else {}


def _folder(module: ModuleType) -> Path:
    return Path(getfile(module)).parent


def table_path(module: ModuleType) -> Path:
    """Where the inventories of a plugin's bodies are."""
    return _folder(module) / TABLE


def _code(module: ModuleType, terms: Sequence[type[Term]]) -> str:
    classes = {
        part for term in terms for part in term.__mro__ if issubclass(part, Term) and not _is_ours(part)
    }
    files = {Path(getfile(part)) for part in (module, *classes)}
    files |= {_folder(module) / body.file for body in bodies_of(module)}
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files))).hexdigest()[:8]


def _told(error: BaseException) -> str:
    """The error in one line; with its place, unless it is ours."""
    if isinstance(error, BadPlugin):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    words = " ".join(f"{type(error).__name__}: {error}".split())[:_MOST_TOLD]
    theirs = [frame for frame in frames if "importlib" not in frame.filename and frame.filename != __file__]
    return f"{words} ({Path(theirs[-1].filename).name}, line {theirs[-1].lineno})" if theirs else words


def named_in(environment_id: str, options: Any) -> set[str]:
    """The entry points whose bodies and terms a job names, whether they are here or not."""
    names = [environment_id, *_kinds(options)]
    prefixes = (name.partition("/")[0] for name in names if "/" in name)
    return {prefix for prefix in prefixes if _NAME.fullmatch(prefix) and prefix not in _TAKEN}


def _kinds(document: Any) -> Iterator[str]:
    values: Iterable[Any] = ()
    if isinstance(document, Mapping):
        if isinstance(kind := document.get("kind"), str):
            yield kind
        values = document.values()
    elif isinstance(document, list):
        values = document
    for value in values:
        yield from _kinds(value)


def why_unknown(name: str, plugins: Sequence[Plugin]) -> str:
    """A sentence on a kind or body `plugin/name` that is not known here."""
    shown, prefix = name[:LONGEST_NAME], name.partition("/")[0]
    plugin = next((one for one in plugins if one.name == prefix), None)
    if plugin is None:
        return f"There is no {shown!r}: no package that is installed here has the entry point {prefix!r}."
    if plugin.problem:
        return f"There is no {shown!r}: {plugin.label} could not be loaded here. {plugin.problem}"
    known = [*plugin.kinds, *(row.id for row in plugin.rows)]
    near = nearest(name, known)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return (
        f"There is no {shown!r} in {plugin.label}, which is installed here; it has {', '.join(known)}.{hint}"
    )
