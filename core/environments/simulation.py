"""The data with which a program steps an environment's body by MuJoCo alone, as the page does (docs/push.md).

It is a model, and what the environment computes around its physics, as operations on numbers: both are traced
from the environment's own code, around an engine that only marks where the physics is.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.environment import State
from core.environments.expression import Expression, NotExpressed
from core.environments.info import POLICY_GROUP
from core.environments.simulated_model import NotSimulated, as_xml
from core.environments.terms.commands import CommandRange
from core.environments.tracing import expressed
from core.physics.engine import DERIVED_FIELDS, NOMINAL, ModelFields, PhysicsState
from core.physics.model import with_loose_frames
from mujoco_compiled import GEOMETRY

if TYPE_CHECKING:
    from core.environments.mujoco_env import MujocoEnv

FORMAT, VERSION = "gaitway-simulation", 2
_NUM_STARTS = 8
_STATE_FIELDS = ("qpos", "qvel", "act", "qacc_warmstart", "time")
_Arrays = Mapping[str, Any]


@dataclass(frozen=True)
class Start:
    """How an episode may begin: positions [nq], velocities [nv] and states of actuators [na]."""

    qpos: Sequence[float]
    qvel: Sequence[float]
    act: Sequence[float]


@dataclass(frozen=True)
class SimulatedLayout:
    """One ground of a terrain. lift: the height of the ground at the start, which `starts` do not have, in m.
    model: the rows of the terrain's boxes in fields of MjModel. ground: what expressions read of it."""

    kind: str
    level: int
    lift: float
    model: Mapping[str, Sequence[float]]
    ground: Sequence[float]


@dataclass(frozen=True)
class SimulatedTerrain:
    """The grounds on which an episode may be.

    geoms: the numbers of the boxes in the simulation's model, and nodes: in a replay's scene. root_height:
    the place in `qpos` of what is lifted.
    """

    geoms: Sequence[int]
    nodes: Sequence[int]
    root_height: int
    layouts: Sequence[SimulatedLayout]


@dataclass(frozen=True)
class Simulation:
    """A body, ready to be stepped.

    model: XML, with the solver settings of the engine that trained. num_substeps: its time steps for one step
    of the environment. command: empty where the body follows none. terrain: None where the ground is the
    model's own. begin, control, step: what the environment computes at an episode's start, before the physics
    of a step, and after it. Their inputs: `before.` and `after.` with the name of a field of MjData, before
    and after the physics of the step; `state.` with the name of what is carried from step to step; `action`;
    `command`; `ground`. Their outputs: `observation`, `control`, `ended` (1 where the episode ends), and what
    is carried on.
    """

    model: str
    num_substeps: int
    tracked_body: int
    starts: Sequence[Start]
    begin: Expression
    control: Expression
    step: Expression
    command: Sequence[CommandRange] = ()
    terrain: SimulatedTerrain | None = None

    def document(self) -> dict[str, Any]:
        """As JSON, with numbers that are plain Python's."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "mujoco": mujoco.mj_versionString(),
            "model": self.model,
            "num_substeps": self.num_substeps,
            "tracked_body": self.tracked_body,
            "starts": [asdict(start) for start in self.starts],
            "command": [asdict(one) for one in self.command],
            "terrain": None if self.terrain is None else asdict(self.terrain),
            **{name: getattr(self, name).document() for name in ("begin", "control", "step")},
        }


def simulation_of(
    environment: "MujocoEnv",
    spec: mujoco.MjSpec,
    command: Sequence[CommandRange] = (),
    ground_size: int = 0,
) -> Simulation:
    """The simulation of an environment, whose model is of this spec. Raises NotSimulated.

    ground_size: how many numbers `MujocoEnv.told` takes of a ground; 0 where that is the model's own.
    """
    stepped = environment.engine.model
    if ground_size:
        stepped = with_loose_frames(stepped, GEOMETRY)
    model, told = as_xml(spec, stepped), _told(len(command), ground_size)
    try:
        begin, step = _begun(environment, told), _stepped(environment, told)
        carried = [f"state.{name}" for name in _carried(step)]
        begin, control, step = (
            begin.only(["observation", *carried]),
            step.only(["control"]),
            step.only(["observation", "ended", *carried]),
        )
    except NotExpressed as error:
        raise NotSimulated(f"{error}, which the page lacks") from None
    return Simulation(
        model=model,
        num_substeps=round(environment.dt / environment.model.opt.timestep),
        tracked_body=environment.tracked_body,
        starts=[*_starts(environment)],
        begin=begin,
        control=control,
        step=step,
        command=command,
    )


def _carried(step: Expression) -> list[str]:
    """The names of `State.info` on which later observations, controls and ends depend."""
    carried: set[str] = set()
    while True:
        outputs = ["observation", "control", "ended", *(f"state.{name}" for name in sorted(carried))]
        needed = {name.removeprefix("state.") for name in step.only(outputs).inputs if "state." in name}
        if needed <= carried:
            return sorted(carried)
        carried |= needed


class _Boundary:
    """An engine in name only: physics that is begun or stepped becomes `after`, if it is given."""

    name = "native"

    def __init__(self, model: mujoco.MjModel, after: PhysicsState) -> None:
        self.model, self.after = model, after
        self.control: jax.Array | None = None

    def reset(
        self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL, act: jax.Array | None = None
    ) -> PhysicsState:
        if model:
            raise NotSimulated("each episode has another model")
        return self.after

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        if self.control is not None:
            raise NotSimulated("its physics is stepped several times for one action")
        if state.model:
            raise NotSimulated("what its motors can do changes in each step")
        self.control = ctrl
        return self.after


class _Start(_Boundary):
    """An engine whose physics begins where it is told to, without what is derived from that."""

    def reset(
        self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL, act: jax.Array | None = None
    ) -> PhysicsState:
        return replace(self.after, qpos=qpos, qvel=qvel, act=self.after.act if act is None else act)


def _around(environment: "MujocoEnv", engine: _Boundary, given: _Arrays) -> "MujocoEnv":
    """The environment without chance, under the command and on the ground that are given."""
    there = environment.told(given.get("command"), given.get("ground"))
    there.engine = engine
    return there


def _begun(environment: "MujocoEnv", told: Mapping[str, jax.ShapeDtypeStruct]) -> Expression:
    def begin(given: _Arrays) -> _Arrays:
        engine = _Boundary(environment.engine.model, _physics(given, "after."))
        return _outputs(_around(environment, engine, given).reset(jax.random.key(0)))

    return expressed(begin, {**_fields(environment.model, "after."), **told})


def _stepped(environment: "MujocoEnv", told: Mapping[str, jax.ShapeDtypeStruct]) -> Expression:
    def step(given: _Arrays) -> _Arrays:
        engine = _Boundary(environment.engine.model, _physics(given, "after."))
        there = _around(environment, engine, given)
        info = {name: given[f"state.{name}"] for name in carried}
        before = State(_physics(given, "before."), None, jnp.zeros(()), jnp.zeros(()), {}, info)
        return {**_outputs(there.step(before, given["action"])), "control": engine.control}

    info = jax.eval_shape(environment.reset, jax.random.key(0)).info
    carried = sorted(info)
    return expressed(
        step,
        {
            **_fields(environment.model, "before."),
            **_fields(environment.model, "after."),
            **{f"state.{name}": jax.ShapeDtypeStruct(info[name].shape, info[name].dtype) for name in carried},
            **told,
            "action": jax.ShapeDtypeStruct((environment.action_size,), jnp.float32),
        },
    )


def _starts(environment: "MujocoEnv") -> Iterator[Start]:
    """Some starts of episodes, as the environment draws them."""
    model = environment.model
    nothing = {name: jnp.zeros(one.shape, one.dtype) for name, one in _fields(model, "after.").items()}
    there = copy.copy(environment)
    there.engine = _Start(environment.engine.model, _physics(nothing, "after."))

    def start(key: jax.Array) -> PhysicsState:
        return there.reset(key).physics

    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        keys = jax.random.split(jax.random.key(0), _NUM_STARTS)
        physics = jax.jit(jax.vmap(start))(keys)
        rows = zip(
            *(np.asarray(one, float) for one in (physics.qpos, physics.qvel, physics.act)), strict=True
        )
    for row in rows:
        yield Start(*(values.tolist() for values in row))


def _fields(model: mujoco.MjModel, prefix: str) -> dict[str, jax.ShapeDtypeStruct]:
    data = mujoco.MjData(model)
    return {
        f"{prefix}{name}": jax.ShapeDtypeStruct(np.shape(getattr(data, name)), jnp.float32)
        for name in (*_STATE_FIELDS, *DERIVED_FIELDS)
    }


def _physics(given: _Arrays, prefix: str) -> PhysicsState:
    own = {name: given[f"{prefix}{name}"] for name in _STATE_FIELDS}
    return PhysicsState(**own, derived={name: given[f"{prefix}{name}"] for name in DERIVED_FIELDS})


def _told(command_size: int, ground_size: int) -> dict[str, jax.ShapeDtypeStruct]:
    sizes = {"command": command_size, "ground": ground_size}
    return {name: jax.ShapeDtypeStruct((size,), jnp.float32) for name, size in sizes.items() if size}


def _outputs(state: State) -> dict[str, Any]:
    seen = state.obs[POLICY_GROUP] if isinstance(state.obs, Mapping) else state.obs
    return {
        "observation": seen,
        "ended": state.done,
        **{f"state.{name}": value for name, value in state.info.items()},
    }
