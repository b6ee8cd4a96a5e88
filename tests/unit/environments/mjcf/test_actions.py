"""How actions become controls, on the probe: which joints they move, when, how smoothly and how strongly."""

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
from tests.unit.environments.mjcf.test_environment import moving

# A second arm that is like the first, with a servo.
TWO_ARMS = (
    XML.replace(
        b"</body>\n    </body>\n  </worldbody>",
        b'</body><body name="other"><joint name="wrist" axis="0 1 0"/><geom type="capsule" size="0.01" '
        b'fromto="0 0 0 -0.3 0 0" mass="0.1" contype="0" conaffinity="0"/></body></body></worldbody>',
    )
    .replace(b"</actuator>", b'<position name="wrist" joint="wrist" kp="4"/></actuator>')
    .replace(b"1 0 0 0 0.5", b"1 0 0 0 0.5 0.2")
)
FORCES = [{"kind": "qfrc_actuator"}]


def servo(**given: Any) -> dict[str, Any]:
    return {"servos": [{"joints": ["elbow"], "effort": 4.0, **given}]}


def walked(environment: Environment, key: jax.Array, actions: list[float]) -> State:
    state, step = environment.reset(key), jax.jit(environment.step)
    for action in actions:
        state = step(state, jnp.array([action]))
    return state


def test_actions_come_late_and_smoothly(tmp_path: Path) -> None:
    edits, position = servo(kp=8.0), {"kind": "joint_position"}
    plain = build(tmp_path, edits=edits, action=position)
    late = build(tmp_path, edits=edits, action=position | {"delay": [0.01, 0.02], "smoothing": 0.5})
    delays = set[int]()
    for key in jax.random.split(KEY, 4):
        state = walked(late, key, [1.0, 1.0, -1.0, 0.0])
        delay = int(state.info["action_delay"])
        delays.add(delay)
        # Half of what was before and half of what arrives: 0.5, 0.75, then −0.125.
        smooth = [*[0.0] * delay, 0.5, 0.75, -0.125][:4]
        np.testing.assert_array_equal(state.physics.qpos, walked(plain, key, smooth).physics.qpos)
    assert delays == {1, 2}
    assert isinstance(late, TaskEnv)
    carried = {name for name, _ in late.simulation().control.document()["inputs"]}
    assert "state.past_actions" in carried


def test_a_velocity_servo_turns_as_fast_as_it_is_told(tmp_path: Path) -> None:
    action = {"kind": "joint_velocity"}
    for scale, expected in ((None, 3.0), (2.0, 2.0)):
        edits = servo(control="velocity", kd=1.0, velocity_limit=3.0)
        environment = build(tmp_path, edits=edits, action=action | {"scale": scale}, termination=[])
        state = walked(environment, KEY, [1.0] * 10)
        assert float(state.physics.qvel[6]) == pytest.approx(expected, abs=0.02)


def test_an_effort_is_the_torque_at_the_joint(tmp_path: Path) -> None:
    for scale, expected in ((None, 3.0), (0.5, 0.5), ({"elb.*": 0.2}, 0.2)):
        # The motor's gear is 2, and its control at most 1.5.
        action = {"kind": "joint_effort", "scale": scale}
        environment = build(tmp_path, action=action, observation=FORCES)
        assert float(walked(environment, KEY, [1.0]).obs[6]) == pytest.approx(expected)
    environment = build(
        tmp_path, edits=servo(control="effort"), action={"kind": "joint_effort"}, observation=FORCES
    )
    assert float(walked(environment, KEY, [-0.5]).obs[6]) == pytest.approx(-2.0)


def test_joints_that_no_pattern_matches_keep_the_pose(tmp_path: Path) -> None:
    environment = build(
        tmp_path,
        TWO_ARMS,
        action={"kind": "joint_effort", "joints": ["elbow"]},
        observation=[{"kind": "previous_action"}],
        reset={"keyframe": "raised", "position_noise": 0.0, "velocity_noise": 0.0},
    )
    assert isinstance(environment, TaskEnv)
    assert environment.action_size == 1
    assert environment.action_to_control.nominal(jnp.array([0.5])).tolist() == pytest.approx([0.75, 0.2])
    assert walked(environment, KEY, [0.25]).obs.tolist() == [0.25]
    info, _ = catalog.resolve("go1", {"action": {"kind": "joint_position", "joints": [".*_calf_joint"]}})
    assert info.action_size == info.spaces.action_size == 4
    previous = next(part for part in info.spaces.observation if part.name == "previous_action")
    assert previous.size == 4


def test_joints_are_driven_in_several_ways(tmp_path: Path) -> None:
    terms = [
        {"kind": "joint_position", "joints": ["wrist"], "scale": 0.3},
        {"kind": "joint_effort", "joints": ["elbow"]},
    ]
    environment = build(
        tmp_path,
        TWO_ARMS,
        action={"kind": "mixed", "terms": terms, "smoothing": 0.5},
        observation=[{"kind": "previous_action"}],
        reset={"keyframe": "raised", "position_noise": 0.0, "velocity_noise": 0.0},
    )
    assert isinstance(environment, TaskEnv)
    # In the actuators' order. The motor's 3 N m are 1.5 by a gear of 2; the wrist is at 0.2 rad.
    assert environment.action_to_control.nominal(jnp.array([0.5, -1.0])).tolist() == pytest.approx(
        [0.75, -0.1]
    )
    robot = environment.deployment()
    assert [(one.name, one.target, one.stiffness) for one in robot.joints] == [
        ("elbow", "effort", 0.0),
        ("wrist", "position", 4.0),
    ]
    assert robot.offset == pytest.approx([0.0, 0.2])
    assert robot.scale == pytest.approx([3.0, 0.3])
    assert robot.bounds[0] == pytest.approx((-1.0, 3.0))
    assert set(environment.simulation().control.outputs) == {"control"}


def test_servos_follow_what_their_encoders_read(tmp_path: Path) -> None:
    seen = [{"kind": "joint_velocities"}, {"kind": "joint_positions", "bias": 0.1}]
    common = {"edits": servo(kp=8.0), "observation": seen, "termination": []}
    action = {"kind": "joint_position", "scale": 1.0}
    follows = build(tmp_path, action=action | {"encoder_bias": True}, **common)
    plain = build(tmp_path, action=action, **common)
    bias = float(follows.reset(KEY).info["state_bias"][1])
    assert 0.0 < abs(bias) <= 0.1
    # The joint is where it is read at the target, less the bias.
    biased, shifted = walked(follows, KEY, [0.2] * 5), walked(plain, KEY, [0.2 - bias] * 5)
    np.testing.assert_allclose(biased.physics.qpos, shifted.physics.qpos, atol=1e-6)
    assert abs(float(walked(plain, KEY, [0.2] * 5).physics.qpos[7] - biased.physics.qpos[7])) > 1e-3


def test_a_motor_has_less_torque_the_faster_it_turns(tmp_path: Path) -> None:
    action = {"kind": "joint_position", "scale": 100.0, "torque_speed_curve": True}
    for limits, by_speed in (
        ({}, {0: 4, 5: 2, 12: 0, -5: 4}),
        # From 8 N m at rest, of which the servo gives 4 at most.
        ({"saturation_effort": 8.0}, {0: 4, 2.5: 4, 7.5: 2, 12: 0}),
    ):
        edits = servo(kp=8.0, velocity_limit=10.0, **limits)
        environment = build(tmp_path, edits=edits, action=action, observation=FORCES, termination=[])
        fresh, step = environment.reset(KEY), jax.jit(environment.step)
        for speed, torque in by_speed.items():
            for sign in (1.0, -1.0):
                state = moving(fresh, qvel=[0, 0, 0, 0, 0, 0, sign * speed])
                after = step(state, jnp.array([sign]))
                assert float(after.obs[6]) == pytest.approx(sign * torque, abs=1e-5)
                assert dict(after.physics.model) == {}


def test_a_randomized_force_range_is_narrowed_by_the_curve(tmp_path: Path) -> None:
    edits = servo(kp=8.0, velocity_limit=10.0)
    action = {"kind": "joint_position", "scale": 100.0, "torque_speed_curve": True}
    environment = build(tmp_path, edits=edits, action=action, observation=FORCES, termination=[])
    weak = environment.reset(KEY, {"actuator_forcerange": jnp.array([[-1.0, 1.0]])})
    fast = moving(weak, qvel=[0, 0, 0, 0, 0, 0, 5.0])
    for state, torque in ((weak, 1.0), (fast, 1.0), (moving(weak, qvel=[0, 0, 0, 0, 0, 0, 9.0]), 0.4)):
        assert float(environment.step(state, jnp.array([1.0])).obs[6]) == pytest.approx(torque, abs=1e-5)


@pytest.mark.parametrize(
    ("action", "pointer", "words"),
    [
        ({"kind": "joint_effort"}, "action/kind", "'FR_hip_joint' is no motor"),
        ({"kind": "joint_velocity"}, "action/kind", "is no velocity servo"),
        ({"kind": "joint_position", "joints": [".*_toe"]}, "action/joints/0", "'.*_toe'"),
        (
            {
                "kind": "mixed",
                "terms": [
                    {"kind": "joint_position", "joints": [".*_calf_joint"]},
                    {"kind": "joint_position", "joints": ["F.*"]},
                ],
            },
            "action/terms/1/joints",
            "'FR_calf_joint' is driven by term 0",
        ),
        (
            {"kind": "mixed", "terms": [{"kind": "joint_velocity", "joints": [".*"]}]},
            "action/terms/0/kind",
            "no velocity servo",
        ),
        ({"kind": "joint_position", "encoder_bias": True}, "action/encoder_bias", "has a `bias`"),
        ({"kind": "joint_position", "delay": [0, 0.01]}, "action/delay", "0.02 s lies between"),
    ],
)
def test_an_action_that_does_not_fit_is_refused_with_its_place(
    action: dict[str, Any], pointer: str, words: str
) -> None:
    with pytest.raises(Rejected) as refused:
        catalog.resolve("go1", {"action": action})
    places = {problem.pointer: problem.detail for problem in refused.value.problems}
    assert words in places[f"/environment/options/{pointer}"]


def test_what_the_model_lacks_ends_the_job(tmp_path: Path) -> None:
    with pytest.raises(JobFailed, match="no torque-speed curve"):
        build(tmp_path, action={"kind": "control", "torque_speed_curve": True})
    with pytest.raises(JobFailed, match="could keep the pose"):
        build(tmp_path, TWO_ARMS, action={"kind": "joint_position", "joints": ["wrist"]})
