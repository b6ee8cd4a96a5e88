"""Which differences between environments keep a job from another one's checkpoint."""

from typing import Any

import pytest

from core.jobs.source import difference, has_other_clips
from core.jobs.spec import EnvironmentSpec

MODEL = "sha256:" + "0" * 64
REWARD: list[dict[str, Any]] = [{"kind": "forward_velocity"}, {"kind": "upright", "weight": 0.2}]
ENDS: list[dict[str, Any]] = [{"kind": "height_range", "range": [0.1, 1.0]}]


def own(**changes: Any) -> EnvironmentSpec:
    options = {"model": MODEL, "reward": REWARD, "termination": ENDS, **changes}
    return EnvironmentSpec(id="mjcf", options=options)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"reward": [REWARD[0], {"kind": "upright", "weight": 0.7}]},
        {"reward": [{"kind": "forward_velocity", "direction": [0.0, 1.0, 0.0]}, REWARD[1]]},
        {"termination": [{"kind": "height_range", "range": [0.2, 2.0]}]},
        {"reset": {"position_noise": 0.3}},
    ],
)
def test_numbers_of_the_reward_the_reset_and_the_termination_may_differ(changes: dict[str, Any]) -> None:
    assert difference(own(), own(**changes), ()) is None


@pytest.mark.parametrize(
    ("changes", "place", "values"),
    [
        ({"reward": [REWARD[0], {"kind": "alive"}]}, "reward/1/kind", "'upright' there and 'alive' here"),
        ({"reward": [REWARD[0]]}, "reward", "there and ["),
        ({"reward": [{"kind": "forward_velocity", "body": "a"}, REWARD[1]]}, "reward/0/body", "None there"),
        ({"n_frames": 2}, "n_frames", "None there and 2 here"),
        ({"model": "sha256:" + "1" * 64}, "model", "sha256:1"),
        ({"observation": [{"kind": "qpos"}]}, "observation", "None there"),
    ],
)
def test_the_first_other_difference_is_named(changes: dict[str, Any], place: str, values: str) -> None:
    found = difference(own(), own(**changes), ())
    assert found is not None
    assert found[0] == f"/environment/options/{place}"
    assert values in found[1]
    assert len(found[1]) < 250


def following(file: str, **changes: Any) -> EnvironmentSpec:
    return own(reference={"clips": [{"file": "sha256:" + file * 64}], **changes})


@pytest.mark.parametrize("changes", [{}, {"random_phase": 0.5}, {"sampling": {"kind": "uniform"}}])
def test_the_clips_of_a_reference_may_differ(changes: dict[str, Any]) -> None:
    assert difference(following("1"), following("2", **changes), ()) is None
    assert has_other_clips(following("1"), following("2", **changes))
    assert has_other_clips(following("1"), following("1", **changes)) == bool(changes)


def test_what_is_seen_of_a_reference_may_not_differ() -> None:
    found = difference(following("1"), following("2", ahead={"frames": 9}), ())
    assert found == ("/environment/options/reference/ahead/frames", "3 there and 9 here")
    assert difference(own(), following("1"), ()) is not None


def test_another_environment_is_another_and_a_free_option_is_none() -> None:
    ant, hopper = EnvironmentSpec(id="ant"), EnvironmentSpec(id="hopper")
    assert difference(ant, hopper, ()) == ("/environment/id", "'ant' there and 'hopper' here")
    other = EnvironmentSpec(id="ant", options={"terminate_when_unhealthy": False})
    assert difference(ant, other, ("terminate_when_unhealthy",)) is None
    assert difference(ant, other, ()) is not None
