"""Writes `policy.robot.onnx`: from what a robot measures to the targets of its joints, in one graph.

Its metadata, and those of `policy.onnx`, have the names that mjlab's exporter writes, for programs that read
such files: `mjlab/rl/exporter_utils.py` of mjlab 1.6.0.
"""

import json
from collections.abc import Mapping, Sequence
from math import inf, pi
from typing import Any

import numpy as np

from core.algorithms.export.contract import as_text
from core.algorithms.export.network import NotExportable, PolicyNetwork
from core.algorithms.export.onnx_file import Graph, add_policy, array, model_file
from core.environments.deployment import Deployment, SeenTerm
from core.environments.terms.commands import GaitClock
from core.environments.terms.sensed import CLOCK, PREVIOUS_ACTION, Sensed

# mjlab's names of terms; others keep theirs.
_NAMES = {
    "base_linear_velocity": "base_lin_vel",
    "base_angular_velocity": "base_ang_vel",
    "joint_positions": "joint_pos",
    "joint_velocities": "joint_vel",
    "previous_action": "actions",
    "gait_phase": "phase",
}
_STARTED = "started"


def robot_file(network: PolicyNetwork, robot: Deployment, about: Mapping[str, Any]) -> bytes:
    """Measured arrays [batch, n] ↦ `joint_targets` [batch, targets], float32, in the joints' order.

    Metadata `inputs` has the names and units of what is measured. `state` has the other inputs, each with the
    output whose value it gets in the next step; all are 0 in the first. Equal policies give equal bytes.
    Raises NotExportable.
    """
    if (size := sum(term.size * term.history for term in robot.terms)) != network.observation_size:
        raise NotExportable(f"its policy sees {network.observation_size} numbers, and its terms have {size}")
    writer = _RobotGraph(robot, about["action"]["held_s"])
    writer.add_observation()
    add_policy(writer.graph, network, "observation")
    if PREVIOUS_ACTION in writer.inputs:
        writer.state[PREVIOUS_ACTION] = "action"
    order = sorted(range(len(robot.acting)), key=lambda number: robot.acting[number])
    writer.add_targets(order)
    outputs = {"joint_targets": len(order), "action": network.action_size, **writer.outputs}
    metadata = {
        "about": as_text(about),
        "inputs": json.dumps(writer.measured, ensure_ascii=False),
        "state": json.dumps(writer.state),
        "target_names": _csv(robot.joints[robot.acting[number]].name for number in order),
        **_of_the_joints(robot, [robot.scale[number] for number in order]),
        **_of_the_terms(robot),
    }
    return model_file(
        writer.graph,
        [array(name, size) for name, size in writer.inputs.items()],
        [array(name, size) for name, size in outputs.items()],
        metadata,
    )


def policy_metadata(robot: Deployment) -> dict[str, str]:
    """The metadata for `policy.onnx`. Nothing where an action is smoothed, is not a position, or is not one
    number for each joint in their order: readers of these names would send it to other joints."""
    in_order = list(range(len(robot.joints)))
    if list(robot.acting) != in_order or list(robot.actuators) != in_order or robot.smoothing:
        return {}
    if any(joint.target != "position" for joint in robot.joints):
        return {}
    return {**_of_the_joints(robot, robot.scale), **_of_the_terms(robot)}


class _RobotGraph:
    """inputs, outputs: sizes by name. state: inputs that are outputs of the step before. measured: the other
    inputs, described."""

    def __init__(self, robot: Deployment, step_s: float) -> None:
        self.graph = Graph()
        self.inputs: dict[str, int] = {}
        self.outputs: dict[str, int] = {}
        self.state: dict[str, str] = {}
        self.measured: list[Mapping[str, Any]] = []
        self._robot, self._step_s = robot, step_s
        self._sensed: dict[str, Sensed] = {}

    def add_observation(self) -> None:
        """The value `observation`, which the policy sees."""
        parts = [self._seen(term, number) for number, term in enumerate(self._robot.terms)]
        self.graph.add("Concat", *parts, axis=1, output="observation")

    def add_targets(self, order: Sequence[int]) -> None:
        """The value `joint_targets`: the numbers of the action in this order, as targets."""
        graph, robot = self.graph, self._robot
        action = "action"
        if robot.smoothing:
            last, share = "smoothed_action", graph.constant("smoothing", robot.smoothing)
            self.inputs[last] = len(robot.actuators)
            change = graph.add("Mul", graph.add("Sub", last, action), share)
            action = graph.add("Add", action, change, output=self._fed_back(last, len(robot.actuators)))
        if list(robot.actuators) != list(range(len(robot.acting))):
            chosen = [
                [float(servo == number) for servo in range(len(robot.acting))] for number in robot.actuators
            ]
            action = graph.add("MatMul", action, graph.constant("servos", np.array(chosen, np.float32)))
        moved = graph.add("Mul", action, graph.constant("action_scale", self._robot.scale))
        targets = graph.add("Add", moved, graph.constant("action_offset", self._robot.offset))
        if any(self._robot.bounds):
            ends = zip(*(bounds or (-inf, inf) for bounds in self._robot.bounds), strict=True)
            lowest, highest = (
                graph.constant(name, end) for name, end in zip(("lowest", "highest"), ends, strict=True)
            )
            targets = graph.add("Min", graph.add("Max", targets, lowest), highest)
        graph.add("Gather", targets, graph.places("joint_order", order), axis=1, output="joint_targets")

    def _seen(self, term: SeenTerm, number: int) -> str:
        """A term: the numbers measured, scaled, clipped, and those of steps before."""
        graph, sensed = self.graph, term.sensed
        values = self._input(sensed)
        if sensed.name == CLOCK and self._robot.gait is not None:
            values = self._phases(values, self._robot.gait)
        if sensed.places is not None and list(sensed.places) != list(range(len(sensed.components))):
            values = graph.add("Gather", values, graph.places(f"places_{number}", sensed.places), axis=1)
        if sensed.less:
            values = graph.add("Sub", values, graph.constant(f"less_{number}", sensed.less))
        if term.scale != 1.0:
            values = graph.add("Mul", values, graph.constant(f"scale_{number}", term.scale))
        if term.clip is not None:
            bounds = (
                graph.constant(f"lowest_{number}", -term.clip),
                graph.constant(f"highest_{number}", term.clip),
            )
            values = graph.add("Clip", values, *bounds)
        return self._with_history(values, term, number) if term.history > 1 else values

    def _input(self, sensed: Sensed) -> str:
        """The input's own name, or with a number where another input has it."""
        name, number = sensed.name, 1
        while name in self._sensed and self._sensed[name].components != sensed.components:
            number += 1
            name = f"{sensed.name}_{number}"
        if name not in self._sensed:
            self._sensed[name] = sensed
            self.inputs[name] = len(sensed.components)
            if name not in (CLOCK, PREVIOUS_ACTION):
                described = {"name": name, "components": list(sensed.components), "unit": sensed.unit}
                self.measured.append(described)
        return name

    def _phases(self, clock: str, gait: GaitClock) -> str:
        """sin φ of each foot, then cos φ, with φ = 2π (share + offset). The clock goes on by a step."""
        graph = self.graph
        if CLOCK not in self.state:
            step = graph.constant("clock_step", gait.frequency * self._step_s)
            whole = graph.constant("whole_round", 1.0)
            graph.add("Mod", graph.add("Add", clock, step), whole, fmod=1, output=self._fed_back(CLOCK, 1))
        shares = graph.add("Add", clock, graph.constant("gait_offsets", gait.offsets))
        phases = graph.add("Mul", shares, graph.constant("radians", 2.0 * pi))
        return graph.add("Concat", graph.add("Sin", phases), graph.add("Cos", phases), axis=1)

    def _with_history(self, newest: str, term: SeenTerm, number: int) -> str:
        """The last values, the oldest first. The first value stands for those before it."""
        graph = self.graph
        if _STARTED not in self.state:
            self.inputs[_STARTED] = 1
            fed_back = self._fed_back(_STARTED, 1)
            graph.add("Max", _STARTED, graph.constant("yes", 1.0), output=fed_back)
        past = f"past_{number}"
        size = (term.history - 1) * term.size
        self.inputs[past] = size
        copies = graph.add("Concat", *[newest] * (term.history - 1), axis=1)
        # started · past + (1 − started) · copies
        change = graph.add("Mul", _STARTED, graph.add("Sub", past, copies))
        before = graph.add("Add", copies, change)
        values = graph.add("Concat", before, newest, axis=1)
        kept = range(term.size, term.history * term.size)
        fed_back = self._fed_back(past, size)
        graph.add("Gather", values, graph.places(f"kept_{number}", kept), axis=1, output=fed_back)
        return values

    def _fed_back(self, name: str, size: int) -> str:
        """The output whose value an input of the state gets in the next step."""
        self.state[name] = output = f"next_{name}"
        self.outputs[output] = size
        return output


def _of_the_joints(robot: Deployment, scale: Sequence[float]) -> dict[str, str]:
    """By joint in the model's order; stiffness, damping, effort and scale of joints with a servo alone."""
    driven = [joint for joint in robot.joints if joint.stiffness is not None]
    return {
        "joint_names": _csv(joint.name for joint in robot.joints),
        "default_joint_pos": _csv(joint.default for joint in robot.joints),
        "joint_stiffness": _csv(joint.stiffness for joint in driven),
        "joint_damping": _csv(joint.damping for joint in driven),
        "joint_effort": _csv("inf" if joint.effort is None else joint.effort for joint in driven),
        "action_scale": _csv(scale),
    }


def _of_the_terms(robot: Deployment) -> dict[str, str]:
    bounds = ("-inf;inf" if term.clip is None else f"{-term.clip:g};{term.clip:g}" for term in robot.terms)
    return {
        "observation_names": _csv(_NAMES.get(term.kind, term.kind) for term in robot.terms),
        "observation_terms_scale": _csv(term.scale for term in robot.terms),
        "observation_terms_clip": _csv(bounds),
        # mjlab's 0 is no history, as our 1 is.
        "observation_terms_history_length": _csv(
            term.history if term.history > 1 else 0 for term in robot.terms
        ),
        "observation_terms_flatten_history_dim": _csv("True" for _ in robot.terms),
        "command_names": "" if robot.command is None else robot.command.kind,
    }


def _csv(values: Any) -> str:
    """Numbers to the last digit of single precision."""
    return ",".join(value if isinstance(value, str) else f"{value:.9g}" for value in values)
