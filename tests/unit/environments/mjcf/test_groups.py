"""What a policy sees and what its value function sees, on the probe."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.algorithms import catalog as algorithms
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sac.spec import SACSpec
from core.environments import catalog
from core.environments.info import CRITIC_GROUP, POLICY_GROUP
from core.environments.mjcf.check import problems
from core.environments.mjcf.info import MjcfOptions
from core.environments.robots.info import Go1Options
from core.environments.terms.describe import inventory
from core.environments.terms.task import task_slices
from core.errors import Rejected
from tests.unit.environments.mjcf.probe import KEY, XML, build, options
from tests.unit.environments.mjcf.test_environment import moving

GRAVITY = {"kind": "projected_gravity", "noise": 0.5}
SPEED = {"kind": "base_linear_velocity"}


def checked(**given: Any) -> MjcfOptions:
    parsed = catalog.parse_options(catalog.find("mjcf"), options(**given))
    assert isinstance(parsed, MjcfOptions)
    return parsed


def wrong(**given: Any) -> dict[str, str]:
    """The problems of these options with the probe, by pointer."""
    found = problems(checked(**given), inventory(mujoco.MjModel.from_xml_string(XML.decode())))
    return {problem.pointer.removeprefix("/environment/options/"): problem.detail for problem in found}


def test_the_critic_sees_its_own_terms_and_without_noise(tmp_path: Path) -> None:
    environment = build(tmp_path, observation=[GRAVITY], critic=[SPEED, GRAVITY])
    assert environment.observation_size == {POLICY_GROUP: 3, CRITIC_GROUP: 6}
    state = environment.reset(KEY)
    assert state.obs[CRITIC_GROUP].tolist() == [0, 0, 0, 0, 0, -1]
    assert (np.abs(state.obs[POLICY_GROUP] - np.array([0, 0, -1])) > 0).all()
    without = build(tmp_path, observation=[GRAVITY]).reset(KEY)
    np.testing.assert_array_equal(without.obs, state.obs[POLICY_GROUP])


def test_the_critic_sees_how_far_the_episodes_physics_is_from_the_models(tmp_path: Path) -> None:
    seen = [
        {"kind": "randomized", "field": "geom_friction", "names": ["sphere", "floor"], "axis": 0},
        {"kind": "randomized", "field": "dof_damping", "names": ["elbow"]},
        {"kind": "randomized", "field": "body_mass", "names": ["arm"]},
        {"kind": "randomized", "field": "opt.gravity", "axis": 2},
    ]
    given = {"observation": [GRAVITY], "critic": [GRAVITY, *seen]}
    environment = build(tmp_path, **given)
    model = environment.model
    friction = jnp.asarray(model.geom_friction, jnp.float32).at[model.geom("sphere").id, 0].set(0.5)
    damping = jnp.asarray(model.dof_damping, jnp.float32).at[6].set(0.2)
    state = environment.reset(KEY, {"geom_friction": friction, "dof_damping": damping})
    after = jax.jit(environment.step)(state, jnp.zeros(1))
    # A friction of 0.5 is half of 1; the elbow has no damping of its own.
    for shown in (state, after):
        assert shown.obs[CRITIC_GROUP][3:].tolist() == pytest.approx([-0.5, 0, 0.2, 0, 0])
    parts = task_slices(checked(**given), inventory(model)).critic
    assert [part.components for part in parts[1:]] == [("sphere", "floor"), ("elbow",), ("arm",), ("",)]


def test_ppo_values_what_the_critic_sees_and_others_refuse_it() -> None:
    seen = [term.model_dump() for term in Go1Options().observation or []]
    info, _ = catalog.resolve("go1", {"critic": seen})
    plain = catalog.find("go1")
    for row, expected in ((info, CRITIC_GROUP), (plain, POLICY_GROUP)):
        settings = algorithms.resolve(PPOSpec(), row, "cpu")
        assert (settings.policy_obs_key, settings.value_obs_key) == (POLICY_GROUP, expected)
    assert algorithms.resolve(PPOSpec(value_obs_key="state"), info, "cpu").value_obs_key == "state"
    with pytest.raises(Rejected, match="nothing would see the critic's") as refused:
        algorithms.resolve(SACSpec(), info, "cpu")
    assert refused.value.problems[0].pointer == "/environment/options/critic"


@pytest.mark.parametrize(
    ("given", "pointer", "words"),
    [
        ({"observation": [GRAVITY], "critic": [SPEED]}, "critic", "less than the policy, which sees 'x' of"),
        ({"critic": [{"kind": "qpos", "root_position": "none"}]}, "critic", "less than the policy"),
        (
            {"critic": [{"kind": "randomized", "field": "geom_friction", "names": ["ball"]}]},
            "critic/0/names/0",
            "no geom 'ball'",
        ),
        ({"critic": [{"kind": "randomized", "field": "body_mass", "axis": 1}]}, "critic/0/axis", "1 number"),
        (
            {"critic": [{"kind": "randomized", "field": "opt.gravity", "names": ["ball"]}]},
            "critic/0/names",
            "whole model",
        ),
    ],
)
def test_a_critic_that_does_not_fit_is_refused_with_its_place(
    given: dict[str, Any], pointer: str, words: str
) -> None:
    assert words in wrong(**given)[pointer]


def test_a_policy_sees_no_randomized_physics() -> None:
    with pytest.raises(Rejected, match="'randomized'"):
        checked(observation=[{"kind": "randomized", "field": "body_mass"}])


def test_the_last_values_are_seen_and_late_by_the_episodes_delay(tmp_path: Path) -> None:
    # The ball glides at 0.3 m/s, so that each control step of 0.01 s adds 0.003 m.
    glides = {"position_noise": 0.0, "velocity_noise": 0.0}
    place = {"kind": "body_positions", "bodies": ["ball"], "scale": 1000.0, "clip": 900.0}
    environment = build(
        tmp_path,
        observation=[place | {"history": 3}, place | {"delay": [0.015, 0.035], "bias": 1e-6}],
        critic=[place | {"delay": [0.02, 0.02], "bias": 1.0}],
        reset=glides,
        termination=[],
    )
    assert environment.observation_size == {POLICY_GROUP: 12, CRITIC_GROUP: 3}
    step = jax.jit(environment.step)
    late = set[int]()
    for key in jax.random.split(KEY, 6):
        state = moving(environment.reset(key), qvel=[0.3, 0, 0, 0, 0, 0, 0])
        seen = [np.asarray(state.obs[POLICY_GROUP])]
        for _ in range(5):
            state = step(state, jnp.array([-0.5]))
            seen.append(np.asarray(state.obs[POLICY_GROUP]))
        np.testing.assert_allclose(seen[0], [0, 0, 500] * 4, atol=2e-3)
        np.testing.assert_allclose([row[[0, 3, 6]] for row in seen[1:3]], [[0, 0, 3], [0, 3, 6]], atol=2e-3)
        np.testing.assert_allclose(state.obs[CRITIC_GROUP], [15, 0, 500], atol=2e-3)
        delay = int(state.info["state_delays"][1])
        late.add(delay)
        np.testing.assert_allclose(
            [row[9] for row in seen[1:]], [3 * max(0, n - delay) for n in range(1, 6)], atol=2e-3
        )
        bias = seen[5][9:12] - [3 * (5 - delay), 0, 500]
        assert (np.abs(bias) <= 1e-3 + 1e-4).all()
    assert late == {2, 3}


def test_a_bias_stays_for_the_episode(tmp_path: Path) -> None:
    environment = build(tmp_path, observation=[{"kind": "joint_positions", "bias": 0.1}], termination=[])
    states = jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 200))
    first = np.asarray(states.obs)
    assert 0.09 < np.abs(first).max() <= 0.1
    later = jax.jit(jax.vmap(environment.step))(states, jnp.full((200, 1), -0.5))
    np.testing.assert_allclose(later.obs, first, atol=1e-3)


def test_a_delay_that_is_no_control_step_is_refused_with_its_place() -> None:
    for delay, words in (([0, 0.004], "except none"), ([0.012, 0.018], "take for example [0.01, 0.01]")):
        found = wrong(observation=[{"kind": "qpos", "delay": delay}])
        assert words in found["observation/0/delay"]
    assert not wrong(observation=[{"kind": "qpos", "delay": [0.01, 0.03]}])


def test_the_past_has_names() -> None:
    model = inventory(mujoco.MjModel.from_xml_string(XML.decode()))
    given = checked(observation=[{"kind": "joint_positions", "history": 3}])
    parts = task_slices(given, model).observation
    assert [part.components for part in parts] == [("elbow t-2",), ("elbow t-1",), ("elbow",)]
    assert [part.start for part in parts] == [0, 1, 2]
