"""The parts of a model that an engine would leave out in silence, or get wrong; found before it is built.

The rules of `compiled` are its library's. What another engine itself refuses to load is not repeated here.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import mujoco
import numpy as np

from core.errors import JobFailed
from core.physics.availability import EngineName, beyond
from core.reasons import Reason
from mujoco_compiled import uncovered, unread_sensors

# MuJoCo makes the edges of a friction pyramid stiffer than its contact by 1 / (2 · friction²). With less
# friction than this, single precision has no digits left for the contact itself.
_LEAST_FRICTION = 0.01
_MOST_GEOMS = 1000


def check_runs(engine: EngineName, model: mujoco.MjModel, derived: Sequence[str] = ()) -> None:
    """Raises JobFailed("bad_model") if the engine would move the model, or read these fields of it, otherwise
    than C MuJoCo does."""
    reason = unrun(engine, model, derived)
    if reason is not None:
        raise JobFailed(Reason.BAD_MODEL, beyond(engine, reason))


def unread_by_engine(model: mujoco.MjModel) -> Mapping[int, Mapping[EngineName, str]]:
    """By number of a sensor: engines that cannot read it, and why. They run jobs that do not read it."""
    found = dict[int, dict[EngineName, str]]()
    for number, why in unread_sensors(model):
        found.setdefault(number, {})["compiled"] = why
    for number, why in _late_sensors(model):
        found.setdefault(number, {}).update({"mjx": why, "warp": why})
    return found


def unrun(engine: EngineName, model: mujoco.MjModel, derived: Sequence[str] = ()) -> str | None:
    """The first reason against the engine, such as "its geom 'hills' is a height field"; None: none."""
    if engine == "compiled":
        return uncovered(model, derived)
    reason = next((reason for check in _CHECKS.get(engine, ()) for reason in check(model)), None)
    if reason is None and "sensordata" in derived and engine in ("mjx", "warp"):
        return next((why for _, why in _late_sensors(model)), None)
    return reason


def _states_of_their_own(model: mujoco.MjModel) -> Iterator[str]:
    """`native` carries the state of a step, and not what plugins or modes keep beside it."""
    if model.npluginstate:
        yield "it has a plugin with a state of its own, which is not part of an environment's state"
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_IPC:
        yield "it enables `ipc`, whose bookkeeping is not part of an environment's state"


def _delays(model: mujoco.MjModel) -> Iterator[str]:
    yield from _where(model, "actuator", model.actuator_delay > 0, "acts with a delay")


def _late_sensors(model: mujoco.MjModel) -> Iterator[tuple[int, str]]:
    late = (model.sensor_delay > 0) | model.sensor_interval.any(axis=1)
    for number in np.flatnonzero(late).tolist():
        yield number, f"its sensor {_named(model, 'sensor', number)} is read late or at intervals"


def _plugins(model: mujoco.MjModel) -> Iterator[str]:
    if model.nplugin:
        yield "it uses a plugin"


def _disabled_groups(model: mujoco.MjModel) -> Iterator[str]:
    if model.opt.disableactuator:
        yield "it disables groups of actuators (`actuatorgroupdisable`)"


def _height_fields(model: mujoco.MjModel) -> Iterator[str]:
    is_field = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
    touched = is_field & ((model.geom_contype != 0) | (model.geom_conaffinity != 0) | _in_pairs(model))
    yield from _where(model, "geom", touched, "is a height field, whose contacts it misses in part")


def _in_pairs(model: mujoco.MjModel) -> np.ndarray:
    return np.isin(np.arange(model.ngeom), [*model.pair_geom1, *model.pair_geom2])


def slippery_contacts(model: mujoco.MjModel) -> Iterator[str]:
    if model.opt.disableflags & (
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    ):
        return
    words = "can touch with hardly any friction: single precision cannot compute it"
    is_smooth = model.geom_friction[:, 0] < _LEAST_FRICTION
    # A scene of more smooth geoms is too large for these engines in any case.
    for geom in np.flatnonzero(is_smooth)[:_MOST_GEOMS].tolist():
        others = np.flatnonzero(_may_touch(model, geom) & _slides_on(model, geom, is_smooth)).tolist()
        if others:
            yield f"its geoms {_named(model, 'geom', geom)} and {_named(model, 'geom', others[0])} {words}"
    slips = (model.pair_friction[:, 0] < _LEAST_FRICTION) & (model.pair_dim > 1)
    yield from _where(model, "pair", slips, "has hardly any friction: single precision cannot compute it")


def _slides_on(model: mujoco.MjModel, geom: int, is_smooth: np.ndarray) -> np.ndarray:
    """On which geoms [ngeom] this smooth one slides. Of two geoms the one of higher priority decides; of two
    equal ones, the larger friction and the larger dimension count."""
    above = model.geom_priority[geom] - model.geom_priority
    has_friction = model.geom_condim[geom] > 1
    return ((above > 0) & has_friction) | (
        (above == 0) & is_smooth & (has_friction | (model.geom_condim > 1))
    )


def _slippery_under_rk4(model: mujoco.MjModel) -> Iterator[str]:
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        yield from slippery_contacts(model)


def _may_touch(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Which geoms [ngeom] are of another body, and have a bit in common with this one's."""
    one, other = model.geom_contype, model.geom_conaffinity
    common = (one & other[geom]) | (other & one[geom])
    body = model.body_weldid[model.geom_bodyid]
    return (common != 0) & (body != body[geom])


def _where(model: mujoco.MjModel, kind: str, found: np.ndarray, words: str) -> Iterator[str]:
    """A sentence on the first element for which `found` is true."""
    yield from (f"its {kind} {_named(model, kind, place)} {words}" for place in np.flatnonzero(found)[:1])


def _named(model: mujoco.MjModel, kind: str, place: int) -> str:
    """The element's name in quotes, or its number."""
    name = getattr(model, kind)(int(place)).name
    return f"'{name}'" if name else f"number {place}"


_IGNORED = (_delays, _plugins, _disabled_groups, _height_fields)
_CHECKS: Mapping[EngineName, tuple[Callable[[mujoco.MjModel], Iterator[str]], ...]] = {
    "native": (_states_of_their_own,),
    "mjx": (*_IGNORED, _slippery_under_rk4),
    "warp": (*_IGNORED, slippery_contacts),
}
