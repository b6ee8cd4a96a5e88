"""What a client may send, and what is refused by its shape."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.tuned import TUNED
from core.environments.info import EnvironmentInfo
from core.errors import Rejected
from core.jobs.job import Artifact, Job
from core.jobs.spec import JOB_SPEC, EnvironmentSpec, TrainSpec, decoder_job
from tests.unit.jobs.making import make_job


def refused(document: dict[str, Any]) -> list[tuple[Any, ...]]:
    """The places that validation complains about."""
    with pytest.raises(ValidationError) as caught:
        JOB_SPEC.validate_python(document)
    return [error["loc"] for error in caught.value.errors()]


def test_two_words_are_a_job() -> None:
    spec = JOB_SPEC.validate_json('{"kind": "train", "environment": "ant"}')
    assert isinstance(spec, TrainSpec)
    assert (spec.environment.id, spec.environment.options, spec.physics) == ("ant", {}, "auto")


def test_an_unknown_field_is_refused_where_it_stands() -> None:
    places = refused({"kind": "train", "environment": "ant", "algorithm": {"kind": "ppo", "clip_ratio": 0.2}})
    assert places == [("train", "algorithm", "ppo", "clip_ratio")]


@pytest.mark.parametrize("value", [0, -1, 1.5, "3", None, True, 10**30, float("nan"), float("inf")])
def test_a_budget_is_a_positive_number_of_steps(value: Any) -> None:
    assert refused({"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": value}})


@pytest.mark.parametrize("value", [0.0, -0.1, 2.0, float("nan"), float("inf"), "1e-3", 10**400])
def test_a_learning_rate_is_a_small_positive_number(value: Any) -> None:
    assert refused({"kind": "train", "environment": "ant", "algorithm": {"learning_rate": value}})


@pytest.mark.parametrize(
    ("field", "value"), [("width", 641), ("height", 0), ("fps", 0), ("seconds", 0), ("width", 10**6)]
)
def test_a_video_has_a_size_that_can_be_encoded(field: str, value: Any) -> None:
    assert refused({"kind": "train", "environment": "ant", "video": {field: value}}) == [
        ("train", "video", field)
    ]


@pytest.mark.parametrize("number", [0, 4097, 1.5, "2", None])
@pytest.mark.parametrize("field", ["gpus", "hosts"])
def test_a_job_asks_for_a_number_of_gpus_and_hosts(field: str, number: Any) -> None:
    assert refused({"kind": "train", "environment": "ant", "resources": {field: number}}) == [
        ("train", "resources", field)
    ]


@pytest.mark.parametrize("job", ["../../etc", "a/b", "", "x" * 1000, "019aa3c2f0b1-5be0c1d2e3\0"])
def test_what_is_no_job_id_is_refused(job: str) -> None:
    assert refused({"kind": "rollout", "environment": "ant", "policy": {"kind": "checkpoint", "job": job}})


@given(
    learning_rate=st.floats(1e-6, 1e-2),
    num_envs=st.sampled_from([64, 256, 1024]),
    seed=st.integers(0, 2**31 - 1),
    labels=st.dictionaries(
        st.from_regex(r"[a-z]{1,8}", fullmatch=True),
        st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
        max_size=3,
    ),
)
def test_a_stored_job_comes_back_as_it_was_and_says_no_more_than_the_client(
    learning_rate: float, num_envs: int, seed: int, labels: dict[str, str]
) -> None:
    algorithm = {"learning_rate": learning_rate, "num_envs": num_envs}
    job = make_job(algorithm=algorithm, seed=seed, labels=labels)
    stored = job.model_dump_json()
    assert Job.model_validate_json(stored) == job
    assert json.loads(stored)["spec"]["algorithm"] == algorithm


INFO = EnvironmentInfo(
    id="probe", description="", factory="", observation_size=1, action_size=1, dt=0.05, episode_length=10,
    tracked_body="",
)  # fmt: skip


def test_only_a_jobs_id_names_the_job_of_a_decoder() -> None:
    job = "019aa3c2f0b1-5be0c1d2e3"
    for said, found in ((job, job), (f"{job}\0", None), (f"{job}\n", None), (7, None), (None, None)):
        options: Any = {"action": {"kind": "decoder", "job": said}}
        assert decoder_job(EnvironmentSpec(id="go1", options=options)) == found


@pytest.fixture
def tuned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TUNED, INFO.id, {"cpu": PPOSpec(num_envs=128, learning_rate=6e-4)})


@pytest.mark.usefixtures("tuned")
def test_the_jobs_word_goes_before_the_tuned_value_and_that_before_the_default() -> None:
    settings = resolve(PPOSpec(learning_rate=1e-3), INFO, "cpu")
    assert (settings.learning_rate, settings.num_envs, settings.gae_lambda) == (1e-3, 128, 0.95)
    assert resolve(PPOSpec(), INFO, "gpu").num_envs == PPOSpec().num_envs


@pytest.mark.usefixtures("tuned")
def test_a_batch_that_environments_cannot_share_evenly_is_refused_with_the_three_places() -> None:
    # 100 × 8 = 800 unrolls; 800 / 128 is not whole.
    with pytest.raises(Rejected, match="100 × 8 = 800 is not a multiple of num_envs = 128") as caught:
        resolve(PPOSpec(batch_size=100, num_minibatches=8), INFO, "cpu")
    assert [p.pointer for p in caught.value.problems] == [
        "/algorithm/batch_size",
        "/algorithm/num_minibatches",
        "/algorithm/num_envs",
    ]


def test_the_budget_is_paid_in_whole_updates() -> None:
    # 4 × 2 × 5 = 40 steps an update; 100 steps need three of them.
    settings = PPOSpec(batch_size=4, num_minibatches=2, unroll_length=5, num_timesteps=100)
    assert (settings.env_steps_per_update, settings.num_updates) == (40, 3)


@pytest.mark.parametrize("seeds", [[], [1], list(range(17)), [0, 1, 0], [-1, 2], [0, 2**31], 3, ["a", "b"]])
def test_seeds_are_two_to_sixteen_different_ones(seeds: Any) -> None:
    places = refused({"kind": "train", "environment": "ant", "seeds": seeds})
    assert {place[:2] for place in places} == {("train", "seeds")}


def test_a_seed_and_several_exclude_each_other() -> None:
    with pytest.raises(ValidationError, match="`seed` and `seeds` exclude each other"):
        JOB_SPEC.validate_python({"kind": "train", "environment": "ant", "seed": 0, "seeds": [0, 1]})
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", "seed": 7, "seeds": None})
    assert spec.seed == 7


def test_a_job_has_the_files_of_a_seed_and_those_that_all_share() -> None:
    def artifact(name: str, role: Any, seed: int | None = None) -> Artifact:
        facts = {} if seed is None else {"seed": seed}
        return Artifact(name=name, role=role, media_type="", size=0, sha256="", key=name, metadata=facts)

    files = (
        artifact("checkpoint", "checkpoint"),
        artifact("policy-seed-4", "policy", 4),
        artifact("policy-seed-2", "policy", 2),
    )
    job = make_job(seeds=[4, 2]).with_artifacts(files)
    assert job.seeds == (4, 2)
    for seed, name in ((None, "policy-seed-4"), (4, "policy-seed-4"), (2, "policy-seed-2")):
        assert [file.name for file in job.files_of(seed)] == ["checkpoint", name]
        assert getattr(job.newest("policy", seed=seed), "name", None) == name
    alone = make_job().with_artifacts(files[1:])
    assert (alone.seeds, len(alone.files_of(None))) == ((), 2)
