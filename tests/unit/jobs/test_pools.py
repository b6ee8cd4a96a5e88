"""A machine's GPUs as one pool: what is free there, for whom it is kept, and which GPUs a job gets."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import pytest

from core.jobs.forecast import forecasts_of
from core.jobs.pools import NothingFits, Offer, choose_for, pools_of
from core.jobs.queue import queue_names
from core.jobs.sharing import GIB
from core.jobs.turns import NO_QUOTAS, Held, Pool, Request, Share, SharedGpu, Started, TurnFacts
from core.jobs.workers import WorkerInfo

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)
ANN, BEN = ("gaits", "ann"), ("gaits", "ben")
POOL, NAME = "gpu:0,1,2,3", "h/gpu:0,1,2,3"


def member(gpu: int, digits: str = "00000a", host: str = "h", **more: Any) -> WorkerInfo:
    """One of four on a host."""
    device = f"gpu:{gpu}"
    said = {"host": host, "pid": 1, "device": device, "pool": POOL, "queues": queue_names(device, pool=4)}
    name = f"{host}:{device}:{digits}"
    return WorkerInfo.model_validate({"name": name, **said, "started_at": NOON, "seen_at": NOON, **more})


MACHINE = [member(gpu) for gpu in range(4)]


def runs(name: str, gpus: int, gpu: int, age_s: float = 50.0, digits: str = "00000a") -> Started:
    return Started(name, ANN, "gpu", gpus, age_s, f"h:gpu:{gpu}:{digits}")


def asks(name: str, gpus: int, who: tuple[str, str] = BEN) -> Request:
    return Request(name, 1, who, gpus, kind=f"gaitway-gpu{gpus if gpus > 1 else ''}")


def test_the_workers_of_a_machine_are_one_pool_of_the_gpus_that_work() -> None:
    workers = [MACHINE[0], member(1, state="lent"), member(2, state="kept"), member(3, state="device_failed")]
    pools, held = pools_of("gpu", workers, [runs("a", 2, 0)], {ANN: 70.0})
    (pool,) = pools
    assert (pool.name, pool.gpus, pool.free, pool.is_shared) == (NAME, 3, 1, True)
    kinds = ("any", "gpu", "gpu-shared", "gpu2", "gpu3", "gpu4")
    assert pool.kinds == {f"gaitway-{kind}" for kind in kinds} | {"gaitway"}
    assert held == [Held("a", 0, ANN, 2, -50.0, 20.0, NAME)]


def test_a_job_holds_its_gpus_until_it_ends_also_where_its_worker_has_gone() -> None:
    """A worker was killed: the next one of its GPU is there, beside the last report of the one before."""
    again = [*MACHINE, member(0, "00000b")]
    for workers in (again, again[1:]):
        (pool,), held = pools_of("gpu", workers, [runs("a", 2, 0)], {})
        assert (pool.gpus, pool.free, [one.id for one in held]) == (4, 2, ["a"])


@pytest.mark.parametrize(
    ("own", "free", "gpus", "device"),
    [
        (2, {0, 1, 2, 3}, 1, "gpu:2"),
        (2, {0, 1, 2, 3}, 2, "gpu:2,3"),  # The pair, so that 0 and 1 stay one.
        (2, {0, 1, 2}, 2, "gpu:1,2"),
        (5, set(range(8)), 4, "gpu:4,5,6,7"),
        (5, set(range(8)), 3, "gpu:4,5,6"),
        (7, {0, 3, 7}, 3, "gpu:0,3,7"),
    ],
)
def test_a_job_gets_neighbours_of_the_smallest_block(
    own: int, free: set[int], gpus: int, device: str
) -> None:
    assert Offer(NAME, own, frozenset(free)).device(gpus) == device


def offered(free: set[int], requests: list[Request], *started: Started, **usual_s: float) -> Request | None:
    shares = [Share("gpu", ("gaits", user), 0.0, seconds) for user, seconds in usual_s.items()]
    facts = TurnFacts(requests, started, shares, NO_QUOTAS)
    return choose_for(Offer(NAME, min(free), frozenset(free), MACHINE), requests, facts)


def test_gpus_are_kept_for_a_job_that_needs_more_than_are_free() -> None:
    waiting = [asks("a", 4), asks("b", 1)]
    with pytest.raises(NothingFits, match="The job a comes first, and needs 4 GPUs; 1 is free here"):
        offered({3}, waiting, runs("x", 3, 0))
    # The one that runs ends in 950 s, and a job of ben takes 900 s: he does not delay his other one.
    chosen = offered({3}, waiting, runs("x", 3, 0), ann=1000.0, ben=900.0)
    assert chosen is not None
    assert chosen.id == "b"
    with pytest.raises(NothingFits):
        offered({3}, waiting, runs("x", 3, 0), ann=1000.0, ben=960.0)


def test_what_one_looks_at_counts_more_than_what_the_record_says() -> None:
    """A process that was killed still holds two GPUs that no attempt has."""
    chosen = offered({2, 3}, [asks("a", 2)])
    assert chosen is not None
    with pytest.raises(NothingFits):
        offered({2, 3}, [asks("a", 4)])


def test_without_a_job_that_waits_there_is_nothing_to_say() -> None:
    assert offered({0}, []) is None


def test_a_machine_is_kept_only_where_no_other_one_has_room() -> None:
    other = [member(gpu, host="i") for gpu in range(4)]
    facts = TurnFacts([], [runs("x", 3, 0)], [], NO_QUOTAS)
    offer = Offer(NAME, 3, frozenset({3}), [*MACHINE, *other])
    chosen = choose_for(offer, [asks("a", 4), asks("b", 1)], facts)
    assert chosen is not None
    assert chosen.id == "b"


def test_a_gpu_that_no_attempt_has_is_not_free_while_its_worker_says_so() -> None:
    """A stray process has a GPU of the first machine, and a job has one of the second: both are short."""
    first = [member(gpu, state="lent" if gpu else "ready") for gpu in (0, 1)]
    second = [member(gpu, host="i") for gpu in (0, 1)]
    started = [Started("x", ANN, "gpu", 1, 50.0, "i:gpu:0:00000a")]
    pools, _ = pools_of("gpu", [*first, *second], started, {})
    assert [(pool.gpus, pool.free) for pool in pools] == [(2, 1), (2, 1)]
    facts = TurnFacts([], started, [], NO_QUOTAS)
    offer = Offer("i/gpu:0,1,2,3", 1, frozenset({1}), [*first, *second])
    with pytest.raises(NothingFits, match="The job a comes first"):
        choose_for(offer, [asks("a", 2), asks("b", 1, ANN)], facts)


def test_a_forecast_counts_the_gpus_of_each_job() -> None:
    """Three GPUs are free in 20 s. Jobs of ben take 100 s: one starts now, that of four GPUs at 100 s."""
    facts = TurnFacts(
        [asks("a", 1), asks("b", 4), asks("c", 2)],
        [runs("x", 3, 0)],
        [Share("gpu", ANN, 0.0, 70.0), Share("gpu", BEN, 0.0, 100.0)],
        NO_QUOTAS,
    )
    found = forecasts_of(facts, MACHINE, {})
    assert {name: one.starts_s for name, one in found.items()} == {"a": 0.0, "b": 100.0, "c": 200.0}


def test_a_pool_of_unknown_workers_is_as_large_as_what_is_offered() -> None:
    facts = TurnFacts([], [], [], NO_QUOTAS)
    assert choose_for(Offer(NAME, 0, frozenset({0, 1})), [one := asks("a", 2)], facts) == one
    assert Pool(NAME, 2, 2).has_room(one)


# ---- Jobs that share a GPU: two of 16 GiB each, of which 2 GiB are kept, with two seats on each. -----------

SEATS = [
    member(gpu, f"00000{seat}", pool="gpu:0,1", seats=2, seat=seat, memory_bytes=16 * GIB)
    for gpu in (0, 1)
    for seat in (0, 1)
]
TWO = "h/gpu:0,1"


def shares(name: str, gpu: int, gib: float, seat: int = 0) -> Started:
    return Started(name, ANN, "gpu", 1, 50.0, f"h:gpu:{gpu}:00000{seat}", part=gib / 16)


def wants(name: str, gib: float | None) -> Request:
    memory = None if gib is None else int(gib * GIB)
    return Request(name, 1, BEN, kind="gaitway-gpu-shared", memory=memory)


def at(
    gpu: int, requests: list[Request], *started: Started, free: set[int], parts: list[float]
) -> Request | None:
    offer = Offer(TWO, gpu, frozenset(free), _busy(started), parts)
    return choose_for(offer, requests, TurnFacts(requests, started, [], NO_QUOTAS))


def _busy(started: Sequence[Started]) -> list[WorkerInfo]:
    jobs = {one.worker: (one.id,) for one in started}
    return [worker.model_copy(update={"jobs": jobs.get(worker.name, ())}) for worker in SEATS]


def test_a_gpu_that_jobs_share_has_what_they_leave_of_it() -> None:
    started = [shares("a", 0, 6.0)]
    (pool,), held = pools_of("gpu", _busy(started), started, {})
    assert (pool.gpus, pool.free, pool.gpu_bytes) == (2, 1, 14 * GIB)
    assert pool.shared == {"gpu:0": SharedGpu(1, 8 * GIB)}
    assert [(one.shares, one.memory, one.part) for one in held] == [("gpu:0", 6 * GIB, 6 / 16)]
    assert pool.has_room(wants("b", 8.0))
    assert pool.after_start(wants("b", 8.0)).shared["gpu:0"] == SharedGpu(0, 0)
    assert pool.after_start(wants("b", 9.0)).free == 0  # It opens the other one.
    ended = pool.after_end(held[0])
    assert (ended.free, ended.shared) == (2, {})


def test_a_seat_without_a_worker_is_none() -> None:
    started = [shares("a", 0, 6.0)]
    (pool,), _ = pools_of("gpu", [worker for worker in _busy(started) if worker.seat == 0], started, {})
    assert pool.shared == {"gpu:0": SharedGpu(0, 8 * GIB)}


def test_a_job_joins_others_and_leaves_whole_gpus_free() -> None:
    first = shares("a", 0, 6.0)
    one = wants("b", 8.0)
    assert at(0, [one], first, free={1}, parts=[6 / 16]) == one
    with pytest.raises(NothingFits, match="The job b comes first, and shares a GPU; another one has room"):
        at(1, [one], first, free={1}, parts=[])
    # What does not fit there opens the other GPU, and a job of a whole one does not wait for it.
    large = wants("c", 9.0)
    assert at(1, [large], first, free={1}, parts=[]) == large
    with pytest.raises(
        NothingFits, match=r"The job c comes first, and needs 9 GiB of a GPU; this one has not"
    ):
        at(0, [large], first, free=set(), parts=[6 / 16])
    assert at(1, [one, asks("d", 1)], first, free={1}, parts=[]) == asks("d", 1)


def test_the_first_of_its_kind_has_a_gpu_alone_and_so_has_one_that_needs_all_of_its_memory() -> None:
    for request in (wants("a", None), wants("a", 15.0)):
        offer = Offer(TWO, 0, frozenset({0, 1}), SEATS)
        assert offer.given_to(request) == ("gpu:0", None)
        assert at(0, [request], free={0, 1}, parts=[]) == request
        with pytest.raises(NothingFits, match="needs a GPU; 0 are free here"):
            at(0, [request], shares("b", 0, 1.0), shares("c", 1, 1.0), free=set(), parts=[1 / 16])
    assert Offer(TWO, 0, frozenset({0}), SEATS).given_to(wants("a", 4.0)) == ("gpu:0", 0.25)


def test_a_waiting_job_of_a_whole_gpu_is_not_delayed_by_others_that_share_one() -> None:
    """The one that runs ends at 20 s, and nobody knows how long a job of ben takes."""
    waiting = [asks("b", 2), wants("c", 4.0)]
    with pytest.raises(NothingFits, match="The job b comes first, and needs 2 GPUs; 0 are free here"):
        at(0, waiting, shares("a", 0, 6.0), runs("x", 1, 1), free=set(), parts=[6 / 16])


def test_a_forecast_knows_parts_of_gpus() -> None:
    """What runs ends in 20 s: b has the free seat now, c and d share the GPU of one of those that end."""
    started = [shares("a", 0, 6.0), runs("x", 1, 1)]
    requests = [wants("b", 6.0), wants("c", 6.0), wants("d", 6.0)]
    usual = [Share("gpu", ANN, 0.0, 70.0), Share("gpu", BEN, 0.0, 100.0)]
    found = forecasts_of(TurnFacts(requests, started, usual, NO_QUOTAS), _busy(started), {})
    assert [found[name].starts_s for name in "bcd"] == [0.0, 20.0, 20.0]
    assert found["b"].reason == "It is next: it shares a GPU with others, of which it has 6 GiB."
    alone = forecasts_of(TurnFacts([wants("e", None)], started, usual, NO_QUOTAS), _busy(started), {})
    assert alone["e"].starts_s == 20.0
    assert "it has a GPU alone when one is free, since no job like it was measured" in alone["e"].reason
