"""What a worker knows of the part of a cluster that it was given."""

from datetime import UTC, datetime, timedelta

from worker.host.allocation import TimeLeft, allocation


def test_slurms_names_are_kept_and_nothing_is_outside_of_slurm() -> None:
    names = {"SLURM_JOB_ID": "7", "SLURMD_NODENAME": "n1", "SLURM_JOB_ACCOUNT": "vnl", "SLURM_JOB_QOS": ""}
    assert allocation(names) == {"scheduler": "slurm", "id": "7", "node": "n1", "account": "vnl"}
    assert allocation({"SLURMD_NODENAME": "n1"}) == {}


def test_a_worker_drains_in_time_and_takes_no_job_that_it_could_not_bring_to_a_checkpoint() -> None:
    clock = iter([0.0, 10.0, 10.0, 859.0, 859.0, 861.0, 861.0, 959.0, 959.0, 961.0, 961.0])
    ends_at = datetime.fromtimestamp(1000, UTC)
    left = TimeLeft(ends_at, timedelta(seconds=25), timedelta(seconds=100), lambda: next(clock))
    # It drains from 1000 - 25 - 15 = 960 on, and takes no job from 860 on.
    found = [(left.is_too_short(), left.is_over()) for _ in range(5)]
    assert found == [(False, False), (False, False), (True, False), (True, False), (True, True)]


def test_a_worker_that_has_just_begun_takes_a_job_however_short_its_time_is() -> None:
    left = TimeLeft(
        datetime.fromtimestamp(100, UTC), timedelta(seconds=5), timedelta(seconds=90), lambda: 0.0
    )
    assert not left.is_too_short()
    forever = TimeLeft(None, timedelta(seconds=5), timedelta(seconds=90), lambda: 1e12)
    assert not forever.is_too_short()
    assert not forever.is_over()
