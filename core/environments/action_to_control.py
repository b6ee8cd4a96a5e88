"""From a policy's action to the controls of a body's actuators: when it arrives, how smooth it is, which
targets servos get, and the torque that motors have left.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.observation_group import ObservationGroup
from core.environments.terms import history
from core.environments.terms.actions import Action, ActionTerm, ControlAction, JointAction, PositionPart
from core.environments.terms.actuation import Actuation, actuation, joint_names
from core.environments.terms.binding import bound
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.term import whole_steps
from core.environments.torque_speed_curve import TorqueSpeedCurve
from core.physics.engine import Engine, PhysicsState

# The field of the model that a torque-speed curve changes in each step.
_FORCE_RANGE = "actuator_forcerange"


class ActionToControl:
    """policy: what the policy sees, whose biased encoders servos may follow. control_step_s: seconds between
    actions.

    actuation: of an action on joints; None of another. derived: the fields of the physics that it reads.
    is_random: whether episodes differ by chance. An environment keeps the delay of an episode, the actions
    that have not arrived, and the last smoothed one in `State.info`.
    """

    def __init__(
        self, action: Action, model: ModelIndex, policy: ObservationGroup, control_step_s: float
    ) -> None:
        self._action, self._policy = action, policy
        self._model, self._pose, self._num_actions = model.model, model.pose, model.num_actions
        self._delays = whole_steps(action.delay, control_step_s)
        self.actuation: Actuation | None = None
        self._term = self._encoders = None
        if isinstance(action, JointAction):
            self.actuation = actuation(action, model.model, model.pose)
            if action.follows_encoders:
                self._encoders = _biased_servos(self.actuation, model.model, policy)
        if isinstance(action, ActionTerm):
            nothing = np.zeros(model.num_actions)
            self._term = bound(action, model, "controls", nothing, size=model.model.nu)
        self._is_scaled = not isinstance(action, ControlAction) or action.scaled
        self._along = _servos_along(action, model.model)
        self._curve = TorqueSpeedCurve.of(model.model) if action.torque_speed_curve else None
        self.derived = frozenset[str]() if self._term is None else self._term.derived
        self.is_random = action.delay is not None

    def begun(self, uniform: Callable[[int], jax.Array]) -> dict[str, jax.Array]:
        """Entries of `State.info` at an episode's start. uniform: random numbers in [0, 1), as many as it is
        told."""
        entries: dict[str, jax.Array] = {}
        nothing = jnp.zeros(self._num_actions)
        if self._action.delay is not None:
            more = jnp.floor(uniform(1)[0] * len(self._delays)).astype(jnp.int32)
            entries["action_delay"] = self._delays.start + more
            entries["past_actions"] = history.begun(nothing, self._delays.stop, jnp)
        if self._action.smoothing:
            entries["smoothed_action"] = nothing
        return entries

    def controls(
        self, action: jax.Array, step: Step, info: Mapping[str, jax.Array], reference: jax.Array | None
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """The controls [nu] of a step, and entries of `State.info` for the next one.

        action: the policy's own [n]. step: `after` is what is before the step that they move. reference:
        positions [nq] of the frame after that step; None of a task without one.
        """
        action, entries = self._arrived(action, info)
        if self._term is not None:
            return jnp.float32(self._term.measure(step, action)), entries
        control = self.nominal(action)
        if self._encoders is not None:
            servos, places = self._encoders
            control = control.at[servos].add(-self._policy.bias(info)[places])
        if reference is not None and self._along.size:
            servos, joints = self._along
            control = control.at[servos].add(reference[joints] - jnp.asarray(self._pose, jnp.float32)[joints])
        return control, entries

    def nominal(self, action: jax.Array) -> jax.Array:
        """The controls [nu] for an action [n] that has arrived: targets are about the pose, and encoders have
        no bias. Of an action of joints or of controls."""
        if self.actuation is None:
            return scaled_to_control(self._model, action) if self._is_scaled else action
        offset, gain = jnp.asarray(self.actuation.offset), jnp.asarray(self.actuation.gain)
        if self._num_actions < self._model.nu:
            action = jnp.zeros(self._model.nu).at[self.actuation.actuators].set(action)
        return offset + gain * action

    def stepped(self, engine: Engine, before: PhysicsState, control: jax.Array) -> PhysicsState:
        """The physics after the controls [nu], with the torque that motors have left at this speed."""
        if self._curve is None:
            return engine.step(before, control)
        force_range = self._curve.force_range(before.qvel, before.model.get(_FORCE_RANGE))
        limited = replace(before, model={**before.model, _FORCE_RANGE: force_range})
        return replace(engine.step(limited, control), model=before.model)

    def _arrived(
        self, action: jax.Array, info: Mapping[str, jax.Array]
    ) -> tuple[jax.Array, dict[str, jax.Array]]:
        """The action that the actuators get in this step, and what `State.info` keeps of it."""
        entries: dict[str, jax.Array] = {}
        if self._action.delay is not None:
            past = history.remembered(info["past_actions"], action, jnp)
            entries["past_actions"] = past
            action = history.seen(past, 1, info["action_delay"])
        if share := self._action.smoothing:
            action = entries["smoothed_action"] = share * info["smoothed_action"] + (1.0 - share) * action
        return action, entries


def scaled_to_control(model: mujoco.MjModel, action: jax.Array) -> jax.Array:
    """The control [nu] for an action [nu] in [-1, 1]; ±1 is an end of the actuator's range.

    An actuator without a range takes the action itself.
    """
    limited = model.actuator_ctrllimited.astype(bool)
    ranges = np.where(limited, model.actuator_ctrlrange.T, [[-1.0], [1.0]]).astype(np.float32)
    low, high = map(jnp.asarray, ranges)
    return low + (action + 1.0) * (high - low) * 0.5


def _biased_servos(targets: Actuation, model: mujoco.MjModel, policy: ObservationGroup) -> np.ndarray:
    """Position servos whose encoders have a bias, and its place among the group's, [2, n]."""
    places = policy.encoder_places
    joints = model.actuator_trnid[:, 0].tolist()
    servos = [number for number, kind in enumerate(targets.kinds) if kind == "position"]
    biased = [(number, places[joints[number]]) for number in servos if joints[number] in places]
    return np.array(biased, int).reshape(-1, 2).T


def _servos_along(action: Action, model: mujoco.MjModel) -> np.ndarray:
    """The servos whose targets are about the reference, and their joints' places in qpos, [2, n]."""
    parts = action.parts if isinstance(action, JointAction) else ()
    along = [part for part in parts if isinstance(part, PositionPart) and part.about == "reference"]
    servos = [
        number for number, name in enumerate(joint_names(model)) if any(part.drives(name) for part in along)
    ]
    return np.array([servos, model.jnt_qposadr[model.actuator_trnid[servos, 0]]], int).reshape(2, -1)
