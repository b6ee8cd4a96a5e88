"""A body made of terms: each term reads the right numbers, and together they make the bodies we know."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import State
from core.environments.mjcf.info import MjcfOptions
from core.environments.task import TaskEnv
from core.environments.terms.describe import inventory
from core.errors import JobFailed
from core.physics.availability import EngineName
from core.physics.choose import engine_builder
from core.physics.model import brax_spec
from tests.unit.environments.mjcf.probe import KEY, MODEL, build, options

# Half a turn about z: the body's x points to the world's -x.
TURNED = [0.0, 0.0, 0.0, 1.0]
# Lying on its side: a quarter turn about x.
ON_ITS_SIDE = [0.70710678, 0.70710678, 0.0, 0.0]


def moving(state: State, *, qpos: list[float] | None = None, qvel: list[float] | None = None) -> State:
    """The same state, elsewhere or in motion."""
    physics = state.physics
    changed = replace(
        physics,
        qpos=physics.qpos if qpos is None else jnp.array(qpos),
        qvel=physics.qvel if qvel is None else jnp.array(qvel),
    )
    return replace(state, physics=changed)


STILL = {"position_noise": 0.0, "velocity_noise": 0.0}
# A hinge that a filtered motor drives, with a keyframe in motion.
FILTERED = b"""<mujoco><option timestep="0.004"/><worldbody><body name="u" pos="0 0 1">
  <joint name="j" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
  </body></worldbody>
  <actuator><general joint="j" dyntype="filter" dynprm=".5" gainprm="4" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="moving" qpos=".4" qvel="3" act=".7"/></keyframe></mujoco>"""
NO_TORQUE = jnp.array([-0.5])  # The middle of the control's range is not zero.
Earning = tuple[State, Callable[[State, jax.Array], State]]
FAST = [0.3, 0.4, 0, 0, 0, 0, 0]  # m/s of the ball
SHARE = 1.0 / 1.1  # of the ball's mass in all
LOW = {"kind": "height_range", "range": [0.4, 0.6]}
BENT = {"kind": "joint_range", "joints": ["elbow"], "range": [-0.5, 0.5]}


REWARDS: list[tuple[dict[str, Any], dict[str, Any], float]] = [
    ({"kind": "alive", "weight": 0.7}, {}, 0.7),
    ({"kind": "forward_velocity", "weight": 2.0}, {"qvel": FAST}, 0.6),
    ({"kind": "forward_velocity", "direction": [0, -3, 0]}, {"qvel": FAST}, -0.4),
    ({"kind": "forward_velocity", "body": "arm"}, {"qvel": FAST}, 0.3),
    ({"kind": "forward_velocity", "of": "centre_of_mass"}, {"qvel": FAST}, 0.3),
    # Half turned, -x is forward and -y is left.
    ({"kind": "velocity_tracking", "velocity": [-0.3, -0.4]}, {"qpos": TURNED, "qvel": FAST}, 1.0),
    ({"kind": "velocity_tracking", "velocity": [0.3, 0.4], "frame": "world"}, {"qvel": FAST}, 1.0),
    ({"kind": "velocity_tracking", "velocity": [0, 0]}, {"qvel": FAST}, 0.367879),
    ({"kind": "upright"}, {}, 1.0),
    ({"kind": "upright"}, {"qpos": ON_ITS_SIDE}, 0.0),
    ({"kind": "upright", "axis": [0, 2, 0]}, {"qpos": ON_ITS_SIDE}, 1.0),
    ({"kind": "height_range", "range": [0.4, 0.6]}, {}, 1.0),
    ({"kind": "height_range", "range": [0.6, 0.8]}, {}, 0.0),
    ({"kind": "height_range", "range": [0.4, None]}, {}, 1.0),
    ({"kind": "healthy", "unless": [LOW, BENT]}, {}, 1.0),
    ({"kind": "healthy", "unless": [LOW, BENT]}, {"elbow": 0.75}, 0.0),
    ({"kind": "healthy", "unless": [LOW, BENT]}, {"height": 0.3}, 0.0),
    # The ball is 0.5 m up: 3-4-5 to the point, times 0.1.
    ({"kind": "distance", "point": [0.3, 0.0, 0.1], "weight": 10.0}, {}, -5.0),
    ({"kind": "distance", "body": "ball", "target": "arm"}, {}, 0.0),
    ({"kind": "joint_limits", "share": 0.5}, {"elbow": 0.75}, -0.25),
    ({"kind": "joint_limits", "share": 0.5, "joints": ["elbow"]}, {"elbow": -0.6}, -0.1),
    ({"kind": "contact", "geoms": ["sphere"]}, {}, 0.0),
    ({"kind": "contact", "geoms": ["sphere", "rod"], "weight": -3.0}, {"height": 0.09}, -3.0),
    ({"kind": "contact", "geoms": ["sphere"], "against": "floor"}, {"height": 0.09}, 1.0),
    ({"kind": "contact", "geoms": ["sphere"], "against": "rod"}, {"height": 0.09}, 0.0),
]


@pytest.fixture(scope="module")
def earning(tmp_path_factory: pytest.TempPathFactory) -> Earning:
    """A begin and a compiled step of 0.01 s with all of these terms, `t0`, `t1`, …"""
    terms = [{**term, "name": f"t{number}"} for number, (term, _, _) in enumerate(REWARDS)]
    environment = build(tmp_path_factory.mktemp("rewards"), reward=terms, termination=[])
    return environment.reset(KEY), jax.jit(environment.step)


@pytest.mark.parametrize("number", range(len(REWARDS)))
def test_a_term_earns_what_it_says(number: int, earning: Earning) -> None:
    (_, where, expected), (begin, step) = REWARDS[number], earning
    rotation = where.get("qpos", [1.0, 0, 0, 0])
    qpos = [0, 0, where.get("height", 0.5), *rotation, where.get("elbow", 0.0)]
    after = step(moving(begin, qpos=qpos, qvel=where.get("qvel")), NO_TORQUE)
    assert float(after.metrics[f"reward_t{number}"]) == pytest.approx(expected, abs=2e-4)
    parts = [float(after.metrics[f"reward_t{each}"]) for each in range(len(REWARDS))]
    assert float(after.reward) == pytest.approx(sum(parts), abs=1e-4)


def test_a_reward_is_its_terms_added_from_first_to_last(tmp_path: Path) -> None:
    # In float32, 1e6 + 0.03 is 1e6.
    sums = list[float]()
    for weights in ((1e6, 0.03, -1e6), (1e6, -1e6, 0.03)):
        terms = [{"kind": "alive", "name": f"t{n}", "weight": weight} for n, weight in enumerate(weights)]
        environment = build(tmp_path, reward=terms)
        sums.append(float(environment.step(environment.reset(KEY), NO_TORQUE).reward))
    assert sums == [0.0, pytest.approx(0.03)]


def test_an_action_is_a_share_of_the_controls_range(tmp_path: Path) -> None:
    # The range [-0.5, 1.5] has 0.5 in its middle, and the gear of 2 makes 1 N m of that.
    environment = build(tmp_path, reward=[{"kind": "energy"}])
    state = environment.step(environment.reset(KEY), jnp.zeros(1))
    assert float(state.reward) == pytest.approx(-abs(1.0 * float(state.physics.qvel[6])), rel=1e-3)


def test_costs_of_actions_know_the_one_before(tmp_path: Path) -> None:
    terms = [{"kind": "control_cost", "weight": 0.5}, {"kind": "action_rate", "weight": 2.0}]
    environment = build(tmp_path, reward=terms, observation=[{"kind": "previous_action"}])
    state = environment.step(environment.reset(KEY), jnp.array([0.5]))
    assert float(state.reward) == pytest.approx(-0.5 * 0.25 - 2 * 0.25)
    assert state.obs.tolist() == [0.5]
    state = environment.step(state, jnp.array([-0.5]))
    assert float(state.metrics["reward_control_cost"]) == pytest.approx(-0.125)
    assert float(state.metrics["reward_action_rate"]) == pytest.approx(-2.0)  # 2 × (-0.5 - 0.5)²


OBSERVATIONS: list[tuple[dict[str, Any], list[float | None]]] = [
    ({"kind": "qpos"}, [0.5, 1, 0, 0, 0, 0]),
    ({"kind": "qpos", "root_position": "none"}, [1, 0, 0, 0, 0]),
    ({"kind": "qpos", "root_position": "all"}, [0, 0, 0.5, 1, 0, 0, 0, 0]),
    ({"kind": "qpos", "without": ["el.*"], "root_position": "none"}, [1, 0, 0, 0]),
    ({"kind": "height"}, [0.5]),
    ({"kind": "qvel"}, FAST),
    ({"kind": "sensors"}, [0.3, 0.4, 0, 0]),
    ({"kind": "sensors", "names": ["angle"]}, [0]),
    ({"kind": "body_positions", "bodies": ["arm"]}, [0.003, 0.004, 0.5]),
    ({"kind": "body_positions", "relative": True}, [0, 0, 0, 0, 0, 0]),
    ({"kind": "body_orientations", "bodies": ["ball"]}, [1, 0, 0, 0, 1, 0, 0, 0, 1]),
    ({"kind": "cvel", "bodies": ["ball"]}, [0, 0, 0, 0.3, 0.4, 0]),
    ({"kind": "qfrc_actuator"}, [0] * 7),
    # Its mass is at the end.
    ({"kind": "cinert", "bodies": ["ball"]}, [*[None] * 9, 1.0]),
    ({"kind": "body_inertias", "bodies": ["ball"]}, [*[None] * 9, 1.0]),
    ({"kind": "share_velocities", "bodies": ["ball"]}, [0.3 * SHARE, 0.4 * SHARE, 0, 0, 0, 0]),
]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> list[float]:
    """All of these, one after the other; the sensor of a termination is none of the model's own."""
    environment = build(
        tmp_path_factory.mktemp("observations"),
        observation=[term for term, _ in OBSERVATIONS],
        termination=[{"kind": "contact", "geoms": ["sphere"]}],
    )
    state = environment.step(moving(environment.reset(KEY), qvel=FAST), NO_TORQUE)
    assert environment.observation_size == state.obs.shape[0] == sum(len(row) for _, row in OBSERVATIONS)
    return state.obs.tolist()


@pytest.mark.parametrize("number", range(len(OBSERVATIONS)))
def test_an_observation_shows_what_it_says(number: int, seen: list[float]) -> None:
    term, expected = OBSERVATIONS[number]
    start = sum(len(row) for _, row in OBSERVATIONS[:number])
    shown = seen[start : start + len(expected)]
    for value, wanted in zip(shown, expected, strict=True):
        # It has moved by 5 mm.
        assert wanted is None or value == pytest.approx(wanted, abs=5e-3 if term["kind"] == "qpos" else 1e-3)


UP = [1.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("term", "goes_on", "ends"),
    [
        (LOW, [0.5, *UP], [0.3, *UP]),
        (BENT, [0.5, *UP], [0.5, *UP, 0.7]),
        ({"kind": "upright", "least": 0.5}, [0.5, *UP], [0.5, *ON_ITS_SIDE]),
        ({"kind": "contact", "geoms": ["sphere"]}, [0.5, *UP], [0.09, *UP]),
    ],
)
def test_an_episode_ends_where_a_term_says_so(
    term: dict[str, Any], goes_on: list[float], ends: list[float], tmp_path: Path
) -> None:
    environment = build(tmp_path, termination=[term])
    begin = environment.reset(KEY)
    for place, done in ((goes_on, 0), (ends, 1)):
        state = moving(begin, qpos=[0, 0, *place, 0][:8])
        assert float(environment.step(state, jnp.zeros(1)).done) == done


def test_without_a_word_a_body_that_can_travel_ends_when_it_falls(tmp_path: Path) -> None:
    environment = build(tmp_path)
    start = environment.reset(KEY)
    names = {"reward_forward_velocity", "reward_alive", "reward_control_cost", "height", "x_velocity"}
    assert names <= set(start.metrics)
    for height, ends in ((0.21, 0), (0.19, 1), (0.99, 0), (1.01, 1)):  # 0.4 and 2 times 0.5 m
        state = moving(start, qpos=[0, 0, height, 1, 0, 0, 0, 0])
        assert float(environment.step(state, jnp.zeros(1)).done) == ends


def test_an_episode_begins_as_the_reset_says(tmp_path: Path) -> None:
    still = {"position_noise": 0.0, "velocity_noise": 0.0}
    raised = build(tmp_path, reset={"keyframe": "raised", **still}).reset(KEY).physics.qpos
    np.testing.assert_allclose(raised, [0, 0, 0.8, 1, 0, 0, 0, 0.5])
    by_number = build(tmp_path, reset={"keyframe": 0, **still}).reset(KEY).physics.qpos
    np.testing.assert_array_equal(by_number, raised)
    given = build(tmp_path, reset={"qpos": [1, 2, 3, 1, 0, 0, 0, 0.1], **still}).reset(KEY).physics.qpos
    np.testing.assert_allclose(given, [1, 2, 3, 1, 0, 0, 0, 0.1])
    noisy = build(tmp_path, reset={"position_noise": 0.1, "velocity_noise": 0.0}).reset(KEY).physics
    assert 0 < float(jnp.abs(noisy.qpos - jnp.array([0, 0, 0.5, 1, 0, 0, 0, 0])).max()) <= 0.1
    assert not noisy.qvel.any()


ANT = {
    "reward": [
        {"kind": "forward_velocity", "body": "torso"},
        {"kind": "alive"},
        {"kind": "control_cost", "weight": 0.5},
    ],
    "termination": [{"kind": "height_range", "body": "torso", "range": [0.2, 1.0]}],
    "n_frames": 5,
}


@pytest.mark.parametrize("engine", ["native", "compiled"])
def test_an_episode_begins_in_the_motion_of_its_keyframe(engine: EngineName, tmp_path: Path) -> None:
    begins = {**STILL, "keyframe": "moving"}
    seen = [{"kind": "qpos"}, {"kind": "qvel"}, {"kind": "act"}]
    given = {"reset": begins, "observation": seen, "reward": [{"kind": "alive"}]}
    environment = build(tmp_path, FILTERED, engine=engine, **given)
    start = environment.reset(KEY)
    np.testing.assert_allclose(start.obs, [0.4, 3.0, 0.7], rtol=1e-6)
    # One step of C MuJoCo from the keyframe, under the same control.
    model = mujoco.MjModel.from_xml_string(FILTERED.decode())
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0.5
    mujoco.mj_step(model, data)
    after = jax.jit(environment.step)(start, jnp.array([0.5]))
    np.testing.assert_allclose(after.obs, [*data.qpos, *data.qvel, *data.act], rtol=1e-5)
    assert isinstance(environment, TaskEnv)
    for begin in environment.simulation().starts:
        np.testing.assert_allclose([*begin.qpos, *begin.qvel, *begin.act], [0.4, 3.0, 0.7], rtol=1e-6)
    # Noise comes on top.
    noisy = build(tmp_path, FILTERED, engine=engine, **{**given, "reset": {**begins, "velocity_noise": 0.5}})
    velocities = [float(noisy.reset(jax.random.key(seed)).physics.qvel[0]) for seed in range(3)]
    assert len(set(velocities)) == 3
    assert all(2.5 < velocity < 3.5 for velocity in velocities)


def test_the_ant_made_of_terms_is_the_ant() -> None:
    info = catalog.find("ant")
    builtin = catalog.make(info, catalog.parse_options(info, {}), engine_builder("native"))
    spec = brax_spec("ant")
    spec.option.iterations = builtin.model.opt.iterations
    model = spec.compile()
    chosen = catalog.parse_options(catalog.find("mjcf"), options(**ANT))
    assert isinstance(chosen, MjcfOptions)
    made = TaskEnv(chosen, inventory(model), spec, model, engine_builder("native"))
    assert (made.observation_size, made.dt) == (builtin.observation_size, pytest.approx(builtin.dt))
    step, again = jax.jit(jax.vmap(builtin.step)), jax.jit(jax.vmap(made.step))
    ants = jax.jit(jax.vmap(builtin.reset))(jax.random.split(jax.random.key(1), 16))
    blank = jax.jit(jax.vmap(made.reset))(jax.random.split(jax.random.key(2), 16))
    ended = 0.0
    for number in range(60):
        action = jax.random.uniform(jax.random.key(number), (16, 8), minval=-1.0, maxval=1.0)
        rebuilt = again(replace(blank, physics=ants.physics), action)
        ants = step(ants, action)
        np.testing.assert_allclose(rebuilt.reward, ants.reward, atol=2e-4)
        np.testing.assert_allclose(rebuilt.obs, ants.obs, atol=2e-4)
        np.testing.assert_array_equal(rebuilt.done, ants.done)
        ended += float(ants.done.sum())
    assert ended > 0  # Some have been on both sides of the healthy range.


def test_a_term_that_does_not_fit_the_file_ends_the_job_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match="no body 'bal'; did you mean 'ball'") as failure:
        build(tmp_path, root="bal")
    assert failure.value.reason == "bad_model"
    assert [file.name for file in tmp_path.iterdir()] == ["model"]


def test_without_its_file_there_is_no_body() -> None:
    info = catalog.find("mjcf")
    with pytest.raises(JobFailed, match="is missing"):
        catalog.make(info, catalog.parse_options(info, {"model": MODEL}), engine_builder("native"))
