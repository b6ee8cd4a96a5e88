"""The GPUs that workers of a machine share out: locks in one folder, and what is written beside them."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from core.errors import Misconfigured
from core.jobs.slots import GPU
from tests.faults.bench import unused_servers
from worker.host import device
from worker.host.device_health import set_aside
from worker.host.locks import slot
from worker.host.pool import Membership, Pool, Turn, pool_of

LOCKS = {number: f"gpu-boot-nvidia{number}" for number in range(4)}


@pytest.fixture
def pool(tmp_path: Path) -> Iterator[Pool]:
    (tmp_path / "locks").mkdir()
    yield Pool(1, LOCKS, tmp_path)
    assert not list(tmp_path.glob("locks/*"))


def never() -> bool:
    return False


def test_a_job_has_its_gpus_until_it_ends_and_the_others_are_free(pool: Pool) -> None:
    other = Pool(2, LOCKS, pool.data_dir)
    with pool.turn(never) as turn:
        offer = turn.offer([])
        assert offer is not None
        assert (offer.own, offer.free) == (1, {0, 1, 2, 3})
        assert other.free() is None  # Who knows what this one takes?
        kept = turn.keep("gpu:1,2", "019aa3")
    with kept as descriptors:
        assert len(descriptors) == 2
        assert pool.free() == other.free() == {0, 3}
        assert other.says_who() == "The job 019aa3 has its GPU: it runs on gpu:1,2 of this machine."
        with other.turn(never) as turn:
            assert turn.offer([]) is None
        with Pool(0, LOCKS, pool.data_dir).turn(never) as turn:
            offer = turn.offer([])
            assert offer is not None
            assert offer.free == {0, 3}
    assert other.free() == {0, 1, 2, 3}


def test_a_gpu_that_was_set_aside_or_is_tested_is_not_free(pool: Pool) -> None:
    set_aside(pool.data_dir, [LOCKS[3]], "It has fallen off the bus.")
    with slot(pool.lock(0), 0.0):
        assert pool.free() == {1, 2}
        assert Pool(0, LOCKS, pool.data_dir).says_who() == "Another process of this machine uses its GPU."
        with pool.turn(never) as turn:
            offer = turn.offer([])
            assert offer is not None
            assert offer.free == {1, 2}


def test_a_worker_waits_while_its_gpu_is_lent_and_while_gpus_are_kept(pool: Pool) -> None:
    now = 0.0
    membership = Membership(pool, lambda: now)
    assert membership.look()
    with slot(pool.lock(1), 0.0):
        assert not membership.look()
        assert (membership.state, membership.free) == ("lent", {0, 2, 3})
        assert membership.look(prepares=True)
    with slot(pool.lock(2), 0.0):
        pool.note_kept("The job a comes first.")
        assert not membership.look()
        assert (membership.state, membership.problem) == ("kept", "The job a comes first.")
        now = 9.9
        assert not membership.look()
    assert membership.look()  # Another GPU is free.
    assert membership.problem is None
    pool.note_kept("The job a comes first.")
    assert not membership.look()
    now = 20.0
    assert membership.look()


def test_gpus_that_fail_together_take_jobs_of_one_for_an_hour(pool: Pool) -> None:
    membership = Membership(Pool(3, LOCKS, pool.data_dir))
    assert membership.look()
    assert membership.most_gpus == 4
    pool.set_apart("The GPUs 0 and 1 do not work together.")
    assert membership.look()
    assert (membership.most_gpus, len(membership.free)) == (1, 4)
    assert membership.problem == (
        "It takes only jobs of one GPU for an hour. The GPUs 0 and 1 do not work together."
    )
    (mark,) = pool.data_dir.glob("devices/*")
    long_ago = time.time() - 3601
    os.utime(mark, (long_ago, long_ago))
    assert (membership.most_gpus, membership.problem) == (4, None)


def test_a_full_disk_takes_no_gpu_from_a_job(pool: Pool) -> None:
    """The job was claimed already: the worker ended with it."""
    with Turn(pool, {1: os.open("/dev/full", os.O_RDWR)}).keep("gpu:1", "019aa3") as descriptors:
        assert len(descriptors) == 1


def test_jobs_share_a_gpu_each_on_a_seat_and_no_other_job_gets_it(pool: Pool) -> None:
    """The GPU is free again when the last of them has ended, in whichever order."""
    first, second = (Pool(1, LOCKS, pool.data_dir, seat, 2) for seat in (0, 1))
    with first.turn(never) as turn:
        assert turn.offer([]) is not None
        one = turn.keep("gpu:1", "019aa3", 0.25)
    with first.turn(never) as turn:  # Its training still runs, and its worker may not take another one.
        assert turn.offer([]) is None
    member, other = Membership(second), Membership(Pool(2, LOCKS, pool.data_dir, 0, 2))
    assert member.look()
    assert not member.asks(GPU, shared=False)
    assert member.asks(GPU, shared=True)
    assert other.look()
    assert other.free == {0, 2, 3}
    other.pool.note_kept("The job a comes first.")
    assert not other.look()
    with second.turn(never) as turn:
        offer = turn.offer([])
        assert offer is not None
        assert (offer.own, offer.free, offer.parts) == (1, {0, 2, 3}, [0.25])
        two = turn.keep("gpu:1", "019aa4", 0.5)
    assert other.look()  # What it was kept for has its seat.
    with one:
        pass
    assert first.parts() == [0.5]
    assert second.parts() is None  # Its seat is taken.
    assert pool.free() == {0, 2, 3}
    with two:
        pass
    assert pool.free() == {0, 1, 2, 3}


def test_a_gpu_that_one_job_has_is_not_shared(pool: Pool) -> None:
    with pool.turn(never) as turn:
        kept = turn.keep("gpu:1", "019aa3")
    with kept:
        assert Pool(1, LOCKS, pool.data_dir, 1, 2).parts() is None


def test_a_pool_is_of_workers_with_one_gpu_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "visible_gpus", lambda dev=None: ["nvidia0", "nvidia1", "nvidia2"])
    settings = unused_servers(tmp_path)
    shared = settings.model_copy(update={"pool": "gpu:0-1"})
    assert pool_of(settings, "gpu:0") is None
    pool = pool_of(shared, "gpu:1")
    assert pool is not None
    assert (pool.device, pool.own) == ("gpu:0,1", 1)
    assert pool_of(shared, "cpu") is None
    for wrong in ("gpu:2", "gpu:0,1"):
        with pytest.raises(Misconfigured, match="GAITWAY_POOL=gpu:0-1 is for workers with one of these GPUs"):
            pool_of(shared, wrong)
