"""All environments.

To add one, write its page and add its import and its member of `BUILT_IN` here. What terms cannot say is a
package with `info` and `environment`.
"""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pydantic import ValidationError

from core.bounds import MOST_PROBLEMS
from core.documents import Strict
from core.environments.brittle_star.info import INFOS as BRITTLE_STARS
from core.environments.dm_control.corridor.info import INFO as CORRIDOR
from core.environments.dm_control.rodent.info import INFO as RODENT
from core.environments.external.brax import info as brax_registry
from core.environments.external.playground import info as playground
from core.environments.info import EnvironmentInfo
from core.environments.locomotion.ant import ANT
from core.environments.locomotion.half_cheetah import HALF_CHEETAH
from core.environments.locomotion.humanoid import HUMANOID
from core.environments.locomotion.inverted_pendulum import INVERTED_PENDULUM
from core.environments.locomotion.planar import HOPPER, WALKER2D
from core.environments.locomotion.reacher.info import INFO as REACHER
from core.environments.mjcf.info import INFO as MJCF
from core.environments.plugins import Plugin, installed, named_in, why_unknown
from core.environments.robots.info import INFOS as ROBOTS
from core.environments.terms.actions import DecoderAction
from core.errors import EnvironmentNotFound, Problem, Rejected
from core.nearest import nearest

if TYPE_CHECKING:
    from core.environments.environment import Environment
    from core.physics.engine import EngineBuilder

BUILT_IN: dict[str, EnvironmentInfo] = {
    info.id: info
    for info in (
        *(ANT, HALF_CHEETAH, HOPPER, WALKER2D, HUMANOID, RODENT, CORRIDOR, INVERTED_PENDULUM, REACHER),
        *BRITTLE_STARS,
        *ROBOTS,
        MJCF,
    )
}
PLUGINS = installed()
# Ours first, then those of other packages, under the name of the package.
ENVIRONMENTS: dict[str, EnvironmentInfo] = BUILT_IN | {
    info.id: info
    for info in (
        *(row for plugin in PLUGINS for row in plugin.rows),
        *playground.INFOS,
        *brax_registry.INFOS,
    )
}
# The environments of those packages that no worker can load, with the reason.
CANNOT: dict[str, str] = playground.CANNOT | brax_registry.CANNOT


def find(environment_id: str) -> EnvironmentInfo:
    """The environment's row. Raises EnvironmentNotFound, with the nearest name and all known ones."""
    if environment_id in ENVIRONMENTS:
        return ENVIRONMENTS[environment_id]
    if environment_id in CANNOT:
        detail = f"{environment_id!r} is not available here: {CANNOT[environment_id]}."
    elif named_in(environment_id, ()):
        detail = why_unknown(environment_id, PLUGINS)
    else:
        near = _nearest(environment_id)
        suggestion = f" Did you mean {near!r}?" if near else ""
        if near in CANNOT:
            suggestion = f" {near!r} is like it, but is not available here: {CANNOT[near]}."
        detail = (
            f"There is no environment {environment_id!r}.{suggestion} There are {_known(environment_id)}."
        )
    raise EnvironmentNotFound(detail, environment=environment_id, environments=list(ENVIRONMENTS))


def plugin_named(name: str) -> Plugin | None:
    """The plugin of this entry point, if it could be loaded here."""
    return next((plugin for plugin in PLUGINS if plugin.name == name and not plugin.problem), None)


def plugin_versions(environment_id: str, options: Mapping[str, object]) -> dict[str, str]:
    """The distributions here whose terms or bodies a job names, each with its version and its code's hash."""
    plugins = map(plugin_named, sorted(named_in(environment_id, options)))
    return {plugin.package: plugin.exact_version for plugin in plugins if plugin is not None}


def _nearest(environment_id: str) -> str | None:
    """The most similar id; Playground's are also found by their bare names."""
    names = {name.removeprefix("playground/").lower(): name for name in (*CANNOT, *ENVIRONMENTS)}
    names |= {name.lower(): name for name in (*CANNOT, *ENVIRONMENTS)}
    near = nearest(environment_id.lower(), names)
    return names[near[0]] if near else None


def _known(environment_id: str) -> str:
    """The ids of the family that it begins with; otherwise ours, and where to find the others."""
    family, slash, _ = environment_id.partition("/")
    own = [info.id for info in ENVIRONMENTS.values() if slash and info.family == family]
    others = "those of MuJoCo Playground (playground/…) and of Brax (brax/…): GET /environments"
    return ", ".join(own) if own else f"{', '.join(BUILT_IN)}; and {others}"


def parse_options(info: EnvironmentInfo, options: Mapping[str, object]) -> Strict:
    """The environment's own options, defaults filled in. Raises Rejected, with every wrong field."""
    try:
        parsed = info.options.model_validate(dict(options))
    except ValidationError as error:
        wrong = error.errors(include_url=False)[:MOST_PROBLEMS]
        problems = [_problem(info, _place(details, options), _message(details)) for details in wrong]
        raise _refusal(info, problems) from None
    if info.check is not None and (problems := list(info.check(parsed))):
        raise _refusal(info, problems)
    return parsed


def _refusal(info: EnvironmentInfo, problems: list[Problem]) -> Rejected:
    sentences = " ".join(problem.detail for problem in problems)
    return Rejected(f"The options of {info.id!r} are not valid. {sentences}", problems)


def resolve(environment_id: str, options: Mapping[str, object]) -> tuple[EnvironmentInfo, Strict]:
    """The environment's row under these options, and the options with defaults filled in.

    Raises EnvironmentNotFound, and Rejected with each option that is wrong.
    """
    info = find(environment_id)
    parsed = parse_options(info, options)
    return info.under(parsed), parsed


def make(
    info: EnvironmentInfo,
    options: Strict,
    build_engine: "EngineBuilder",
    model: Path | None = None,
    clips: Mapping[str, Path] | None = None,
    decoder: Path | None = None,
) -> "Environment":
    """The environment itself. This call loads its code, and with it the numerical stack.

    model: the file that the options name, for an environment that takes one. clips: the files of their
    reference, by id. decoder: the exported policy whose decoder acts. Raises JobFailed where the environment
    cannot be made.
    """
    module, _, function = info.factory.partition(":")
    factory = getattr(import_module(module), function)
    own = {**info.arguments, **({"model": model} if info.takes_model else {})}
    own |= {"clips": clips} if clips else {}
    environment = cast("Environment", factory(options, build_engine, **own))
    action = getattr(options, "action", None)
    if not isinstance(action, DecoderAction):
        return environment
    return import_module("core.environments.wrappers.decoded").behind_decoder(environment, action, decoder)


def _place(error: Mapping[str, Any], options: object) -> tuple[int | str, ...]:
    """Where the error is in the options, without the union members that pydantic adds to the path."""
    place: list[int | str] = []
    here: Any = options
    last = len(error["loc"]) - 1
    for number, part in enumerate(error["loc"]):
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            if number < last or error["type"] != "missing":
                continue
        place.append(part)
    return tuple(place)


def _message(error: Mapping[str, Any]) -> str:
    tag = ""
    if error["type"] == "union_tag_invalid":
        tag = str(error["ctx"]["tag"])
    elif error["type"] == "literal_error" and error["loc"][-1] == "kind":  # Of a list with one kind.
        tag = str(error["input"])
    return why_unknown(tag, PLUGINS).removesuffix(".") if "/" in tag else error["msg"]


def _problem(info: EnvironmentInfo, location: tuple[int | str, ...], message: str) -> Problem:
    field = ".".join(str(part) for part in location)
    escaped = (str(part).replace("~", "~0").replace("/", "~1") for part in location)
    pointer = "/".join(("/environment/options", *escaped))
    sentence = message.removeprefix("Value error, ")
    if not location:
        return Problem(pointer, f"{sentence}.")
    if location and location[0] not in info.options.model_fields:
        known = ", ".join(info.options.model_fields) or "none"
        near = nearest(field, info.options.model_fields)
        hint = f" Did you mean {near[0]}?" if near else ""
        return Problem(pointer, f"{field}: there is no such option; there are {known}.{hint}")
    return Problem(pointer, f"{field}: {sentence}.")
