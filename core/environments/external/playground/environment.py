"""MuJoCo Playground's environments as they are. Source: Zakka et al., MuJoCo Playground (2025)."""

import copy
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, Literal

import jax
import jax.numpy as jnp
import mujoco

from core.environments import optional_packages
from core.environments.environment import CONTINUOUS, Discretization, State
from core.environments.external.compat import as_float, plain_key, root_of
from core.environments.info import NoOptions
from core.installation import to_install
from core.physics.engine import (
    NOMINAL,
    OVERFLOW,
    EngineBuilder,
    ModelFields,
    PhysicsState,
    check_model_fields,
)

# The fields of the last Data that a step of MJX reads; everything else follows from these.
_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart", "time")
# It also reads these, the positions of targets, which a reset sets.
_MOCAP = ("mocap_pos", "mocap_quat")
# The entry of `info` that holds the position of the body `target`, for drawing an episode.
_TARGET = "target_position"


def make(options: NoOptions, build_engine: EngineBuilder, name: str) -> "Playground":
    """The environment of this name in Playground's registry, on MJX-JAX or MJX-Warp.

    Raises JobFailed("bad_model") where the package is not installed.
    """
    return Playground(name, "warp" if build_engine.name == "warp" else "jax")


def load(name: str, implementation: Literal["jax", "warp"]) -> Any:
    """The package's own object. Only its control suite is used, because that downloads nothing."""
    brings, install = "The environment comes with the package playground", to_install("playground")
    package = optional_packages.module("mujoco_playground", brings=brings, install=install)
    return package.dm_control_suite.load(name, config_overrides={"impl": implementation})


class Playground:
    """The package's own reset and step, around a Data that is rebuilt at each step.

    A state therefore holds only a few arrays. On Warp, all environments share a Data's contacts, so
    `jax.tree.map(where, ...)` over two of them would be wrong. `info` is the environment's own.
    """

    discretization: Discretization = CONTINUOUS

    def __init__(self, name: str, implementation: Literal["jax", "warp"]) -> None:
        self._theirs = load(name, implementation)
        self._state: Any = import_module("mujoco_playground").State
        self._make_data: Any = import_module("mujoco_playground._src.mjx_env").make_data
        self._implementation = implementation
        self._mocap = _MOCAP if self._theirs.mj_model.nmocap else ()
        self.model = _drawn(self._theirs.mj_model)
        self.observation_size: int = self._theirs.observation_size
        self.action_size: int = self._theirs.action_size
        self.dt = float(self._theirs.dt)
        self.episode_length = int(self._theirs._config.episode_length)
        self.tracked_body = root_of(self.model)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        check_model_fields(model)
        with self._with_model(model):
            return self._ours(self._theirs.reset(plain_key(key)), model)

    def step(self, state: State, action: jax.Array) -> State:
        # Reward and done start at 0: a step that does not set them must not repeat the last episode's.
        nothing = jnp.zeros(())
        data = self._data(state.physics)
        before = self._state(data, state.obs, nothing, nothing, dict(state.metrics), dict(state.info))
        with self._with_model(state.physics.model):
            return self._ours(self._theirs.step(before, action), state.physics.model)

    @contextmanager
    def _with_model(self, fields: ModelFields) -> Generator[None]:
        """Put these fields in the model that the package's functions read; tracing is not concurrent."""
        nominal = self._theirs._mjx_model
        if fields:
            self._theirs._mjx_model = nominal.tree_replace(dict(fields))
        try:
            yield
        finally:
            self._theirs._mjx_model = nominal

    def _data(self, physics: PhysicsState) -> Any:
        config = self._theirs._config
        blank = self._make_data(
            self._theirs.mj_model,
            impl=self._implementation,
            naconmax=config.naconmax,
            njmax=config.njmax,
        )
        carried = {name: getattr(physics, name) for name in _CARRIED}
        return blank.replace(**carried, **{name: physics.derived[name] for name in self._mocap})

    def _ours(self, theirs: Any, model: ModelFields) -> State:
        data = theirs.data
        derived = {name: getattr(data, name) for name in self._mocap}
        if self._implementation == "warp":
            from core.physics.warp_buffers import LOST

            derived[OVERFLOW] = as_float((data._impl.overflow & LOST) != 0)
        physics = PhysicsState(
            **{name: as_float(getattr(data, name)) for name in _CARRIED},
            derived=derived,
            model=model,
            exact={},
        )
        return State(
            physics,
            theirs.obs,
            as_float(theirs.reward),
            as_float(theirs.done),
            {name: as_float(value) for name, value in theirs.metrics.items()},
            {**theirs.info, **({_TARGET: data.mocap_pos[0]} if self._mocap else {})},
        )


def _drawn(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with its mocap bodies fixed in their initial places, because a drawing has no mocap data.

    C MuJoCo would step it the same way, because Playground moves none of them during an episode.
    """
    fixed = copy.copy(model)
    fixed.body_mocapid[:] = -1
    return fixed
