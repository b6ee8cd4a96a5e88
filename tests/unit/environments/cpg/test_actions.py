from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from core.environments.cpg.actions import CPGActions, oscillators_in, steered_by_oscillators
from core.environments.cpg.options import CPGOptions, GaitOptions
from core.environments.environment import State
from core.errors import JobFailed
from tests.probes import Probe

PLANES = ("in_plane", "out_of_plane")
# Three arms of two segments, their actuators in no order that a CPG could guess.
NAMES = [
    f"star/arm_{arm}_segment_{s}_{plane}_joint_p_control"
    for s in (1, 0)
    for plane in PLANES
    for arm in (2, 0, 1)
]


@dataclass(frozen=True)
class Joints(Probe):
    """A body whose observation is its action."""

    names: tuple[str, ...] = tuple(NAMES)

    @cached_property
    def model(self) -> mujoco.MjModel:
        motors = "".join(f'<motor name="{name}" joint="hinge"/>' for name in self.names)
        return mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.1"/></body></worldbody>'
            f"<actuator>{motors}</actuator></mujoco>"
        )

    def reset(self, key: jax.Array, model: object = None) -> State:
        return replace(super().reset(key), obs=jnp.zeros(len(self.names)), info={"own": jnp.ones(2)})

    def step(self, state: State, action: jax.Array) -> State:
        return replace(super().step(state, action), obs=action)


def joints(names: tuple[str, ...] = tuple(NAMES)) -> Joints:
    return Joints(
        lambda obs, time, action: (jnp.zeros(()), jnp.zeros(())), action_size=len(names), dt=0.04, names=names
    )


@pytest.fixture(scope="module")
def star() -> CPGActions:
    return steered_by_oscillators(joints(), 3, CPGOptions())


def test_every_segment_follows_its_arm_by_the_actuators_names(star: CPGActions) -> None:
    state, action, step = jax.jit(star.reset)(jax.random.key(0)), star.leading_arm(1), jax.jit(star.step)
    for _ in range(40):
        state = step(state, action)
    now = oscillators_in(state.info)
    wanted = now.offsets + now.amplitudes * jnp.cos(now.phases)
    for name, told in zip(NAMES, state.obs, strict=True):
        oscillator = 2 * int(name.split("_")[1]) + ("out_of_plane" in name)
        assert told == pytest.approx(float(wanted[oscillator]))
    held_up = NAMES.index("star/arm_1_segment_0_out_of_plane_joint_p_control")
    assert state.obs[held_up] == pytest.approx(0.75, abs=1e-3)


def test_the_state_carries_the_oscillators_beside_the_environments_own(star: CPGActions) -> None:
    first = jax.jit(star.reset)(jax.random.key(0))
    assert set(first.info) == {
        *("own", "cpg_phases", "cpg_amplitudes", "cpg_amplitude_rates", "cpg_offsets", "cpg_offset_rates")
    }
    batch = jax.jit(jax.vmap(star.reset))(jax.random.split(jax.random.key(1), 4))
    after = jax.jit(jax.vmap(star.step))(batch, jnp.zeros((4, star.action_size)))
    assert jax.tree.structure(after) == jax.tree.structure(batch)
    assert after.info["cpg_phases"].shape == (4, 6)
    assert float(jnp.ptp(batch.info["cpg_phases"])) > 0  # not all alike
    assert after.obs.shape == (4, 12)


def test_what_leaves_the_range_of_the_joints_or_the_action_is_cut_off(star: CPGActions) -> None:
    state = jax.jit(star.reset)(jax.random.key(0))
    wild, most, step = state, state, jax.jit(star.step)
    for _ in range(25):
        wild, most = step(wild, jnp.full(star.action_size, 7.0)), step(most, jnp.ones(star.action_size))
        assert (jnp.abs(wild.obs) <= 1).all()
    np.testing.assert_array_equal(wild.obs, most.obs)


def test_a_leading_arm_is_a_choice_of_roles(star: CPGActions) -> None:
    np.testing.assert_allclose(star.of_roles(jnp.array([2, 0, 1])), star.leading_arm(1), atol=1e-6)
    traced = jax.jit(jax.vmap(star.leading_arm))(jnp.arange(3))
    assert traced.shape == (3, star.action_size) == (3, 22)


def test_sizes_and_times_are_those_of_the_environment_inside(star: CPGActions) -> None:
    inside = star.environment
    assert (star.dt, star.episode_length, star.num_arms) == (inside.dt, inside.episode_length, 3)
    assert star.model is inside.model


@pytest.mark.parametrize("name", ["abdomen", "arm_3_segment_0_in_plane_joint", "arm_0_segment_0_tendon_1"])
def test_an_actuator_of_no_arm_is_named(name: str) -> None:
    with pytest.raises(JobFailed, match=name):
        steered_by_oscillators(joints((name,)), 3, CPGOptions())


def test_steps_that_diverge_are_refused_with_the_number_that_does_not() -> None:
    # Phases: 2 · 3 · 20 · 1 = 120/s; over 0.04 s that is 4.8, and Euler bears 2.
    coarse = CPGOptions(integrator="euler")
    with pytest.raises(ValueError, match="raise num_steps to at least 3"):
        steered_by_oscillators(joints(), 3, coarse)
    assert steered_by_oscillators(joints(), 3, CPGOptions(integrator="euler", num_steps=3)).num_arms == 3


@pytest.mark.parametrize(
    ("gait", "sentence"),
    [
        (GaitOptions(frequency_hz=3), r"gait.frequency_hz = 3 is above max_frequency_hz = 2"),
        (GaitOptions(sweep=0.7), r"gait.sweep = 0.7 is above max_amplitude = 0.6"),
        (GaitOptions(sweep=0.1, stroke=0.7), r"gait.stroke = 0.7 is above max_amplitude"),
        (GaitOptions(sweep=0.6, stroke=0.6, lift=-0.9), r"gait.lift = 0.9 is above max_offset = 0.8"),
    ],
)
def test_a_gait_that_no_action_can_ask_for_is_refused(gait: GaitOptions, sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        CPGOptions(gait=gait, max_amplitude=0.6, max_offset=0.8)
