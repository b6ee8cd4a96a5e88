"""The bucket's layout."""

from core.adapters.s3.keys import is_portable
from core.storage import keys

JOB = "019aa3c2f0b1-5be0c1d2e3"
HASH = "0123456789abcdef" + 48 * "0"
OTHER_HASH = "fedcba9876543210" + 48 * "0"


def test_everything_of_a_job_lies_under_its_prefix() -> None:
    under = [
        keys.artifact(JOB, 1, HASH, "video.mp4"),
        keys.chunk(JOB, "events", 1, HASH),
        keys.chunk(JOB, "logs", 1, HASH),
    ]
    assert all(key.startswith(keys.job(JOB)) for key in under)
    assert len(set(under)) == 3


def test_an_object_of_a_job_tells_whose_it_is() -> None:
    assert keys.job_of(keys.artifact(JOB, 1, HASH, "video.mp4")) == JOB
    assert keys.job_of(keys.chunk(JOB, "logs", 1, HASH)) == JOB
    assert keys.job(JOB).startswith(keys.jobs())


def test_no_job_lies_under_the_prefix_of_another() -> None:
    # Without the slash at the end, deleting attempt 1 or job …e3 would take 10 and …e3x along.
    assert keys.job(JOB) == f"jobs/{JOB}/"


def test_attempts_are_apart() -> None:
    assert keys.artifact(JOB, 1, HASH, "policy") != keys.artifact(JOB, 2, HASH, "policy")
    assert not keys.artifact(JOB, 10, HASH, "policy").startswith(f"jobs/{JOB}/attempts/1/")


def test_other_bytes_have_another_key() -> None:
    # What one attempt publishes twice under a name is never written over: somebody may be reading it.
    assert keys.artifact(JOB, 1, HASH, "log.txt") != keys.artifact(JOB, 1, OTHER_HASH, "log.txt")
    assert keys.chunk(JOB, "logs", 1, HASH) != keys.chunk(JOB, "logs", 1, OTHER_HASH)


def test_chunks_sort_by_their_first_entries() -> None:
    firsts = [1, 9, 10, 100_000, 999_999_999_999]
    assert sorted(keys.chunk(JOB, "logs", first, HASH) for first in reversed(firsts)) == [
        keys.chunk(JOB, "logs", first, HASH) for first in firsts
    ]


def test_every_store_keeps_these_keys() -> None:
    assert is_portable(keys.chunk(JOB, "events", 1, HASH))
    assert is_portable(keys.artifact(JOB, 12, HASH, "checkpoint-000000500000.npz"))


def test_only_files_of_an_import_are_taken_for_such() -> None:
    assert keys.is_imported(keys.imported(JOB, HASH, "policy"))
    # The second is what consoles of S3 leave for a folder.
    for other in (keys.artifact(JOB, 1, HASH, "imported"), "jobs/", "jobs/readme"):
        assert not keys.is_imported(other)
