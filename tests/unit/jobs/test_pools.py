"""A machine's GPUs as one pool: what is free there, for whom it is kept, and which GPUs a job gets."""

from datetime import UTC, datetime
from typing import Any

import pytest

from core.jobs.forecast import forecasts_of
from core.jobs.pools import NothingFits, Offer, choose_for, pools_of
from core.jobs.queue import queue_names
from core.jobs.turns import NO_QUOTAS, Held, Pool, Request, Share, Started, TurnFacts
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
    assert pool.kinds == {f"gaitway-{kind}" for kind in ("any", "gpu", "gpu2", "gpu3", "gpu4")} | {"gaitway"}
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
