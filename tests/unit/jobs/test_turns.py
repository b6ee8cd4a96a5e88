"""Whose turn it is, by numbers that one can check by hand."""

from dataclasses import replace
from typing import Any

import pytest

from core.jobs.forecast import Lane, LaneKind, forecasts
from core.jobs.pools import pools_of
from core.jobs.queue import queue_names
from core.jobs.turns import (
    ADVANCE_S,
    Held,
    Pool,
    Quota,
    Quotas,
    Request,
    SharedGpu,
    Standings,
    Started,
    choose,
    decayed,
    in_order,
    reserve,
    to_drain,
)
from core.jobs.workers import WorkerInfo
from tests.unit.jobs.making import NOON

ANN, BEN, EVE = ("gaits", "ann"), ("gaits", "ben"), ("arms", "eve")


def asks(
    name: str,
    who: tuple[str, str] = ANN,
    gpus: int = 1,
    rank: int = 1,
    expected_s: float | None = None,
) -> Request:
    return Request(name, rank, who, gpus, expected_s)


def holds(
    name: str, who: tuple[str, str] = ANN, gpus: int = 1, *, pool: str = "", ends_at: float | None = None
) -> Held:
    return Held(name, 1, who, gpus, 0.0, ends_at, pool)


def names(requests: list[Request], standings: Standings) -> str:
    return "".join(request.id for request in in_order(requests, standings))


def test_what_was_used_is_halved_every_half_life() -> None:
    assert decayed(80.0, at=0.0, now=30.0, half_life_s=10.0) == 10.0
    assert decayed(80.0, at=50.0, now=30.0, half_life_s=10.0) == 80.0  # A clock was set back.


def test_jobs_of_one_user_come_by_priority_and_then_by_age() -> None:
    waiting = [asks("d"), asks("a", rank=2), asks("c"), asks("e", rank=0), asks("b")]
    assert names(waiting, Standings({ANN: 1e9})) == "ebcda"


def test_users_take_turns_however_many_jobs_the_first_has() -> None:
    waiting = [*(asks(name) for name in "abcd"), asks("e", BEN), asks("f", BEN)]
    assert names(waiting, Standings({})) == "aebfcd"


def test_who_has_used_less_comes_first_until_they_have_used_as_much() -> None:
    waiting = [*(asks(name) for name in "abc"), *(asks(name, BEN) for name in "defg")]
    assert names(waiting, Standings({ANN: 3 * ADVANCE_S})) == "defagbc"


def test_projects_come_before_users() -> None:
    """The project with one user who has used 3 comes before that of two users who have used 2 each."""
    use = {ANN: 2 * ADVANCE_S, BEN: 2 * ADVANCE_S, EVE: 3 * ADVANCE_S}
    assert names([asks("a"), asks("b", BEN), asks("c", EVE)], Standings(use)) == "cab"


def test_a_weight_of_two_is_worth_twice_as_much_and_one_of_zero_comes_last() -> None:
    waiting = [*(asks(name) for name in "abc"), *(asks(name, BEN) for name in "defg")]
    twice = Quotas({("user", "ben"): Quota(weight=2.0)})
    assert names(waiting, Standings({}, quotas=twice)) == "adebfgc"
    last = Quotas({("user", "ann"): Quota(weight=0.0)})
    assert names(waiting, Standings({}, quotas=last)) == "defgabc"


def test_a_running_job_counts_at_once_with_what_is_expected_of_it() -> None:
    waiting = [asks("a"), asks("b", BEN)]
    assert names(waiting, Standings({}, [holds("x")], now=1.0)) == "ba"
    use = {ANN: 5000.0}
    assert names(waiting, Standings(use, [holds("x", BEN)], now=1.0)) == "ba"
    assert names(waiting, Standings(use, [holds("x", BEN, ends_at=6000.0)], now=1.0)) == "ab"


def test_a_quota_of_running_jobs_holds_back_and_says_so() -> None:
    quotas = Quotas({("user", "ann"): Quota(running=2), ("project", "arms"): Quota(running=0)})
    standings = Standings({}, [holds("x")], elsewhere=[BEN], quotas=quotas)
    assert names([asks("a"), asks("b"), asks("c", BEN), asks("d", EVE)], standings) == "ca"
    assert standings.limit(ANN) == "2 jobs of the user ann run, and its quota is 2: one has to end first."
    assert standings.limit(EVE) == "The project arms may run nothing: its quota of running jobs is 0."
    assert standings.limit(BEN) is None


POOLS = [Pool("one", 8, 2), Pool("two", 8, 0)]
RUNNING = [
    holds("x", gpus=6, pool="one", ends_at=100.0),
    holds("y", gpus=4, pool="two", ends_at=50.0),
    holds("z", gpus=4, pool="two", ends_at=300.0),
]


def test_a_machine_is_kept_for_the_first_that_fits_nowhere() -> None:
    kept = reserve(asks("a", gpus=8), POOLS, RUNNING, now=0.0)
    assert kept is not None
    assert (kept.pool, kept.from_s, kept.spare) == ("one", 100.0, 0)
    kept = reserve(asks("a", gpus=3), POOLS, RUNNING, now=0.0)
    assert kept is not None
    assert (kept.pool, kept.from_s, kept.spare) == ("two", 50.0, 1)
    assert reserve(asks("a", gpus=9), POOLS, RUNNING, now=0.0) is None


@pytest.mark.parametrize(
    ("small", "taken"),
    [
        (asks("b", gpus=2, expected_s=99.0), "b"),  # It ends before.
        (asks("b", gpus=2, expected_s=101.0), None),
        (asks("b", gpus=2), None),
        (asks("b", gpus=3, expected_s=1.0), None),  # There is no room for it.
    ],
)
def test_others_pass_it_where_they_do_not_delay_it(small: Request, taken: str | None) -> None:
    found = choose(POOLS[0], [asks("a", gpus=8), small], POOLS, RUNNING, now=0.0)
    assert (found and found.id) == taken


def test_others_pass_it_on_other_machines_and_on_what_it_leaves_over() -> None:
    free = Pool("two", 8, 1)
    pools = [POOLS[0], free]
    found = choose(free, [asks("a", gpus=8), asks("b")], pools, RUNNING, now=0.0)
    assert (found and found.id) == "b"
    pools = [Pool("one", 8, 2)]
    found = choose(pools[0], [asks("a", gpus=7), asks("b")], pools, RUNNING, now=0.0)
    assert (found and found.id) == "b"


def test_what_drains_for_a_job_is_kept_for_it_beside_what_is_kept_for_others() -> None:
    """Of eight GPUs four are free, and four drain for `b`; the only other pool is kept for `a`."""
    pools = [Pool("one", 8, 4), Pool("two", 8, 0)]
    drains = Held("x", 2, EVE, 4, 0.0, 1e6, "one", yields_to="b")
    running = [drains, holds("y", gpus=8, pool="two", ends_at=2e6)]
    small = asks("c", rank=2, gpus=4)
    assert choose(pools[0], [asks("a", gpus=8), asks("b", gpus=8), small], pools, running, now=0.0) is None
    # What is more urgent goes first, and nothing is kept for whom nobody waits.
    assert choose(pools[0], [small, asks("b", gpus=8)], pools, running, now=0.0) == small
    assert choose(pools[0], [asks("a", gpus=8), small], pools, running, now=0.0) == small


def test_one_that_fits_elsewhere_is_left_to_that_machine() -> None:
    pools = [Pool("one", 8, 2), Pool("two", 8, 8)]
    found = choose(pools[0], [asks("a", gpus=8), asks("b", gpus=2)], pools, [], now=0.0)
    assert (found and found.id) == "b"


def test_those_make_room_who_lose_least_by_it() -> None:
    low = [
        Held("a", 2, BEN, 4, 0.0, pool="one", lost_s=100.0),
        Held("b", 2, BEN, 4, 0.0, pool="one", lost_s=10.0),
        Held("c", 2, BEN, 8, 0.0, pool="two", lost_s=20.0),
        Held("d", 1, BEN, 8, 0.0, pool="three"),
    ]
    pools = [Pool(name, 8, 0) for name in ("one", "two", "three")]
    assert [held.id for held in to_drain(asks("x", gpus=4), pools, low)] == ["b"]
    assert [held.id for held in to_drain(asks("x", gpus=8), pools, low)] == ["c"]
    assert to_drain(asks("x", gpus=8, rank=2), pools, low) == []
    said = Held("e", 1, BEN, 8, 0.0, pool="three", is_preemptible=True)
    assert to_drain(asks("x", gpus=8), [pools[2]], [said]) == [said]
    assert to_drain(asks("x", BEN, gpus=8), [pools[2]], [said]) == []  # One's own goes on.
    assert to_drain(asks("x", gpus=8), [Pool("three", 8, 8)], low) == []


def test_jobs_that_share_a_gpu_make_room_together_or_one_for_another() -> None:
    """Both have 4 of 16 bytes: a job of a whole GPU needs the ends of both, one of 10 bytes that of one."""
    pool = Pool("p", 1, 0, seats=2, gpu_bytes=16, shared={"gpu:0": SharedGpu(0, 8)})
    lost = {"a": 9.0, "b": 5.0}
    both = [
        Held(name, 2, ANN, 1, 0.0, end, "p", lost_s=lost[name], shares="gpu:0", memory=4)
        for name, end in (("a", 30.0), ("b", 50.0))
    ]
    whole, part = asks("x"), replace(asks("y"), memory=10)
    assert {held.id for held in to_drain(whole, [pool], both)} == {"a", "b"}
    assert [held.id for held in to_drain(part, [pool], both)] == ["b"]
    found = [reserve(request, [pool], both, 0.0) for request in (whole, part)]
    assert [(one.from_s, one.spare) for one in found if one] == [(50.0, 0), (30.0, 0)]
    # One that may not yield keeps the GPU.
    assert to_drain(whole, [pool], [both[0], replace(both[1], rank=0)]) == []


def test_each_worker_is_a_pool_of_the_gpus_of_its_hosts() -> None:
    def worker(name: str, device: str, hosts: int = 1, **more: Any) -> WorkerInfo:
        queues = queue_names(device, hosts)
        said = {"name": name, "host": "h", "pid": 1, "device": device, "hosts": hosts, "queues": queues}
        return WorkerInfo.model_validate({**said, "started_at": NOON, "seen_at": NOON, **more})

    workers = [
        worker("four", "gpu:0,1,2,3"),
        worker("gang", "gpu:0,1", 2),
        worker("one", "gpu:4"),
        worker("broken", "gpu:5", state="device_failed"),
        worker("cpu", "cpu"),
    ]
    started = [
        Started("a", ANN, "gpu", 4, 50.0, "gang", 2, is_preemptible=True),
        Started("b", BEN, "cpu", 1, 10.0, "cpu"),
        Started("c", BEN, "gpu", 1, 10.0, "broken"),
    ]
    pools, held = pools_of("gpu", workers, started, {ANN: 70.0})
    assert [(pool.name, pool.gpus, pool.free) for pool in pools] == [
        ("four", 4, 4),
        ("gang", 4, 0),
        ("one", 1, 1),
    ]
    assert pools[0].kinds == {"gaitway-gpu4"}
    assert held == [Held("a", 2, ANN, 4, -50.0, 20.0, "gang", is_preemptible=True)]
    pools, held = pools_of("cpu", workers, started, {})
    assert [(pool.name, pool.gpus, pool.free) for pool in pools] == [("cpu", 1, 0)]
    assert (held[0].id, held[0].ends_at) == ("b", None)


def test_a_forecast_by_measured_durations() -> None:
    """Two slots are free in 10 and 30 s; jobs take 100 s, so that they start after 10, 30, 110, 130 s."""
    lanes = [Lane(LaneKind(frozenset({"gpu"})), free_s) for free_s in (10.0, 30.0)]
    waiting = [
        Request(name, 1, who, kind=kind)
        for name, who, kind in (
            ("a", ANN, "gpu"),
            ("b", ANN, "gpu"),
            ("c", BEN, "gpu"),
            ("d", ANN, "gpu"),
            ("e", EVE, "gpu8"),
        )
    ]
    found = forecasts(waiting, lanes, Standings({}), usual_s=100.0)
    assert {name: (one.before, one.starts_s) for name, one in found.items()} == {
        "a": (0, 10.0),
        "c": (1, 30.0),
        "b": (2, 110.0),
        "d": (3, 130.0),
        "e": (0, None),
    }
    assert "2 jobs have their turn before it" in found["b"].reason
    unknown = forecasts(waiting[:3], lanes, Standings({}), usual_s=None)
    assert [unknown[name].starts_s for name in "acb"] == [10.0, 30.0, None]
