"""`policy.robot.onnx`: what a robot measures becomes the targets that the training's environment sets."""

import json
import runpy
import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from subprocess import run
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
import pytest
from onnx.reference import ReferenceEvaluator

from core.algorithms.export.contract import PolicyOrigin, contract
from core.algorithms.export.network import NotExportable, PolicyLayer, PolicyNetwork, network_of
from core.algorithms.export.onnx_file import onnx_file
from core.algorithms.export.robot_file import policy_metadata, robot_file
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.deployment import Deployment, Joint, NotDeployed, SeenTerm
from core.environments.task import TaskEnv
from core.environments.terms.commands import GaitClock
from core.environments.terms.sensed import CLOCK, PREVIOUS_ACTION, Sensed
from core.physics.choose import engine_builder
from tests.exports import numpy_answers, numpy_file_of, policy_file
from tests.unit.environments.mjcf.probe import MODEL

EXAMPLES = Path(__file__).parents[3] / "examples"
FEET = [f"{end}_{side}_shank" for end in ("front", "hind") for side in ("left", "right")]
OPTIONS: dict[str, Any] = {
    "model": MODEL,
    "action": {"kind": "joint_position", "scale": 0.3},
    "command": {"kind": "velocity", "forward": [0.5, 0.5], "left": [0, 0], "turn": [0.2, 0.2], "standing": 0},
    "feet": FEET,
    "gait": {"frequency": 2.0, "offsets": [0.0, 0.5, 0.5, 0.0]},
    "observation": [
        {"kind": "base_linear_velocity", "clip": 0.2},
        {"kind": "base_angular_velocity", "scale": 0.25, "noise": 0.5},
        {"kind": "projected_gravity"},
        {"kind": "command"},
        {"kind": "joint_positions", "joints": [".*_knee", ".*_hip"]},
        {"kind": "joint_velocities", "scale": 0.05},
        {"kind": "previous_action"},
        {"kind": "gait_phase"},
    ],
    "reward": [{"kind": "track_linear_velocity"}],
    "termination": [],
    "reset": {"keyframe": "home", "position_noise": 0.0, "velocity_noise": 0.0},
}


def quadruped(folder: Path, **changes: Any) -> TaskEnv:
    """The example's robot under these options."""
    file = folder / "model"
    file.write_bytes((EXAMPLES / "quadruped.xml").read_bytes())
    info = catalog.find("mjcf")
    made = catalog.make(
        info, catalog.parse_options(info, {**OPTIONS, **changes}), engine_builder("native"), file
    )
    assert isinstance(made, TaskEnv)
    return made


def policy_of(environment: TaskEnv) -> bytes:
    settings = PPOSpec.model_validate({"policy_hidden_layer_sizes": [16]})
    seen = np.random.default_rng(0).normal(0, 1, (100, environment.observation_size)).astype(np.float32)
    return policy_file(settings, seen, environment.action_size)


def about_of(environment: TaskEnv, policy: bytes) -> Mapping[str, Any]:
    robot = environment.deployment().document()
    origin = PolicyOrigin("ppo", "mjcf", {}, step_s=environment.dt, trained_steps=0, robot=robot)
    return contract(network_of(policy), origin)


def test_the_example_sets_the_targets_of_the_environment(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    observed = [{**term, "noise": 0.0} for term in OPTIONS["observation"]]
    environment = quadruped(tmp_path, observation=observed)
    policy = policy_of(environment)
    robot = tmp_path / "robot.onnx"
    network = network_of(policy)
    robot.write_bytes(robot_file(network, environment.deployment(), about_of(environment, policy)))
    program = runpy.run_path(str(EXAMPLES / "deploy.py"))
    command = np.array([0.5, 0.0, 0.2])
    steps = islice(program["drive"](str(robot), str(EXAMPLES / "quadruped.xml"), command), 50)
    deployed = [(data.ctrl.copy(), data.qpos.copy()) for _, data in steps]

    state = environment.reset(jax.random.key(0))
    # The robot's clock begins at 0, and not at a random share of a round.
    phases = 2 * np.pi * np.array(OPTIONS["gait"]["offsets"])
    obs = state.obs.at[-8:].set(jnp.concatenate([jnp.sin(phases), jnp.cos(phases)]))
    state = state.replace(obs=obs, info={**state.info, "phase": jnp.zeros(())})
    step, for_numpy = jax.jit(environment.step), numpy_file_of(policy)
    low, high = environment.model.actuator_ctrlrange.T
    for number, (targets, qpos) in enumerate(deployed):
        action = numpy_answers(for_numpy, np.asarray(state.obs))
        expected = np.clip(environment.action_to_control.nominal(jnp.asarray(action)), low, high)
        np.testing.assert_allclose(targets, expected, rtol=0, atol=1e-4, err_msg=f"step {number}")
        state = step(state, jnp.asarray(action))
        np.testing.assert_allclose(qpos, state.physics.qpos, rtol=0, atol=1e-3, err_msg=f"step {number}")


def test_the_example_says_how_it_is_called() -> None:
    pytest.importorskip("onnxruntime")
    program = EXAMPLES / "deploy.py"
    said = run([sys.executable, program, "--help"], capture_output=True, text=True, check=True).stdout
    assert "No window: --command 0.5 0 0 --seconds 2" in said
    assert all(word in said for word in ("robot.onnx", "rad/s", "arrows steer", "its place is printed"))
    assert len(program.read_text().splitlines()) <= 80


# Two joints, whose servos come in the other order; a third one that nothing drives.
DRIVEN = {"armature": 0.0, "friction_loss": 0.0, "joint_damping": 0.0}
HAND = Deployment(
    terms=[
        SeenTerm(
            "joint_positions", 1, 2.0, 1.5, 3, Sensed("joint_positions", ("a", "b", "c"), "rad", (1,), (0.5,))
        ),
        SeenTerm("previous_action", 2, 1.0, None, 1, Sensed(PREVIOUS_ACTION, ("b", "a"), "1")),
        SeenTerm("gait_phase", 2, 1.0, None, 1, Sensed(CLOCK, ("share",), "1")),
    ],
    joints=[
        Joint("a", 0.1, 20.0, 1.0, 7.0, target="position", **DRIVEN),
        Joint("b", 0.2, 30.0, 2.0, None, target="position", **DRIVEN),
        Joint("c", 0.3, None, None, None, target=None, **DRIVEN),
    ],
    acting=[1, 0],
    actuators=[0, 1],
    smoothing=0.0,
    offset=[0.2, 0.1],
    scale=[10.0, 100.0],
    bounds=[(-1.0, 1.0), None],
    command=None,
    gait=GaitClock(frequency=2.5, offsets=[0.25]),
    qpos=[0.1, 0.2, 0.3],
    physics_step_s=0.005,
    integrator="implicitfast",
)


def hand_network(size: int = 7) -> PolicyNetwork:
    """The action: tanh of the newest position seen, and of the oldest."""
    kernel = np.zeros((size, 4), np.float32)
    kernel[2, 0] = kernel[0, 1] = 1.0
    layer = PolicyLayer(kernel, np.zeros(4, np.float32))
    zeros, ones = np.zeros(size, np.float32), np.ones(size, np.float32)
    return PolicyNetwork(zeros, ones, None, (layer,), "relu", "state", 1)


def about_of_hand() -> Mapping[str, Any]:
    return contract(hand_network(), PolicyOrigin("ppo", "mjcf", {}, step_s=0.1, trained_steps=0))


def test_the_file_keeps_what_is_past_and_orders_targets_by_joint() -> None:
    content = robot_file(hand_network(), HAND, about_of_hand())
    evaluate = ReferenceEvaluator(onnx.load_from_string(content))
    told = metadata_of(content)
    assert [(one["name"], one["components"]) for one in json.loads(told["inputs"])] == [
        ("joint_positions", ["a", "b", "c"])
    ]
    values = {name: np.zeros((1, size), np.float32) for name, size in STATE_SIZES.items()}
    state = json.loads(told["state"])
    assert state.keys() == values.keys()
    seen: list[list[float]] = []
    # b − 0.5, doubled, within ± 1.5; the first value stands for those before it.
    for position in (0.6, 0.9, 5.0, 0.5):
        values["joint_positions"] = np.array([[9.0, position, 9.0]], np.float32)
        outputs = dict(zip(evaluate.output_names, evaluate.run(None, values), strict=True))
        values |= {name: outputs[output] for name, output in state.items()}
        seen.append(np.arctanh(outputs["action"][0]).tolist())
        by_b, by_a = outputs["action"][0].tolist()
        expected = [100.0 * by_a + 0.1, np.clip(10.0 * by_b + 0.2, -1.0, 1.0)]
        assert outputs["joint_targets"][0].tolist() == pytest.approx(expected, abs=1e-4)
    assert np.array(seen) == pytest.approx(
        np.array([[0.2, 0.2], [0.8, 0.2], [1.5, 0.2], [0.0, 0.8]]), abs=1e-4
    )
    # Four steps of 0.1 s at 2.5 Hz are one round.
    assert values["clock"] % 1.0 == pytest.approx(0.0, abs=1e-5)


STATE_SIZES = {"previous_action": 2, "clock": 1, "started": 1, "past_0": 2}


def metadata_of(content: bytes) -> dict[str, str]:
    return {entry.key: entry.value for entry in onnx.load_from_string(content).metadata_props}


def test_metadata_have_the_names_that_mjlab_writes() -> None:
    told = metadata_of(robot_file(hand_network(), HAND, about_of_hand()))
    assert {name: value for name, value in told.items() if name not in ("about", "inputs", "state")} == {
        "joint_names": "a,b,c",
        "target_names": "a,b",
        "default_joint_pos": "0.1,0.2,0.3",
        "joint_stiffness": "20,30",
        "joint_damping": "1,2",
        "joint_effort": "7,inf",
        "action_scale": "100,10",
        "observation_names": "joint_pos,actions,phase",
        "observation_terms_scale": "2,1,1",
        "observation_terms_clip": "-1.5;1.5,-inf;inf,-inf;inf",
        "observation_terms_history_length": "3,0,0",
        "observation_terms_flatten_history_dim": "True,True,True",
        "command_names": "",
    }


def test_a_policy_whose_action_is_in_another_order_than_joints_has_no_metadata_of_joints() -> None:
    assert policy_metadata(HAND) == {}
    in_order = replace(HAND, joints=HAND.joints[:2], acting=[0, 1])
    assert policy_metadata(replace(in_order, smoothing=0.5)) == {}
    told = metadata_of(onnx_file(hand_network(), {}, policy_metadata(in_order)))
    assert (told["joint_names"], told["action_scale"], told["about"]) == ("a,b", "10,100", "{}")


def test_a_policy_that_sees_other_numbers_than_the_task_is_refused() -> None:
    with pytest.raises(NotExportable, match="sees 8 numbers, and its terms have 7"):
        robot_file(hand_network(8), HAND, about_of_hand())


def test_a_task_without_targets_of_joints_has_no_form_for_robots(tmp_path: Path) -> None:
    with pytest.raises(NotDeployed, match="no targets of joints"):
        quadruped(tmp_path, action={"kind": "control"}).deployment()


def test_actions_are_smoothed_and_servos_without_one_hold_the_pose() -> None:
    # The action's first number moves the servo 1, of the joint a; nothing moves the servo of b.
    layer = PolicyLayer(np.array([[1.0, 0.0]], np.float32), np.zeros(2, np.float32))
    zeros, ones = np.zeros(1, np.float32), np.ones(1, np.float32)
    network = PolicyNetwork(zeros, ones, None, (layer,), "relu", "state", 1)
    term = SeenTerm("joint_positions", 1, 1.0, None, 1, Sensed("joint_positions", ("a", "b"), "rad", (0,)))
    robot = replace(HAND, terms=[term], joints=HAND.joints[:2], actuators=[1], smoothing=0.75, gait=None)
    evaluate = ReferenceEvaluator(onnx.load_from_string(robot_file(network, robot, about_of_hand())))
    values = {
        "joint_positions": np.array([[0.5, 9.0]], np.float32),
        "smoothed_action": np.zeros((1, 1), np.float32),
    }
    for share in (0.25, 0.4375):  # 1/4, then 3/4 · 1/4 + 1/4
        outputs = dict(zip(evaluate.output_names, evaluate.run(None, values), strict=True))
        expected = [0.1 + 100.0 * share * np.tanh(0.5), 0.2]
        assert outputs["joint_targets"][0].tolist() == pytest.approx(expected, rel=1e-5)
        values["smoothed_action"] = outputs["next_smoothed_action"]
