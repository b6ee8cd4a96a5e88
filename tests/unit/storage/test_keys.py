"""The bucket's layout."""

from core.adapters.object_keys import is_portable
from core.storage import keys

JOB = "019aa3c2f0b1-5be0c1d2e3"


def test_everything_of_a_job_lies_under_its_prefix() -> None:
    under = [keys.spec(JOB), keys.record(JOB), keys.manifest(JOB, 1), keys.artifact(JOB, 1, "video.mp4")]
    assert all(key.startswith(keys.job(JOB)) for key in under)
    assert len(set(under)) == 4


def test_no_job_lies_under_the_prefix_of_another() -> None:
    # Without the slash at the end, deleting attempt 1 or job …e3 would take 10 and …e3x along.
    assert keys.job(JOB) == f"jobs/{JOB}/"


def test_attempts_are_apart() -> None:
    assert keys.artifact(JOB, 1, "policy") != keys.artifact(JOB, 2, "policy")
    assert not keys.artifact(JOB, 10, "policy").startswith(keys.artifact(JOB, 1, ""))


def test_every_store_keeps_these_keys() -> None:
    assert is_portable(keys.spec(JOB))
    assert is_portable(keys.artifact(JOB, 12, "checkpoint-000000500000.npz"))
