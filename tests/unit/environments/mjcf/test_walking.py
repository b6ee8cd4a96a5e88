"""Terms of robots that walk by command, on the probe: each number can be worked out by hand."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import Environment, State
from core.environments.task import TaskEnv
from core.errors import JobFailed, Rejected
from tests.unit.environments.mjcf.probe import KEY, XML, build
from tests.unit.environments.mjcf.test_environment import NO_TORQUE, moving

# A quarter turn to the left: the ball's x points to the world's y.
TURNED = [0, 0, 0.5, 0.70710678, 0, 0, 0.70710678, 0.25]
FORWARD = {"kind": "velocity", "forward": [0.3, 0.3], "left": [0, 0], "turn": [0, 0], "standing": 0}
TRACKS = {"kind": "track_linear_velocity"}
SERVO = XML.replace(
    b'<motor name="elbow" joint="elbow" gear="2" ctrllimited="true" ctrlrange="-0.5 1.5"/>',
    b'<position name="elbow" joint="elbow" kp="4" forcerange="-2 2"/>',
)


def seen(environment: Environment, qpos: list[float], qvel: list[float]) -> list[float]:
    """What is observed after a step from there."""
    state = moving(environment.reset(KEY), qpos=qpos, qvel=qvel)
    return np.asarray(jax.jit(environment.step)(state, NO_TORQUE).obs).tolist()


def test_the_root_is_observed_in_its_own_frame_and_joints_about_the_pose(tmp_path: Path) -> None:
    kinds = ["base_linear_velocity", "base_angular_velocity", "projected_gravity"]
    joints = [{"kind": "joint_positions"}, {"kind": "joint_velocities", "joints": ["elb.*"], "scale": 0.5}]
    environment = build(
        tmp_path,
        observation=[*({"kind": kind} for kind in kinds), *joints],
        reset={"keyframe": "raised", "position_noise": 0.0, "velocity_noise": 0.0},
        termination=[],
    )
    # 0.4 m/s along the world's y is forward; the elbow stands at 0.25 rad where the pose has 0.5.
    numbers = seen(environment, TURNED, [0, 0.4, 0, 0, 0, 0, 0])
    assert numbers[:9] == pytest.approx([0.4, 0, 0, 0, 0, 0, 0, 0, -1], abs=1e-3)
    assert numbers[9:] == pytest.approx([-0.25, 0], abs=0.02)


def test_a_command_is_drawn_anew_and_judged_as_the_action_knew_it(tmp_path: Path) -> None:
    command = {**FORWARD, "forward": [-1.0, 1.0], "every_s": 0.03}
    environment = build(
        tmp_path, command=command, observation=[{"kind": "command"}], reward=[TRACKS], termination=[]
    )
    state, step = environment.reset(KEY), jax.jit(environment.step)
    told = [float(state.obs[0])]
    rewards: list[float] = []
    for _ in range(6):
        state = step(state, NO_TORQUE)
        told.append(float(state.obs[0]))
        rewards.append(float(state.reward))
    assert len(set(told)) == 3
    assert told[0] == told[1] == told[2] != told[3]
    # The body rests: exp(-c² / 0.5²) of the command before the step.
    assert rewards == pytest.approx([np.exp(-(number**2) / 0.25) for number in told[:-1]], abs=1e-4)


def test_commands_keep_their_ranges_and_some_are_to_stand(tmp_path: Path) -> None:
    command = {
        "kind": "velocity",
        "forward": [0.5, 1.0],
        "left": [-0.2, 0.0],
        "turn": [2, 3],
        "standing": 0.5,
    }
    environment = build(tmp_path, command=command, observation=[{"kind": "command"}], reward=[TRACKS])
    commands = np.asarray(jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 400)).obs)
    stands = ~commands.any(axis=1)
    assert 0.4 < stands.mean() < 0.6
    assert (commands[~stands] >= [0.5, -0.2, 2.0]).all()
    assert (commands[~stands] <= [1.0, 0.0, 3.0]).all()


def test_a_push_changes_the_roots_velocity_when_it_is_due(tmp_path: Path) -> None:
    events = [{"kind": "push", "every_s": 0.03, "speed": 2.0}]
    environment = build(tmp_path, events=events, termination=[])
    state, step = environment.reset(KEY), jax.jit(environment.step)
    speeds: list[float] = []
    for _ in range(4):
        state = step(state, NO_TORQUE)
        speeds.append(float(jnp.abs(state.physics.qvel[:2]).max()))
    assert speeds[0] == speeds[1] == 0
    assert 0 < speeds[2] <= 2.0
    assert speeds[3] == pytest.approx(speeds[2], rel=1e-3)


def test_noise_stays_within_its_bounds_and_a_clip_after_the_scale(tmp_path: Path) -> None:
    term = {"kind": "projected_gravity", "noise": 0.1, "scale": 10.0, "clip": 9.5}
    environment = build(tmp_path, observation=[term])
    numbers = np.asarray(jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 200)).obs)
    assert np.abs(numbers[:, :2]).max() <= 1.0
    assert np.abs(numbers[:, :2]).max() > 0.9
    assert numbers[:, 2].min() == -9.5


def test_an_action_moves_a_servos_target_about_the_pose(tmp_path: Path) -> None:
    reset = {"keyframe": "raised", "position_noise": 0.0, "velocity_noise": 0.0}
    for scale, expected in ((None, 0.5 * 2 / 4), (0.4, 0.4), ({"elb.*": 0.3}, 0.3)):
        action = {"kind": "joint_position", "scale": scale}
        environment = build(tmp_path, SERVO, action=action, reset=reset)
        assert isinstance(environment, TaskEnv)
        assert environment.action_to_control.nominal(jnp.array([1.0])).tolist() == pytest.approx(
            [0.5 + expected]
        )


def test_feet_follow_the_clock_while_the_command_is_to_move(tmp_path: Path) -> None:
    def environment(command: dict[str, Any]) -> Environment:
        return build(
            tmp_path,
            command=command,
            feet=["b.*"],
            gait={"frequency": 1.0, "offsets": [0.25]},
            # Its lowest point is 0.05 m above the floor.
            reset={"qpos": [0, 0, 0.15, 1, 0, 0, 0, 0], "position_noise": 0.0, "velocity_noise": 0.0},
            observation=[{"kind": "gait_phase"}],
            reward=[TRACKS, {"kind": "swing_height", "height": 0.2, "tolerance": 0.1}],
            termination=[],
        )

    moves, stands = environment(FORWARD), environment({**FORWARD, "standing": 1})
    for made, is_moving in ((moves, True), (stands, False)):
        before = made.reset(KEY)
        after = made.step(before, NO_TORQUE)
        share = float(before.info["phase"]) + 0.25 + 0.01
        sine = np.sin(2 * np.pi * share)
        assert after.obs.tolist() == pytest.approx([sine, np.cos(2 * np.pi * share)], abs=1e-4)
        wanted = 0.2 * max(sine, 0.0) if is_moving else 0.0
        worth = float(after.metrics["reward_swing_height"])
        assert worth == pytest.approx(np.exp(-((0.05 - wanted) ** 2) / 0.1**2), abs=1e-4)


@pytest.mark.parametrize(
    ("height", "turn", "slips"),
    # The ball's lowest point is 5 mm above the floor, then 25 mm. At 4 rad/s it rolls as fast as it moves.
    [(0.105, 0.0, 0.16), (0.105, 4.0, 0.0), (0.105, -4.0, 0.64), (0.125, 0.0, 0.0)],
)
def test_a_foot_slips_where_its_sole_moves_along_the_ground(
    height: float, turn: float, slips: float, tmp_path: Path
) -> None:
    environment = build(tmp_path, feet=["ball"], reward=[{"kind": "foot_slip"}], termination=[])
    state = moving(
        environment.reset(KEY), qpos=[0, 0, height, 1, 0, 0, 0, 0], qvel=[0.4, 0, 0, 0, turn, 0, 0]
    )
    assert float(environment.step(state, NO_TORQUE).reward) == pytest.approx(-slips, abs=5e-3)


@pytest.mark.parametrize(
    ("options", "pointer", "words"),
    [
        ({"command": None}, "reward/0", "track_linear_velocity needs a `command`"),
        ({"reward": [{"kind": "alive"}]}, "command", "No term of the reward reads the command"),
        ({"gait": None}, "observation/7", "gait_phase needs a `gait`"),
        ({"feet": [".*_left_foot"]}, "feet/0", "no body that '.*_left_foot' matches"),
        ({"feet": [".*_link"]}, "feet", "match 29 bodies; a task has at most 8 feet"),
        ({"gait": {"offsets": [0.0]}}, "gait/offsets", "1 offsets, and the task 2 feet"),
        (
            {"action": {"kind": "joint_position", "scale": {"left_nee.*": 1.0}}},
            "action/scale",
            "'left_nee.*'",
        ),
    ],
)
def test_a_task_that_does_not_fit_the_robot_is_refused_with_its_place(
    options: dict[str, Any], pointer: str, words: str
) -> None:
    with pytest.raises(Rejected) as refused:
        catalog.resolve("g1", options)
    places = {problem.pointer: problem.detail for problem in refused.value.problems}
    assert words in places[f"/environment/options/{pointer}"]


def test_a_robot_stands_in_its_pose_and_sees_what_the_row_names() -> None:
    info, options = catalog.resolve("go1", {"command": {"kind": "velocity", "standing": 1.0}})
    from core.physics.choose import engine_builder

    environment = catalog.make(info, options, engine_builder("native"))
    state: State = environment.reset(KEY)
    step = jax.jit(environment.step)
    for _ in range(50):
        state = step(state, jnp.zeros(environment.action_size))
    assert float(state.done) == 0
    assert float(state.metrics["velocity_error"]) < 0.05
    assert state.obs.shape == (info.observation_size,)
    assert info.spaces.observation_size == info.observation_size


def test_a_model_gets_servos_a_pose_and_then_a_task(tmp_path: Path) -> None:
    edits = {
        "servos": [{"joints": ["elbow"], "kp": 8.0, "kd": 0.5, "effort": 4.0, "armature": 0.01}],
        "pose": {"joints": {"elbow": 0.3}, "height": 0.7},
    }
    action = {"kind": "joint_position"}
    environment = build(tmp_path, edits=edits, action=action, observation=[{"kind": "joint_positions"}])
    assert isinstance(environment, TaskEnv)
    state = environment.reset(KEY)
    assert state.physics.qpos.tolist() == pytest.approx([0, 0, 0.7, 1, 0, 0, 0, 0.3])
    assert state.obs.tolist() == [0.0]
    # Half of 4 N m pushes 4 / 8 / 2 = 0.25 rad from the pose.
    assert environment.action_to_control.nominal(jnp.array([1.0])).tolist() == pytest.approx([0.55])


def test_gains_that_blow_up_end_the_job(tmp_path: Path) -> None:
    servos = [{"joints": ["elbow"], "kp": 5000.0, "kd": 100.0}]
    with pytest.raises(JobFailed, match="does not hold the pose at a timestep"):
        build(tmp_path, edits={"servos": servos, "integrator": "euler"})


def test_a_motor_is_not_taken_for_a_servo(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match="'elbow' is no position servo"):
        build(tmp_path, action={"kind": "joint_position"})
