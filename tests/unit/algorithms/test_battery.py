"""A battery on the probe, whose every number can be worked out by hand; and its verdict."""

from functools import partial
from pathlib import Path
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.battery.result import CommandResult, judged
from core.algorithms.battery.run import run_battery
from core.algorithms.battery.spec import (
    COMMANDS,
    BatterySpec,
    Bounds,
    battery_options,
    can_be_tested,
    commands_within,
)
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments import catalog
from core.environments.task import TaskEnv
from core.environments.terms.commands import Push, VelocityCommand
from core.environments.terms.task import TaskOptions
from core.physics.choose import engine_builder
from tests.unit.environments.mjcf.probe import XML, options

COMMAND = {"kind": "velocity", "forward": [-1, 1], "left": [-0.2, 0.5], "turn": [-1, 1]}
TASK = {"command": COMMAND, "reward": [{"kind": "track_linear_velocity"}], "termination": []}
SHORT = BatterySpec(starts=2, seconds=2.0)
# The motor is off: the ball rests in the air.
NO_TORQUE = -0.5


def resting(environment: Any) -> Acting:
    return Acting(environment, lambda parameters, state, key: jnp.full(1, parameters))


def chosen(**own: Any) -> TaskOptions:
    return cast("TaskOptions", catalog.parse_options(catalog.find("mjcf"), options(**{**TASK, **own})))


def run(folder: Path, task: TaskOptions, spec: BatterySpec = SHORT, **own: Any) -> Any:
    (folder / "model").write_bytes(XML)

    def make(changed: TaskOptions) -> TaskEnv:
        info = catalog.find("mjcf")
        return cast("TaskEnv", catalog.make(info, changed, engine_builder("native"), folder / "model"))

    return run_battery(make, task, TrainedPolicy(NO_TORQUE, resting), spec, seed=0, **own)


def test_a_body_at_rest_follows_each_command_as_far_as_the_command_is_small(tmp_path: Path) -> None:
    found = run(tmp_path, chosen(), BatterySpec(starts=2, seconds=2.0, bounds=Bounds(leg_velocity=0.1)))
    assert [row.command for row in found.commands] == commands_within(VelocityCommand.model_validate(COMMAND))
    for row in found.commands:
        forward, left, turn = row.command
        assert row.linear_tracking == pytest.approx(np.exp(-(forward**2 + left**2) / 0.25), abs=1e-3)
        assert row.angular_tracking == pytest.approx(np.exp(-(turn**2) / 0.25), abs=1e-3)
        assert (row.falls, row.episodes, row.action_change, row.target_change) == (0, 2, 0.0, None)
    held = {one.quantity: one.met for one in found.criteria}
    assert held == {"falls": True, "linear_tracking": False, "angular_tracking": False, "leg_velocity": True}
    assert (found.passed, found.legs) == (False, ["elbow"])


def test_episodes_that_fall_count_as_such_and_track_nothing(tmp_path: Path) -> None:
    task = chosen(termination=[{"kind": "height_range", "range": [0.6, 2.0]}])
    found = run(tmp_path, task, BatterySpec(starts=2, seconds=2.0, bounds=Bounds(yaw_rate=1.0)))
    assert all(row.falls == 2 and row.linear_tracking == 0 and row.yaw_rate is None for row in found.commands)
    assert [one.met for one in found.criteria] == [False] * 4


def test_a_battery_that_is_stopped_has_no_result(tmp_path: Path) -> None:
    assert run(tmp_path, chosen(), is_stopped=lambda: True) is None


def test_commands_are_clipped_to_what_was_trained_and_there_once() -> None:
    trained = VelocityCommand(forward=(0.0, 0.6), left=(0.0, 0.0), turn=(-1.0, 0.5))
    assert commands_within(trained) == [(0.6, 0, 0), (0.5, 0, 0), (0, 0, 0), (0.5, 0, 0.5), (0.5, 0, -0.8)]
    assert commands_within(VelocityCommand()) == list(COMMANDS)


def test_the_tested_task_has_one_command_an_episode_and_only_the_battery_s_pushes() -> None:
    task = chosen(command={**COMMAND, "heading": [-3, 3]}, events=[{"kind": "push", "speed": 3.0}])
    assert can_be_tested(task)
    assert not can_be_tested(chosen(command=None, reward=[{"kind": "alive"}]))
    calm = battery_options(task, BatterySpec(seconds=20.0))
    assert calm.events == []
    assert isinstance(calm.command, VelocityCommand)
    assert (calm.command.every_s, calm.command.heading) == (40.0, None)
    shoved = battery_options(task, BatterySpec(push=Push(speed=0.4)))
    assert [event.speed for event in shoved.events] == [0.4]


def test_smoothness_is_judged_straight_on_and_the_rest_over_all_commands() -> None:
    row = partial(CommandResult, episodes=50, torso_rate=0.1, yaw_rate=0.9, leg_velocity=1.0)
    commands = [
        row(command=(0.5, 0, 0), falls=0, linear_tracking=0.94, angular_tracking=1.0, action_change=0.2),
        row(command=(0, 0, 0), falls=1, linear_tracking=0.88, angular_tracking=0.82, action_change=0.5),
    ]
    passed, criteria = judged(commands, (0.5, 0, 0), Bounds(action_change=0.21))
    assert passed
    assert {one.quantity: one.value for one in criteria} == pytest.approx(
        {"falls": 0.01, "linear_tracking": 0.91, "angular_tracking": 0.91, "action_change": 0.2}
    )
    assert not judged(commands, (0.5, 0, 0), Bounds(yaw_rate=0.2))[0]
