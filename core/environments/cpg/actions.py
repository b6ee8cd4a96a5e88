"""A star that its oscillators steer: an action sets what they tend to, and they move the joints."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import pi

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.cpg.options import CPGOptions
from core.environments.cpg.oscillators import OscillatorNetwork, Oscillators, advance, at_rest, output
from core.environments.cpg.roles import (
    Gait,
    action_size,
    decode,
    encode,
    modulation,
    num_oscillators,
    roles_for,
    roles_under,
    strengths,
    weights,
)
from core.environments.environment import ActionSet, Discretization, Environment, State, Wrapped
from core.errors import JobFailed
from core.physics.engine import NOMINAL, ModelFields
from core.reasons import Reason

_NAME = re.compile(r"arm_(?P<arm>\d+)_.*?(?P<plane>in_plane|out_of_plane)")


def oscillator_of_actuator(model: mujoco.MjModel, num_arms: int) -> NDArray[np.intp]:
    """[nu]: every segment of an arm follows its arm's oscillator in the plane, or that out of it.

    Raises JobFailed("bad_model") for an actuator that is not that of an arm's joint, by its name.
    """
    return np.array([_oscillator(model.actuator(index).name, num_arms) for index in range(model.nu)], np.intp)


def _oscillator(actuator: str, num_arms: int) -> int:
    found = _NAME.search(actuator)
    if found is None or int(found["arm"]) >= num_arms:
        raise JobFailed(
            Reason.BAD_MODEL,
            f"A CPG of {num_arms} arms cannot use the actuator {actuator!r}: its name must give an arm and a "
            "plane, as in 'arm_0_segment_2_in_plane_joint'.",
        )
    return 2 * int(found["arm"]) + (found["plane"] == "out_of_plane")


# So that the body starts as it would without oscillators.
_OWN_KEY = 0x637067
_PREFIX = "cpg_"
# Multiples of the gait's amplitudes: the choices of an arm that only says how far it rows.
_FACTORS = (0.0, 0.5, 1.0)


@dataclass(frozen=True)
class CPGActions(Wrapped):
    """An environment of joint actions, with oscillators before it.

    `encoding` defines its action [7 num_arms + 1]. `State.info` holds the oscillators' state, each field of
    `Oscillators` [2 num_arms] as cpg_<name>. oscillators: [nu], the oscillator that moves each actuator.
    """

    num_arms: int
    options: CPGOptions
    oscillators: NDArray[np.intp]

    @property
    def action_size(self) -> int:
        return action_size(self.num_arms)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        state = self.environment.reset(key, model)
        spread = self.options.initial_phase_spread
        shape = (num_oscillators(self.num_arms),)
        phases = jax.random.uniform(jax.random.fold_in(key, _OWN_KEY), shape, minval=-spread, maxval=spread)
        return _with(state, at_rest(phases))

    def step(self, state: State, action: jax.Array) -> State:
        options = self.options
        after = advance(
            self._network,
            decode(jnp.clip(action, -1, 1), options),
            oscillators_in(state.info),
            self.dt,
            options.integrator,
            options.num_steps,
        )
        joints = jnp.clip(output(after), -1, 1)[self.oscillators]
        return _with(self.environment.step(state, joints), after)

    @property
    def discretization(self) -> Discretization:
        """leading_arm: one choice, the arm that leads. arm_roles: each arm chooses its role. arm_amplitudes:
        each arm chooses how far it rows."""
        arms = tuple(f"arm {arm}" for arm in range(self.num_arms))
        roles = tuple(role.name.lower() for role in roles_for(self.num_arms))
        amplitudes = tuple(f"amplitude {factor:g}" for factor in _FACTORS)
        sets = {
            "leading_arm": ActionSet(len(arms), 1, lambda choices: self.leading_arm(choices[0]), arms),
            "arm_roles": ActionSet(len(roles), self.num_arms, self.of_roles, roles),
            "arm_amplitudes": ActionSet(len(_FACTORS), self.num_arms, self.of_amplitudes, amplitudes),
        }
        return replace(self.environment.discretization, action_sets=sets)

    def leading_arm(self, arm: jax.Array | int) -> jax.Array:
        """The action [7 num_arms + 1] that makes this arm [] lead."""
        return self.of_roles(roles_under(arm, self.num_arms))

    def of_roles(self, roles: jax.Array) -> jax.Array:
        """The action [7 num_arms + 1] that makes every arm play its role [num_arms]."""
        return encode(modulation(roles, self._gait), self.options)

    def of_amplitudes(self, choices: jax.Array) -> jax.Array:
        """The action [7 num_arms + 1] that makes every arm row as far as its choice [num_arms] says."""
        return encode(strengths(jnp.asarray(_FACTORS)[choices], self._gait), self.options)

    @property
    def _gait(self) -> Gait:
        gait = self.options.gait
        return Gait(2 * pi * gait.frequency_hz, gait.sweep, gait.stroke, gait.lift, 2 * pi * gait.lag)

    @property
    def _network(self) -> OscillatorNetwork:
        options = self.options
        coupling = weights(self.num_arms, options.coupling_weight)
        return OscillatorNetwork(jnp.asarray(coupling), options.amplitude_gain, options.offset_gain)


def steered_by_oscillators(environment: Environment, num_arms: int, options: CPGOptions) -> CPGActions:
    """The environment with oscillators before its joints.

    Raises ValueError for integration steps that diverge, JobFailed("bad_model") for actuators that are not
    those of the arms.
    """
    options.check_steps(environment.dt)
    return CPGActions(environment, num_arms, options, oscillator_of_actuator(environment.model, num_arms))


def oscillators_in(info: Mapping[str, jax.Array]) -> Oscillators:
    """The oscillators in a `State.info`; raises KeyError where there are none."""
    return Oscillators(**{field.name: info[_PREFIX + field.name] for field in fields(Oscillators)})


def _with(state: State, oscillators: Oscillators) -> State:
    own = {_PREFIX + field.name: getattr(oscillators, field.name) for field in fields(Oscillators)}
    return replace(state, info={**state.info, **own})
