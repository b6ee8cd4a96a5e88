"""Which running jobs make room for which waiting ones, by numbers that one can check by hand."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import pytest

from core.jobs.preemption import HEAD_START_S, LEAST_RUN_S, Holders, making_room, may_be_asked
from core.jobs.queue import queue_name, queue_names
from core.jobs.turns import Quota, Quotas, Request, Share, Started, TurnFacts
from core.jobs.workers import WorkerInfo
from tests.unit.jobs.making import NOON

ANN, BEN, EVE = ("gaits", "ann"), ("gaits", "ben"), ("arms", "eve")


def worker(name: str, device: str = "cpu") -> WorkerInfo:
    return WorkerInfo(
        name=name,
        host="h",
        pid=1,
        device=device,
        queues=queue_names(device),
        started_at=NOON,
        seen_at=NOON,
    )


def asks(name: str, who: tuple[str, str] = ANN, rank: int = 0, kind: str = "gaitway-any") -> Request:
    return Request(name, rank, who, kind=kind)


def runs(
    name: str,
    on: str,
    who: tuple[str, str] = BEN,
    rank: int = 1,
    age_s: float = 1000.0,
    *,
    preemptible: bool = False,
) -> Started:
    device = "gpu" if on.startswith("gpu") else "cpu"
    return Started(name, who, device, 1, age_s, on, rank, preemptible)


def drained(
    waiting: Sequence[Request],
    started: Sequence[Started],
    workers: Sequence[WorkerInfo],
    *,
    drains: Mapping[str, str] | None = None,
    asked: Collection[str] = (),
    used: Mapping[tuple[str, str], float] | None = None,
    quotas: Mapping[tuple[str, str], Quota] | None = None,
    able: Collection[str] | None = None,
) -> Mapping[str, Sequence[str]]:
    drains = drains or {}
    shares = [Share("cpu", who, amount, 1e4) for who, amount in (used or {}).items()]
    movable = {one.id for one in started} - drains.keys()
    facts = TurnFacts(waiting, started, shares, Quotas(quotas or {}))
    named = {one.name for one in workers} if able is None else able
    return making_room(Holders(facts, movable, drains, asked), workers, lambda _: named)


CPUS = [worker("one"), worker("two")]
BUSY = [runs("a", "one"), runs("b", "two", rank=2)]


def test_the_lowest_priority_makes_room_and_only_where_no_slot_is_free() -> None:
    assert drained([asks("x")], BUSY, CPUS) == {"x": ["b"]}
    assert drained([asks("x"), asks("y")], BUSY, CPUS) == {"x": ["b"], "y": ["a"]}
    assert drained([asks("x", rank=1)], BUSY, CPUS) == {"x": ["b"]}
    assert drained([asks("x", rank=2)], BUSY, CPUS) == {}
    assert drained([asks("x")], BUSY[:1], CPUS) == {}
    assert drained([asks("x"), asks("y")], BUSY[:1], CPUS) == {"y": ["a"]}
    # It has only just begun: that saves it from its peers alone.
    assert drained([asks("x")], [replace(one, age_s=1.0) for one in BUSY], CPUS) == {"x": ["b"]}


def test_nothing_drains_for_what_no_worker_could_run_or_a_quota_holds_back() -> None:
    assert drained([asks("x")], BUSY, CPUS, able=["one"]) == {"x": ["a"]}
    assert drained([asks("x")], BUSY, CPUS, able=[]) == {}
    # The free slot is none for it.
    assert drained([asks("x")], BUSY[:1], CPUS, able=["one"]) == {"x": ["a"]}
    assert drained([asks("x")], BUSY, CPUS, quotas={("user", "ann"): Quota(running=0)}) == {}
    assert drained([asks("x", kind="gaitway-gpu")], BUSY, CPUS) == {}


def test_no_second_job_drains_for_one_that_gets_room() -> None:
    waiting = [asks("x"), asks("y")]
    assert drained(waiting[:1], BUSY, CPUS, drains={"b": "x"}) == {}
    assert drained(waiting, BUSY, CPUS, drains={"b": "x"}) == {"y": ["a"]}
    # Others were asked a moment ago.
    assert drained(waiting[:1], BUSY, CPUS, asked=["x"]) == {}
    assert drained(waiting[:1], BUSY[:1], CPUS, asked=["x"]) == {}
    # Whoever was cancelled leaves its room to the next.
    assert drained(waiting[1:], BUSY, CPUS, drains={"b": "x"}) == {}


def test_a_job_for_either_device_takes_a_free_one_first_and_one_room_is_enough() -> None:
    mixed = [worker("one"), worker("gpu-host", "gpu:0")]
    assert drained([asks("x")], [runs("a", "gpu-host")], mixed) == {}
    both = [runs("a", "gpu-host"), runs("b", "one")]
    assert drained([asks("x")], both, mixed) == {"x": ["a"]}
    assert drained([asks("x", kind="gaitway-cpu")], both, mixed) == {"x": ["b"]}


def test_a_large_job_gets_room_of_as_many_as_it_needs_on_one_machine() -> None:
    """Of four GPUs one is free, and one has a job that stays: two need one more, and four get none."""
    queues = tuple(queue_name("gpu", "high", gpus) for gpus in (1, 2, 4))
    machine = [
        worker(name, name).model_copy(update={"pool": "gpu:0,1,2,3", "queues": queues})
        for name in ("gpu:0", "gpu:1", "gpu:2", "gpu:3")
    ]
    started = [runs("a", "gpu:0", rank=0), runs("b", "gpu:1"), runs("c", "gpu:2", rank=2)]
    pool = ["h/gpu:0,1,2,3"]
    two, four = (Request("x", 0, ANN, gpus, kind=f"gaitway-gpu{gpus}") for gpus in (2, 4))
    assert drained([two], started, machine, able=pool) == {"x": ["c"]}
    assert drained([four], started, machine, able=pool) == {}
    assert drained([four], [replace(one, rank=2) for one in started], machine, able=pool) == {
        "x": ["a", "b", "c"]
    }


PEER = runs("a", "one", BEN, preemptible=True, age_s=LEAST_RUN_S)


@pytest.mark.parametrize(
    ("waits", "running", "used", "makes_room"),
    [
        # Ben has used 1,000 s and what runs, and Ann would not have caught up after her head start.
        (asks("x", ANN, rank=1), PEER, {BEN: 1000.0}, True),
        (asks("x", ANN, rank=1), replace(PEER, is_preemptible=False), {BEN: 1000.0}, False),
        (asks("x", BEN, rank=1), PEER, {BEN: 1000.0}, False),
        (asks("x", ANN, rank=2), PEER, {BEN: 1000.0}, False),
        (asks("x", ANN, rank=1), replace(PEER, age_s=LEAST_RUN_S - 1), {BEN: 1000.0}, False),
        (asks("x", ANN, rank=1), PEER, {ANN: 1000.0 + LEAST_RUN_S - HEAD_START_S, BEN: 1000.0}, False),
        (asks("x", ANN, rank=1), PEER, {ANN: 999.0 + LEAST_RUN_S - HEAD_START_S, BEN: 1000.0}, True),
        # Projects are compared before users.
        (asks("x", EVE, rank=1), PEER, {EVE: 100.0, ANN: 900.0}, True),
        (asks("x", EVE, rank=1), PEER, {EVE: 1000.0, ANN: 900.0}, False),
    ],
)
def test_a_preemptible_job_makes_room_for_a_user_who_stays_ahead_for_a_while(
    waits: Request, running: Started, used: Mapping[tuple[str, str], float], makes_room: bool
) -> None:
    found = drained([waits], [running], CPUS[:1], used=used)
    assert found == ({"x": ["a"]} if makes_room else {})


def test_no_peer_makes_room_for_a_user_who_would_come_after_it_at_the_claim() -> None:
    """A claim counts all that a running job is expected to use: the slot would go back to the victim."""
    running = [runs("a", "one", ANN, age_s=10.0), replace(PEER, id="b", worker="two")]
    waits = [asks("x", ANN, rank=1)]
    assert drained(waits, running, CPUS, used={ANN: 0.0, BEN: 5000.0}) == {}
    assert drained(waits, running, CPUS, used={ANN: 0.0, BEN: 2e4}) == {"x": ["b"]}


def test_what_gets_room_counts_before_the_next_one_of_its_user() -> None:
    peers = [PEER, replace(PEER, id="b", worker="two")]
    waits = [asks("x", ANN, rank=1), asks("y", ANN, rank=1)]
    used = {ANN: 0.0, BEN: 5000.0}
    assert drained(waits, peers, CPUS, used=used) == {"x": ["a"]}
    assert drained(waits, peers, CPUS, used=used, drains={"a": "x"}) == {}


def test_waiting_jobs_are_read_only_where_somebody_could_make_room() -> None:
    high, preemptible = runs("a", "one", rank=0), runs("b", "two", rank=1, preemptible=True)
    assert [may_be_asked([high, preemptible], ["a", "b"], rank) for rank in (0, 1, 2)] == [True, True, False]
    assert not may_be_asked([high, preemptible], ["a"], 0)
