"""How many workers are started and called off, from what the queue wants and what runs."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import pytest

from core.jobs.queue import queue_names
from core.jobs.slots import ANY, CPU, GPU, SlotKind, WantedSlots
from core.jobs.workers import WorkerInfo
from worker.cluster.launcher import Allocation
from worker.cluster.scale import Decision, Limits, Memory, Seen, decide, lost, refused, unknown

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)
FOUR = SlotKind("gpu", 4)
LIMITS = Limits(most=4, kinds=(CPU, GPU, FOUR), any_as="gpu")


def wants(kind: SlotKind, queued: int, age_s: float = 1.0) -> WantedSlots:
    return WantedSlots(kind, queued, 0, age_s)


def worker(
    device: str, allocation: str | None = None, job: str | None = None, **more: Any
) -> tuple[WorkerInfo, float]:
    where = None if allocation is None else {"scheduler": "slurm", "id": allocation}
    facts = WorkerInfo(
        name=f"{device}-{allocation}",
        host="n1",
        pid=1,
        device=device,
        queues=queue_names(device),
        job=job,
        allocation=where,
        started_at=NOON,
        seen_at=NOON,
        **more,
    )
    return facts, 1.0


def seen(
    now_s: float = 0.0,
    *,
    wanted: Sequence[WantedSlots] = (),
    allocations: Sequence[Allocation] = (),
    workers: Sequence[tuple[WorkerInfo, float]] = (),
) -> Seen:
    return Seen(now_s, wanted, allocations, workers)


def first(look: Seen, memory: Memory | None = None, limits: Limits = LIMITS) -> Decision:
    return decide(look, memory or Memory(), limits)[0]


def test_an_empty_queue_starts_nothing() -> None:
    assert first(seen(workers=[worker("cpu")])) == Decision({}, [], [])


def test_the_free_gpus_of_a_pool_are_slots_for_jobs_of_any_size() -> None:
    """Of its eight GPUs, six are free: for the job of four and two small ones; another of four needs one."""
    states = ["ready"] * 6 + ["lent"]
    members = [worker(f"gpu:{n}", state=state, pool="gpu:0-7") for n, state in enumerate(states)]
    members.append(worker("gpu:7", job="a", pool="gpu:0-7"))
    waiting = [wants(FOUR, 1), wants(GPU, 2)]
    assert first(seen(wanted=waiting, workers=members)).starts == {}
    assert first(seen(wanted=[wants(FOUR, 2), wants(GPU, 2)], workers=members)).starts == {FOUR: 1}
    assert first(seen(wanted=[wants(FOUR, 1), wants(GPU, 3)], workers=members)).starts == {GPU: 1}


def test_a_gpu_with_a_job_on_either_seat_is_no_slot() -> None:
    def seats(*jobs: str | None) -> list[tuple[WorkerInfo, float]]:
        return [worker("gpu:0", job=job, pool="gpu:0", seats=2, seat=seat) for seat, job in enumerate(jobs)]

    for jobs in ((None, "a"), ("a", None)):
        assert first(seen(wanted=[wants(GPU, 1)], workers=seats(*jobs))).starts == {GPU: 1}
    assert first(seen(wanted=[wants(GPU, 1)], workers=seats(None, None))).starts == {}
    gone = [(facts, 60.0 if facts.seat else 1.0) for facts, _ in seats(None, "a")]
    assert first(seen(wanted=[wants(GPU, 1)], workers=gone)).starts == {}


def test_each_queued_job_gets_an_allocation_up_to_the_limit_the_oldest_first() -> None:
    look = seen(wanted=[wants(CPU, 3, age_s=1), wants(FOUR, 2, age_s=60)])
    assert first(look).starts == {FOUR: 2, CPU: 2}
    assert first(look, limits=replace(LIMITS, most_of={FOUR: 1})).starts == {FOUR: 1, CPU: 3}


def test_what_is_on_its_way_or_idle_takes_a_job_each() -> None:
    pending, running = Allocation("1", CPU, "pending"), Allocation("2", CPU, "running", "n1")
    look = seen(
        wanted=[wants(CPU, 4)],
        allocations=[pending, running, Allocation("3", CPU, "running", "n1")],
        workers=[worker("cpu", "3", job="a"), worker("cpu")],
    )
    # 4 jobs, less one that is pending, one whose worker starts, and an idle worker elsewhere: 1.
    assert first(look).starts == {CPU: 1}


@pytest.mark.parametrize(("any_as", "kind"), [("gpu", GPU), ("cpu", CPU)])
def test_a_job_for_any_device_starts_the_preferred_kind_unless_a_worker_of_either_is_idle(
    any_as: str, kind: SlotKind
) -> None:
    limits = replace(LIMITS, any_as=any_as)
    assert first(seen(wanted=[wants(ANY, 1)]), limits=limits).starts == {kind: 1}
    for device in ("cpu", "gpu:0"):
        look = seen(wanted=[wants(ANY, 1)], workers=[worker(device)])
        assert first(look, limits=limits).starts == {}
    busy = seen(wanted=[wants(ANY, 1), wants(CPU, 1)], workers=[worker("cpu")])
    assert first(busy, limits=limits).starts == {kind: 1}


def test_the_worker_of_a_preempted_allocation_is_not_idle_any_more() -> None:
    look = seen(
        wanted=[wants(CPU, 1)],
        allocations=[Allocation("1", CPU, "pending")],
        workers=[worker("cpu", "1")],
    )
    # Its allocation comes back, and takes the job.
    assert first(look).starts == {}
    elsewhere = [(worker("cpu")[0], 60.0)]
    assert first(seen(wanted=[wants(CPU, 1)], workers=elsewhere)).starts == {CPU: 1}


def test_pending_allocations_are_called_off_once_nobody_has_wanted_them_for_a_while() -> None:
    allocations = [
        Allocation("1", CPU, "running"),
        Allocation("2", CPU, "pending"),
        Allocation("3", GPU, "pending"),
    ]
    memory = Memory()
    stops = list[Sequence[str]]()
    for now_s, wanted in ((0, [wants(CPU, 1)]), (20, [wants(CPU, 1)]), (31, [wants(CPU, 1), wants(GPU, 1)])):
        decision, memory = decide(seen(now_s, wanted=wanted, allocations=allocations), memory, LIMITS)
        stops.append(decision.stops)
    # A job for a GPU came in time, and the running one takes the job on the CPU.
    assert stops == [[], [], ["2"]]
    assert lost(seen(33, allocations=allocations[::2]), memory) == []


def test_a_stuck_allocation_is_called_off_at_once_and_another_is_started() -> None:
    stuck = [Allocation("1", CPU, "stuck", reason="launch failed requeued held")]
    decision, memory = decide(seen(wanted=[wants(CPU, 1)], allocations=stuck), Memory(), LIMITS)
    assert (decision.starts, decision.stops) == ({CPU: 1}, ["1"])
    assert lost(seen(1), memory) == []


def test_an_allocation_that_fails_before_its_worker_is_heard_of_makes_its_kind_pause() -> None:
    look = seen(0, wanted=[wants(CPU, 3)])
    memory, starts = Memory(), list[tuple[float, int]]()
    for now_s in range(0, 200):
        here = [Allocation(str(now_s), CPU, "running", "n1")] if starts and starts[-1][0] == now_s - 1 else []
        now = replace(look, now_s=float(now_s), allocations=here)
        for one in lost(now, memory):
            memory = refused(memory, one.kind, now_s)
        decision, memory = decide(now, memory, LIMITS)
        if decision.starts and not here:
            starts.append((now_s, decision.starts[CPU]))
    # 10 s after the first failure, 20 after the second, ...; one is tried at a time.
    assert starts[0] == (0, 3)
    assert [number for _, number in starts[1:]] == [1] * (len(starts) - 1)
    pauses = [b[0] - a[0] for a, b in pairwise(starts)]
    assert pauses == [12, 22, 42, 82]


def test_a_worker_that_is_heard_of_ends_the_pauses() -> None:
    memory = refused(refused(Memory(), CPU, 0.0), CPU, 0.0)
    assert memory.paused_until_s == {CPU: 20.0}
    there = [Allocation("1", CPU, "running", "n1")]
    look = seen(30, wanted=[wants(CPU, 3)], allocations=there, workers=[worker("cpu", "1", job="a")])
    decision, memory = decide(look, memory, LIMITS)
    assert (memory.failures, decision.starts) == ({}, {CPU: 3})
    # Its end is none before its worker was heard of.
    assert lost(seen(40), memory) == []


def test_after_a_start_of_unknown_outcome_nothing_of_its_kind_is_started_for_a_minute() -> None:
    memory = unknown(Memory(), CPU, 0.0)
    look = seen(59, wanted=[wants(CPU, 1), wants(GPU, 1)])
    assert first(look, memory).starts == {GPU: 1}
    assert first(replace(look, now_s=60.0), memory).starts == {CPU: 1, GPU: 1}
    shown = replace(look, now_s=60.0, allocations=[Allocation("1", CPU, "pending")])
    assert first(shown, memory).starts == {GPU: 1}


def test_jobs_that_no_part_serves_are_told() -> None:
    sixteen = SlotKind("gpu", 8, 2)
    look = seen(wanted=[wants(sixteen, 1), wants(ANY, 1)])
    limits = replace(LIMITS, kinds=(CPU,), any_as="cpu")
    decision = first(look, limits=limits)
    assert ([one.kind for one in decision.unserved], decision.starts) == ([sixteen], {CPU: 1})
