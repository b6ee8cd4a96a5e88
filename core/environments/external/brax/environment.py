"""Brax's registered environments as they are, moved by Brax's own physics.

Source: Freeman et al., Brax: A Differentiable Physics Engine for Large Scale Rigid Body Simulation (2021).
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
from jax.interpreters.partial_eval import dce_jaxpr

from core.environments.environment import CONTINUOUS, Discretization, State
from core.environments.external.brax.info import EPISODE_LENGTH, BraxOptions
from core.environments.external.compat import as_float, plain_key, root_of
from core.errors import JobFailed
from core.physics.engine import NOMINAL, EngineBuilder, ModelFields, PhysicsState
from core.reasons import Reason

# The prefix in `info` of arrays that only Brax's physics understands.
PIPELINE = "pipeline/"


def make(options: BraxOptions, build_engine: EngineBuilder, name: str) -> "Brax":
    """The environment of this name in Brax's registry; no engine of ours is built."""
    return Brax(name, options.backend)


def load(name: str, backend: str) -> Any:
    """The package's own object."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns that its environments are not maintained
        from brax import envs

        return envs.get_environment(name, backend=backend)


class Brax:
    """The package's own reset and step. A state carries those arrays of its physics that later steps read.

    `physics` has the positions and velocities, which all of Brax's physics have in MuJoCo's order;
    `info` has the rest, as `pipeline/` and Brax's name.
    """

    episode_length = EPISODE_LENGTH
    discretization: Discretization = CONTINUOUS

    def __init__(self, name: str, backend: str) -> None:
        self._theirs = load(name, backend)
        self.model: mujoco.MjModel = self._theirs.sys.mj_model
        self.action_size = int(self._theirs.action_size)
        self.dt = float(self._theirs.dt)
        self.tracked_body = root_of(self.model)
        state = jax.eval_shape(self._theirs.reset, jax.random.PRNGKey(0))
        self.observation_size: int = state.obs.shape[-1]
        self._state = type(state)
        paths, self._tree = jax.tree_util.tree_flatten_with_path(state.pipeline_state)
        names = [jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in paths]
        self._names = [PIPELINE + name for name in names]
        self._shapes = [leaf for _, leaf in paths]
        self._carried = self._find_carried(state)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        if model:
            raise JobFailed(Reason.BAD_MODEL, "Brax's own physics cannot randomize the model.")
        return self._ours(self._theirs.reset(plain_key(key)))

    def step(self, state: State, action: jax.Array) -> State:
        known = {f"{PIPELINE}q": state.physics.qpos, f"{PIPELINE}qd": state.physics.qvel, **state.info}
        info = {name: array for name, array in state.info.items() if not name.startswith(PIPELINE)}
        leaves = [
            known[name] if name in known else jnp.zeros(leaf.shape, leaf.dtype)
            for name, leaf in zip(self._names, self._shapes, strict=True)
        ]
        # Reward and done start at 0: a step that does not set them must not repeat the last episode's.
        nothing = jnp.zeros(())
        pipeline = jax.tree.unflatten(self._tree, leaves)
        before = self._state(pipeline, state.obs, nothing, nothing, dict(state.metrics), info)
        after = self._ours(self._theirs.step(before, action))
        return replace(after, physics=replace(after.physics, time=state.physics.time + self.dt))

    def _find_carried(self, state: Any) -> list[bool]:
        def step(leaves: list[Any], others: Any, action: jax.Array) -> tuple[list[Any], Any]:
            after = self._theirs.step(
                state.replace(**others, pipeline_state=self._tree.unflatten(leaves)), action
            )
            seen = (after.obs, after.reward, after.done, after.metrics, after.info)
            return jax.tree.leaves(after.pipeline_state), seen

        others = {"obs": state.obs, "metrics": state.metrics, "info": state.info}
        return carried(step, self._shapes, others, jnp.zeros(self.action_size))

    def _ours(self, theirs: Any) -> State:
        pipeline = theirs.pipeline_state
        leaves = jax.tree.leaves(pipeline)
        kept = {
            name: jnp.asarray(leaf)
            for name, leaf, is_needed in zip(self._names, leaves, self._carried, strict=True)
            if is_needed and name not in (f"{PIPELINE}q", f"{PIPELINE}qd")
        }
        physics = PhysicsState(
            qpos=as_float(pipeline.q),
            qvel=as_float(pipeline.qd),
            act=jnp.zeros(self.model.na),
            qacc_warmstart=jnp.zeros(self.model.nv),
            time=jnp.zeros(()),
            derived={},
        )
        metrics = {name: as_float(value) for name, value in theirs.metrics.items()}
        info = {**theirs.info, **kept}
        return State(physics, theirs.obs, as_float(theirs.reward), as_float(theirs.done), metrics, info)


def carried(step: Callable[..., tuple[Any, Any]], state: Sequence[Any], *others: Any) -> list[bool]:
    """For each array of the state, whether the next step or a later one needs it.

    step: (state, *others) -> (state afterwards, results); both states have the same number of arrays. state,
    others: arrays, or their shapes. An array that only feeds itself is not needed. Found in the traced
    program by dead code elimination; a loop without a fixed length counts as reading all of its inputs.
    """
    jaxpr = jax.make_jaxpr(step)(state, *others).jaxpr
    num_results = len(jaxpr.outvars) - len(state)
    needed = [False] * len(state)
    while True:
        _, read = dce_jaxpr(jaxpr, [*needed, *[True] * num_results])
        # The step before must have left what a step reads.
        grown = [one or other for one, other in zip(needed, read[: len(state)], strict=True)]
        if grown == needed:
            return needed
        needed = grown
