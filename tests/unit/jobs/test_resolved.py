"""A resolved specification: its defaults filled in are a job again, and a model rules out engines."""

from datetime import UTC, datetime
from typing import Any

import pytest

from core.algorithms.catalog import ALGORITHMS
from core.environments import catalog
from core.environments.mjcf.info import MjcfOptions
from core.environments.terms.inventory import Sensor
from core.errors import Rejected
from core.jobs.checks import check
from core.jobs.job import Attempt, Job
from core.jobs.resolved import engines_that_cannot, filled_in, resolve_job
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore
from core.jobs.submission import completed
from tests.contract.test_job_store import DESCRIPTION

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)
OURS = [
    info.id for info in catalog.ENVIRONMENTS.values() if info.family == "gaitway" and not info.takes_model
]


def job(attempts: tuple[Attempt, ...] = (), **spec: Any) -> Job:
    parsed = completed(JOB_SPEC.validate_python({"kind": "train", **spec}))
    return Job(id="019aa3c2f0b1-5be0c1d2e3", spec=parsed, created_at=NOON, attempts=attempts)


# What an algorithm needs besides its defaults on every body.
NEEDED = {"distillation": {"experts": [{"job": "019aa3c2f0b1-5be0c1d2e4"}]}}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_it_is_accepted_as_a_job_and_has_nothing_left_to_fill_in(jobs: JobStore, algorithm: str) -> None:
    accepted = list[str]()
    for environment in OURS:
        one = job(environment=environment, algorithm={"kind": algorithm, **NEEDED.get(algorithm, {})})
        try:
            check(one.spec, jobs)
        except Rejected:  # The algorithm needs more than its defaults there.
            continue
        whole = filled_in(one, jobs)
        again = job(**whole)
        check(again.spec, jobs)
        assert filled_in(again, jobs) == whole
        assert "learning_rate" in whole["algorithm"]
        accepted.append(environment)
    assert accepted


def test_what_a_network_takes_the_place_of_is_left_out(jobs: JobStore) -> None:
    """A rat's tuned perceptron has other layers on a GPU."""
    network = {"kind": "intention", "encoder_sees": ["qpos"]}
    sent = {"environment": "rodent", "algorithm": {"network": network}}
    one = job(**sent)
    used = resolve_job(one.spec).settings_on("cpu").model_dump(mode="json")
    facts: dict[str, Any] = {"token": "t", "started_at": NOON, "details": {"hyperparameters": used}}
    had = Attempt(number=1, worker="w", **facts)
    for known in (one, job((had,), **sent)):
        whole = filled_in(known, jobs)
        assert "policy_hidden_layer_sizes" not in whole["algorithm"]
        check(job(**whole).spec, jobs)


def test_several_seeds_stay_alone(jobs: JobStore) -> None:
    whole = filled_in(job(environment="ant", seeds=[0, 4]), jobs)
    assert whole["seeds"] == [0, 4]
    assert "seed" not in whole
    assert filled_in(job(**whole), jobs) == whole


def test_several_cameras_stay_alone_and_a_rollout_has_no_algorithm(jobs: JobStore) -> None:
    spec = {"kind": "rollout", "environment": "ant", "policy": {"kind": "zero"}, "video": {"cameras": [0]}}
    whole = filled_in(job(**spec), jobs)
    assert whole["video"]["cameras"] == [0]
    assert "camera" not in whole["video"]
    assert "algorithm" not in whole
    assert whole["num_steps"] == 1000
    JOB_SPEC.validate_python(whole)


def test_the_hyperparameters_are_those_that_the_newest_attempt_ran_with(jobs: JobStore) -> None:
    ran = Attempt(
        number=1,
        token="1-x",
        worker="w",
        started_at=NOON,
        details={"hyperparameters": {"kind": "ppo", "learning_rate": 0.125}},
    )
    whole = filled_in(job((ran,), environment="ant", algorithm={"learning_rate": 0.25}), jobs)
    assert whole["algorithm"] == {"kind": "ppo", "learning_rate": 0.125}


def test_a_job_whose_model_was_deleted_keeps_what_was_sent(jobs: JobStore) -> None:
    options = {"model": "sha256:" + "0" * 64}
    whole = filled_in(job(environment={"id": "mjcf", "options": options}, algorithm={}), jobs)
    assert whole["environment"] == {"id": "mjcf", "options": options}
    assert whole["algorithm"] == {"kind": "ppo"}


SENSORS = [
    Sensor(name="imu", type="force", size=3, beyond={"compiled": "its sensor 'imu' is of the kind force"}),
    Sensor(name="angle", type="jointpos", size=1),
]


def test_a_sensor_counts_against_an_engine_where_the_job_reads_it() -> None:
    """Issue 41: an explicit `compiled` was a 202 that failed as `bad_model`."""
    inventory = DESCRIPTION.inventory.model_copy(update={"sensors": SENSORS})
    described = DESCRIPTION.model_copy(update={"inventory": inventory})

    def cannot(observation: list[dict[str, object]]) -> dict[str, str]:
        options = MjcfOptions.model_validate({"model": f"sha256:{'0' * 64}", "observation": observation})
        return dict(engines_that_cannot(described, options))

    assert cannot([{"kind": "qpos"}]) == {"mjx": "No."}
    stumbling = MjcfOptions.model_validate({"model": f"sha256:{'0' * 64}", "reward": [{"kind": "stumble"}]})
    assert "the term `stumble` reads" in engines_that_cannot(described, stumbling)["compiled"]
    assert cannot([{"kind": "sensors", "names": ["angle"]}]) == {"mjx": "No."}
    for reads in ({"kind": "sensors", "names": ["imu"]}, {"kind": "sensors"}):
        assert cannot([reads])["compiled"].startswith(
            "The engine 'compiled' cannot run the model: its sensor 'imu' is of the kind force."
        )
