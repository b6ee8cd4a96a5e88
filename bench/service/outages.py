"""Measures what a running job loses when one store is away for ten minutes."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, Table, at_most, below
from bench.stack.waiting import until
from gaitway.client import Client
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import STORES, World

_MINUTES = 10.0
_BEFORE_S, _AFTER_S = 10.0, 20.0
_STEP_S = 1.0
# The service's defaults; the fault campaign's `World` has shorter times.
_DEFAULTS = {
    "GAITWAY_LEASE": "15",
    "GAITWAY_HEARTBEAT": "3",
    "GAITWAY_RECONCILE_EVERY": "1",
    "GAITWAY_GRACE": "60",
}
_NAMES = {"postgres": "PostgreSQL", "valkey": "Redis", "weed": "the object store"}
_HOW = {Mode.REFUSE: "refusing", Mode.SILENT: "silent"}

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Run six services at once; in each, one store refuses connections or does not answer."""
    machine = this_machine()
    minutes = options.minutes or (0.1 if options.quick else _MINUTES)
    cases = [(store, mode) for store in STORES for mode in (Mode.REFUSE, Mode.SILENT)]
    with ThreadPoolExecutor(len(cases)) as pool:
        running = [pool.submit(_outage, store, mode, minutes) for store, mode in cases]
        outages = [one.result() for one in running]
    return Result(
        name="outages",
        title="Outages",
        command="./run bench outages",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(
                name=f"steps that {minutes:g} minutes without a store cost, at most",
                value=float(max(row["steps_lost"] for row in outages)),
                unit="",
                target=below(1),
            ),
            Figure(
                name="attempts that it took, at most",
                value=float(max(row["attempts"] for row in outages)),
                unit="",
                target=at_most(1),
            ),
        ],
        rows=outages,
        table=Table(
            headings=["away", "how", "attempts", "steps", "all stored after the outage within"],
            rows=[
                [
                    _NAMES[row["store"]],
                    row["how"],
                    str(row["attempts"]),
                    f"{row['steps_kept']} of {row['steps']}",
                    f"{row['caught_up_s']:.1f} s",
                ]
                for row in outages
            ],
        ),
        notes=[
            "Outages: real servers and processes with the service's default times, and a training process of "
            f"one step a second that runs for another {_AFTER_S:.0f} s after the outage. A step is lost "
            "when its "
            "row of metrics is missing or is there twice. All six run side by side.",
        ],
    )


def _outage(store: str, mode: Mode, minutes: float) -> Row:
    steps = round((_BEFORE_S + 60 * minutes + _AFTER_S) / _STEP_S)
    labels = {"steps": str(steps), "step_s": str(_STEP_S)}
    with World(settings=_DEFAULTS) as world:
        with Client(world.url) as client:
            job = client.submit(environment="inverted_pendulum", labels=labels)
            until(lambda: len(_steps(client, job.id)) * _STEP_S >= _BEFORE_S)
        proxies = [proxy for name, proxy in world.proxies.all.items() if name.endswith(f"/{store}")]
        for proxy in proxies:
            proxy.mode = mode
        time.sleep(60 * minutes)
        for proxy in proxies:
            proxy.mode = Mode.OPEN
        healed, told_s = time.monotonic(), 60 * minutes
        with Client(world.url) as client:
            until(lambda: len(_steps(client, job.id)) * _STEP_S >= told_s)
            caught_up_s = time.monotonic() - healed
            ended = client.wait(job.id, timeout=300)
            kept = _steps(client, job.id)
    expected = list(range(1, steps + 1))
    lost = len(set(expected) - set(kept)) + len(kept) - len(set(kept))
    return {
        "store": store,
        "how": _HOW[mode],
        "minutes": minutes,
        "status": ended.status,
        "attempts": len(ended.attempts),
        "steps": steps,
        "steps_kept": len(set(kept)),
        "steps_lost": lost + (not ended.succeeded),
        "caught_up_s": caught_up_s,
    }


def _steps(client: Client, job_id: str) -> list[int]:
    """The steps of the rows of metrics; none while the service cannot answer."""
    with suppress(Exception):
        return [row.step for row in client.metrics(job_id)]
    return []
