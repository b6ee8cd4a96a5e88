"""The engine `compiled`: machine code made for one body."""

import jax
import mujoco

from core.errors import JobFailed
from core.physics.engine import NOMINAL, ModelFields, PhysicsState
from core.reasons import Reason


class CompiledEngine:
    """The place of the engine, which is being written: building it ends the job."""

    name = "compiled"

    def __init__(self, model: mujoco.MjModel, num_substeps: int, derived: tuple[str, ...]) -> None:
        raise JobFailed(Reason.NO_DEVICE, "The engine 'compiled' is not finished yet: ask for another one.")

    def reset(self, qpos: jax.Array, qvel: jax.Array, model: ModelFields = NOMINAL) -> PhysicsState:
        raise NotImplementedError

    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        raise NotImplementedError
