"""Jobs that share a GPU: which take as much memory, and what of a card's they get."""

from typing import Any

import pytest

from core.jobs.sharing import GIB, alike, share_for, shared_bytes
from core.jobs.spec import JOB_SPEC, TrainSpec

SETTINGS = {"num_envs": 64, "learning_rate": 0.001, "num_timesteps": 1_000_000}


def spec(settings: dict[str, Any] | None = None, **fields: Any) -> TrainSpec:
    document = {"kind": "train", "environment": "ant", "algorithm": {**SETTINGS, **(settings or {})}}
    found = JOB_SPEC.validate_python({**document, **fields})
    assert isinstance(found, TrainSpec)
    return found


@pytest.mark.parametrize(
    ("settings", "fields"),
    [
        ({"learning_rate": 0.1}, {}),
        ({"num_timesteps": 5}, {}),
        ({}, {"seed": 7, "name": "again", "video": None}),
    ],
)
def test_trainings_take_as_much_memory_whose_sizes_are_equal(
    settings: dict[str, Any], fields: dict[str, Any]
) -> None:
    assert alike(spec(settings, **fields)) == alike(spec())


@pytest.mark.parametrize(
    ("settings", "fields"),
    [
        ({"num_envs": 128}, {}),
        ({"policy_hidden_layer_sizes": [512, 512]}, {}),
        ({}, {"environment": "humanoid"}),
        ({}, {"physics": "mjx"}),
        ({}, {"seeds": [0, 1]}),
        ({}, {"resources": {"gpus": 2}}),
    ],
)
def test_trainings_of_other_sizes_are_measured_for_themselves(
    settings: dict[str, Any], fields: dict[str, Any]
) -> None:
    assert alike(spec(settings, **fields)) != alike(spec())


def test_a_share_has_room_for_more_than_was_measured_and_a_card_keeps_a_reserve() -> None:
    assert share_for(4 * GIB) == 5 * GIB
    assert share_for(1) == GIB // 2
    assert shared_bytes(80 * GIB, 2) == 78 * GIB
    assert shared_bytes(GIB, 2) == 0
