"""How far policies follow clips, on the probe, whose clips nothing but its elbow leaves."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.battery.clips import ClipBattery
from core.algorithms.battery.result import judged_by_clips
from core.algorithms.battery.spec import BatterySpec
from core.algorithms.following import followed, spread_over
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.rollout import Roller
from core.environments.task import TaskEnv
from gaitway.battery import shown_battery
from tests.unit.environments.mjcf.probe import build
from tests.unit.environments.mjcf.test_environment import NO_TORQUE
from tests.unit.environments.mjcf.test_imitation import FILE, flight, follower

RESTS = TrainedPolicy(None, lambda environment: Acting(environment, lambda parameters, state, key: NO_TORQUE))


def two_clips(folder: Path, **given: Any) -> TaskEnv:
    return follower(folder, [flight(name="a"), flight(2.0, name="b")], {"clips": [{"file": FILE}]}, **given)


def test_starts_are_spread_over_all_clips_but_their_last_frames(tmp_path: Path) -> None:
    environment = two_clips(tmp_path)
    # Nine rows each, of which the ninth is the last.
    assert spread_over(environment, 16).tolist() == [*range(8), *range(9, 17)]
    assert spread_over(environment, 2).tolist() == [0, 16]


def test_who_flies_on_comes_to_the_end_of_both_clips(tmp_path: Path) -> None:
    environment = two_clips(tmp_path, termination=[])
    whole, by_clip, _ = followed(environment, RESTS, spread_over(environment, 16), seed=0)
    assert (whole.starts, whole.reached) == (16, 1.0)
    assert {name: row.starts for name, row in by_clip.items()} == {"a": 8, "b": 8}
    assert whole.root_error < 1e-3
    # The elbow keeps its 0.5 rad/s but for the ball's recoil.
    assert whole.joint_error < 0.01


def test_errors_are_kept_by_joint_and_body_over_the_time_of_a_clip(tmp_path: Path) -> None:
    # Rows 0 to 8 of the clip have the elbow at 0, 0, 0, 0, 0, 0.1, 0.2, 0.2, 0.2; the body's stays at 0.
    bent = replace(flight(), joint_positions=np.array([[0.0], [0.0], [0.0], [0.2], [0.2]]))
    environment = follower(tmp_path, [bent], termination=[])
    assert environment.compared == (["elbow"], ["ball", "arm"])
    _, _, over_time = followed(environment, RESTS, np.array([0], np.int32), seed=0)
    found = over_time["flight"]
    np.testing.assert_allclose(found.joints, [[0], [0], [0], [0], [0.1], [0.2], [0.2], [0.2]], atol=1e-5)
    # The arm turns about where it hangs on the ball, so that its origin is where it is to be.
    np.testing.assert_allclose(found.bodies, np.zeros((8, 2)), atol=1e-5)
    # An episode that begins at row 6 is in the last two parts of the time alone.
    _, _, over_time = followed(environment, RESTS, np.array([6], np.int32), seed=0)
    assert np.isnan(over_time["flight"].joints[:6]).all()
    assert np.isfinite(over_time["flight"].joints[6:]).all()


def test_who_is_lost_does_not_come_to_the_end(tmp_path: Path) -> None:
    lost = [{"kind": "far_from_reference", "root_position": 1e-6}]
    environment = two_clips(tmp_path, termination=lost, reset={"position_noise": 0.01, "velocity_noise": 0.0})
    whole, _, _ = followed(environment, RESTS, spread_over(environment, 4), seed=0)
    assert (whole.reached, whole.close) == (0.0, 0.0)
    assert 0.0 < whole.root_error < 0.02


def test_a_task_without_a_reference_is_a_mistake(tmp_path: Path) -> None:
    environment = build(tmp_path)
    assert isinstance(environment, TaskEnv)
    with pytest.raises(ValueError, match="follows no reference"):
        spread_over(environment, 2)


def test_an_episode_that_came_to_its_clips_end_did_not_terminate(tmp_path: Path) -> None:
    environment = two_clips(tmp_path, termination=[])
    roller = Roller(environment, RESTS.acting(environment).act)
    [episode] = roller.episodes(None, jax.random.PRNGKey(0), num_steps=20, num_episodes=1)
    assert 1 <= episode.num_steps <= 8
    assert not episode.terminated
    assert np.sum(episode.metrics["clip_followed"]) == pytest.approx(1.0, abs=1e-5)


def test_a_battery_judges_each_clip_from_moments_that_are_spread_over_it(tmp_path: Path) -> None:
    environment = two_clips(tmp_path, termination=[])
    spec = BatterySpec(starts=4)
    battery = ClipBattery(lambda options: environment, environment._options, RESTS, spec)
    result = battery.run(None, seed=0)
    assert result is not None
    assert result.passed
    assert [(row.clip, row.episodes, row.reached) for row in result.clips] == [("a", 4, 1.0), ("b", 4, 1.0)]
    assert [one.quantity for one in result.criteria] == ["reached", "root_error", "joint_error"]
    assert result.over_time is not None
    assert [(one.clip, one.seconds, len(one.joints)) for one in result.over_time.clips] == [
        ("a", pytest.approx(0.08), 8),
        ("b", pytest.approx(0.08), 8),
    ]
    shown = shown_battery(result.model_dump(mode="json"))
    assert shown is not None
    assert shown.verdict.startswith("Passed: each clip to its end")
    assert shown.criteria[0] == ("to the end", "100 %", "≥ 95 %", "yes")
    assert shown.criteria[1] == ("root, m", f"{result.criteria[1].value:.3f}", "≤ 0.1", "yes")
    assert shown.legend.startswith("Root and joints: mean errors")
    assert [row[:2] for row in shown.rows] == [("a", "4/4"), ("b", "4/4")]
    whole = result.clips[0].model_copy(update={"reached": 0.9})
    assert not judged_by_clips(whole, spec.bounds)[0]
    assert battery.run(None, seed=0, is_stopped=lambda: True) is None
