"""The work that a running job loses when one store is away for ten minutes.

Six services with real servers and the default times run side by side, each with a training of one step a
second; in each, one store refuses connections or does not answer. A step is lost when its row of metrics is
missing, or is there twice.
"""

import argparse
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from bench.stack import until
from bench.summary import Figure
from gaitway.client import Client
from tests.faults.campaign.proxy import Mode
from tests.faults.campaign.world import STORES, World

_BEFORE_S, _AFTER_S = 10.0, 20.0
# The service's defaults; the campaign's `World` has shorter times.
_DEFAULTS = {
    "GAITWAY_LEASE": "15",
    "GAITWAY_HEARTBEAT": "3",
    "GAITWAY_RECONCILE_EVERY": "1",
    "GAITWAY_GRACE": "60",
}
_HOW = {Mode.REFUSE: "refusing", Mode.SILENT: "silent"}


@dataclass(frozen=True)
class _Outage:
    steps_lost: int
    attempts: int
    caught_up_s: float


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """All six at once."""
    minutes = arguments.minutes or (0.1 if arguments.quick else 10.0)
    cases = [(store, mode) for store in STORES for mode in _HOW]
    with ThreadPoolExecutor(len(cases)) as pool:
        outages = dict(
            zip(cases, pool.map(partial(_outage, minutes), *zip(*cases, strict=True)), strict=True)
        )
    lost = max(one.steps_lost for one in outages.values())
    yield Figure(f"steps that {minutes:g} minutes without a store cost, at most", lost, at_most=0)
    attempts = max(one.attempts for one in outages.values())
    yield Figure("attempts that it took, at most", attempts, at_most=1)
    for (store, mode), one in outages.items():
        yield Figure(f"all stored after {store} was {_HOW[mode]}, within", one.caught_up_s, "s")


def _outage(minutes: float, store: str, mode: Mode) -> _Outage:
    told_s = 60 * minutes
    steps = round(_BEFORE_S + told_s + _AFTER_S)
    with World(settings=_DEFAULTS) as world:
        with Client(world.url) as client:
            job = client.submit(environment="inverted_pendulum", labels={"steps": str(steps), "step_s": "1"})
            until(lambda: len(_steps(client, job.id)) >= _BEFORE_S)
        proxies = [proxy for name, proxy in world.proxies.all.items() if name.endswith(f"/{store}")]
        for proxy in proxies:
            proxy.mode = mode
        time.sleep(told_s)
        for proxy in proxies:
            proxy.mode = Mode.OPEN
        healed = time.monotonic()
        with Client(world.url) as client:
            until(lambda: len(_steps(client, job.id)) >= told_s)
            caught_up_s = time.monotonic() - healed
            ended = client.wait(job.id, timeout=300)
            kept = _steps(client, job.id)
    lost = len(set(range(1, steps + 1)) - set(kept)) + len(kept) - len(set(kept))
    return _Outage(lost + (not ended.succeeded), len(ended.attempts), caught_up_s)


def _steps(client: Client, job_id: str) -> list[int]:
    """The steps of the rows of metrics; none while the service cannot answer."""
    with suppress(Exception):
        return [row.step for row in client.metrics(job_id)]
    return []
