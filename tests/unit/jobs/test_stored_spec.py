"""A stored specification is read leniently: what this version does not know is passed over, and no more."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.documents import read_leniently
from core.jobs.spec import JOB_SPEC, JobSpec, RolloutSpec, TrainSpec
from tests.unit.jobs.making import make_job

TRAIN: dict[str, Any] = {
    "kind": "train",
    "environment": {"id": "ant", "options": {"legs": {"of": [1, 2]}}},
    "algorithm": {"kind": "ppo", "num_envs": 64},
    "randomization": [
        {"field": "geom_friction", "range": [0.8, 1.2]},
        {"field": "body_mass", "range": [0.9, 1.1]},
    ],
    "tracking": {"wandb": {"project": "vnl"}},
    "labels": {"project": "vnl"},
}
ROLLOUT: dict[str, Any] = {
    "kind": "rollout",
    "environment": {"id": "ant"},
    "policy": {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3"},
}
LATER: dict[str, Any] = {"later": {"kind": "train", "deep": [None, 1.5]}}


def read_spec(text: str) -> JobSpec:
    return read_leniently(text, JOB_SPEC)


def stored(job: dict[str, Any]) -> str:
    """As the record holds it."""
    return json.dumps(make_job(**job).model_dump(mode="json", include={"spec"})["spec"])


def with_later(document: Any, *path: str | int) -> str:
    """The document with a field of a later version in the place that the path leads to."""
    changed = json.loads(json.dumps(document))
    place = changed
    for step in path:
        place = place[step]
    place.update(LATER)
    return json.dumps(changed)


@pytest.mark.parametrize("job", [TRAIN, ROLLOUT])
def test_what_was_stored_is_read_back_and_says_no_more(job: dict[str, Any]) -> None:
    spec = make_job(**job).spec
    read = read_spec(stored(job))
    assert read == spec
    assert read.model_fields_set == spec.model_fields_set


@pytest.mark.parametrize(
    ("job", "path"),
    [
        (TRAIN, ()),
        (TRAIN, ("environment",)),
        (TRAIN, ("algorithm",)),
        (TRAIN, ("randomization", 0)),
        (TRAIN, ("randomization", 1)),
        (TRAIN, ("tracking",)),
        (TRAIN, ("tracking", "wandb")),
        (ROLLOUT, ()),
        (ROLLOUT, ("policy",)),
    ],
)
def test_an_unknown_field_is_passed_over_wherever_it_stands(
    job: dict[str, Any], path: tuple[str | int, ...]
) -> None:
    assert read_spec(with_later(json.loads(stored(job)), *path)) == make_job(**job).spec


def test_many_unknown_fields_are_passed_over_together() -> None:
    document = json.loads(stored(TRAIN))
    for path in ((), ("environment",), ("algorithm",), ("randomization", 0), ("tracking", "wandb")):
        document = json.loads(with_later(document, *path))
    assert read_spec(json.dumps(document)) == make_job(**TRAIN).spec


@pytest.mark.parametrize("name", ["train", "ppo", "checkpoint", "kind2", ""])
def test_an_unknown_field_may_be_named_as_a_kind_is(name: str) -> None:
    document = {**json.loads(stored(TRAIN)), name: {"num_envs": 1}}
    document["algorithm"] = {**document["algorithm"], name: {"num_envs": 1}}
    assert read_spec(json.dumps(document)) == make_job(**TRAIN).spec


def test_options_of_an_environment_are_kept_as_they_are() -> None:
    document = json.loads(stored(TRAIN))
    document["environment"]["options"]["later"] = 1
    assert read_spec(json.dumps(document)).environment.options == document["environment"]["options"]


def test_fields_left_out_have_their_defaults() -> None:
    train, rollout = read_spec('{"kind": "train", "environment": "ant"}'), read_spec(json.dumps(ROLLOUT))
    assert isinstance(train, TrainSpec)
    assert isinstance(rollout, RolloutSpec)
    assert (train.seed, rollout.num_steps) == (0, 1000)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "column 0"),
        ("{", "column 1"),
        ("null", "should be an object"),
        ("[]", "should be an object"),
        ('{"environment": "ant"}', "'kind'"),
        ('{"kind": "distil", "environment": "ant"}', "distil"),
        ('{"kind": "train"}', "environment"),
        ('{"kind": "train", "environment": "ant", "seed": "a lot", "later": 1}', "seed"),
        ('{"kind": "train", "environment": "ant", "algorithm": {"kind": "dreamer"}}', "algorithm"),
        ('{"kind": "train", "environment": "ant", "priority": "later"}', "priority"),
        ('{"kind": "rollout", "environment": "ant", "policy": {"kind": "mpc", "later": 1}}', "policy"),
    ],
)
def test_what_this_version_cannot_mean_is_refused_with_its_place(text: str, place: str) -> None:
    with pytest.raises(ValueError, match=place):
        read_spec(text)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


@given(st.dictionaries(st.sampled_from(["a", "train", "ppo", "later"]), json_values), st.booleans())
def test_whatever_later_versions_add_the_rest_is_read(added: dict[str, Any], inside: bool) -> None:
    document = json.loads(stored(TRAIN))
    place = document["algorithm"] if inside else document
    assert read_spec(json.dumps({**document, **({"algorithm": place | added} if inside else added)})) == (
        make_job(**TRAIN).spec
    )


@given(json_values)
def test_a_document_of_any_other_shape_is_refused(document: Any) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 # JSON's errors and pydantic's are of this kind.
        read_spec(json.dumps(document))
