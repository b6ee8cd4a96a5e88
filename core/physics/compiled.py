"""The engine `compiled`: the library `mujoco_compiled` behind the engines' interface."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import structlog

from core.errors import JobFailed
from core.physics.availability import NEWTON_ALONE, beyond_compiled
from core.physics.engine import NOMINAL, ModelFields, PhysicsState, SolverSettings, check_model_fields
from core.reasons import Reason
from mujoco_compiled import Data, Model, Uncovered, forward, left_out, make_data, put_model, step

log = structlog.get_logger()

_CARRIED = ("qpos", "qvel", "act", "qacc_warmstart", "time")


class CompiledEngine:
    """Code made for one body, on all cores or on a GPU.

    An environment that is not finite, or past MuJoCo's own bound, comes back as NaN, and one that had no room
    for contacts infinite. On one kind of processor every environment has the same result every time, and
    beside any others.
    """

    name = "compiled"

    def __init__(
        self,
        model: mujoco.MjModel,
        num_substeps: int,
        derived: tuple[str, ...],
        nconmax: int | None = None,
    ) -> None:
        self.model, self._derived = model, derived
        with _refusing():
            self._nominal = put_model(model, nstep=num_substeps, derived=derived, nconmax=nconmax)
        if sentences := list(left_out(model)):
            log.info("physics_leaves_out", engine=self.name, sentences=sentences)

    def reset(
        self,
        qpos: jax.Array,
        qvel: jax.Array,
        model: ModelFields = NOMINAL,
        act: jax.Array | None = None,
    ) -> PhysicsState:
        check_model_fields(model)
        at_rest = make_data(self._nominal)
        begun = at_rest.replace(
            qpos=qpos, qvel=qvel, qacc_warmstart=jnp.zeros_like(qvel), act=at_rest.act if act is None else act
        )
        begun = forward(self._with(model), begun)
        return PhysicsState(**self._fields(begun), model=model)

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        data = Data(**{name: getattr(state, name) for name in _CARRIED}, ctrl=ctrl)
        if state.exact:
            data = data.replace(history=state.exact["history"].sum(axis=-1))
        return replace(state, **self._fields(step(self._with(state.model), data)))

    def _fields(self, data: Data) -> Mapping[str, Any]:
        """Those of a PhysicsState."""
        carried = {name: getattr(data, name) for name in _CARRIED}
        derived = {name: getattr(data, name) for name in self._derived}
        return {**carried, "derived": derived, "exact": _exact(data)}

    def _with(self, own: ModelFields) -> Model:
        with _refusing():
            return self._nominal.tree_replace(own)


def check_solver(settings: SolverSettings | None) -> None:
    """Raises JobFailed("bad_model") if the job itself asks for a solver that the library lacks."""
    if settings is not None and "solver" in settings.asked and settings.solver != "newton":
        raise JobFailed(Reason.BAD_MODEL, beyond_compiled(NEWTON_ALONE))


def _exact(data: Data) -> Mapping[str, jax.Array]:
    """See PhysicsState. This engine's own numbers are the first parts."""
    if data.history is None:
        return {}
    nothing = jnp.zeros_like(data.history)
    return {"history": jnp.stack([data.history, nothing, nothing], axis=-1)}


@contextmanager
def _refusing() -> Generator[None]:
    """Raises JobFailed("bad_model") for what the library does not cover."""
    try:
        yield
    except Uncovered as error:
        raise JobFailed(Reason.BAD_MODEL, beyond_compiled(str(error))) from error
