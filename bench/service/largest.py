"""The largest accepted form of each request: its costs, and how long `/healthz` waits meanwhile.

Each form is sent once. Processor time and memory are those of the API process; a second process asks for
`/healthz` a hundred times a second, and its longest wait counts. A line is printed for each form.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from bench.stack import Parts, running_parts
from bench.summary import Figure
from core.adapters.wiring import job_store
from tests.faults.campaign.largest_requests import Form, Service, forms
from tests.faults.campaign.largest_sweeps import fill

_MOST_CPU_S, _MOST_MIB, _LONGEST_WAIT_MS = 1.0, 64.0, 100.0
_TIMEOUT_S = 300.0
_IDLE_S = 5.0


@dataclass(frozen=True)
class _Cost:
    """failed: what the service answered in place of what was expected."""

    name: str
    cpu_s: float
    mib: float
    wait_ms: float
    failed: str = ""

    @property
    def is_beyond(self) -> bool:
        bounds = (_MOST_CPU_S, _MOST_MIB, _LONGEST_WAIT_MS)
        costs = (self.cpu_s, self.mib, self.wait_ms)
        return bool(self.failed) or any(cost > bound for cost, bound in zip(costs, bounds, strict=True))


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """Send each form of each route to an embedded stack with one API process and one worker."""
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running_parts(workers=1) as parts,
        httpx.Client(base_url=parts.url, timeout=_TIMEOUT_S, trust_env=False) as http,
        _watched(parts.url, Path(folder, "waits")) as waits,
    ):
        store = job_store(parts.settings())
        share = 0.01 if arguments.quick else 1.0
        service = Service(http, Path(folder), share, lambda sweep_id: fill(sweep_id, store))
        document = http.get("/openapi.json").json()
        waits.request_cpu_s = _idle_cpu_s(parts, waits)
        costs = [_measured(form, http, parts, waits) for form in forms(service, document, arguments.only)]
        store.close()
    yield from _figures(costs)


def _figures(costs: Sequence[_Cost]) -> Iterator[Figure]:
    yield Figure("largest requests: forms", len(costs))
    beyond = [cost for cost in costs if cost.is_beyond]
    yield Figure("largest requests: forms beyond a bound", len(beyond), at_most=0)
    for key, what, unit, most in (
        ("cpu_s", "processor time", "s", _MOST_CPU_S),
        ("mib", "memory grown", "MiB", _MOST_MIB),
        ("wait_ms", "`/healthz` meanwhile", "ms", _LONGEST_WAIT_MS),
    ):
        worst = max(costs, key=lambda cost: getattr(cost, key))
        yield Figure(
            f"largest requests: {what}, worst ({worst.name})", getattr(worst, key), unit, at_most=most
        )


def _idle_cpu_s(parts: Parts, waits: "Waits") -> float:
    """The API's seconds for a request for `/healthz`, with nothing else to do."""
    before, began = parts.cpu_s("api"), time.monotonic()
    time.sleep(_IDLE_S)
    used, ended = parts.cpu_s("api") - before, time.monotonic()
    return used / max(1, waits.between(began, ended)[1])


def _measured(form: Form, http: httpx.Client, parts: Parts, waits: "Waits") -> _Cost:
    api = next(parts.family("api")).pid
    Path(f"/proc/{api}/clear_refs").write_text("5")  # The peak of its memory begins again.
    before_mib, cpu_s = _memory_mib(api, "VmRSS"), parts.cpu_s("api")
    began, failed = time.monotonic(), ""
    try:
        form.send(http)
    except (AssertionError, httpx.HTTPError) as error:
        failed = str(error)[:300]
    longest_s, number = waits.between(began, time.monotonic())
    used_s = parts.cpu_s("api") - cpu_s - number * waits.request_cpu_s
    grown_mib = _memory_mib(api, "VmHWM") - before_mib
    name = f"{form.route}: {form.what}"
    cost = _Cost(name, max(0.0, used_s), max(0.0, grown_mib), 1000 * longest_s, failed)
    verdict = f"\tBEYOND {failed}" if cost.is_beyond else ""
    print(f"{cost.cpu_s:.3f} s\t{cost.mib:.1f} MiB\t{cost.wait_ms:.1f} ms\t{name}{verdict}", flush=True)
    return cost


def _memory_mib(pid: int, name: str) -> float:
    """name: `VmRSS` now, or `VmHWM`, the peak."""
    [line] = [one for one in Path(f"/proc/{pid}/status").read_text().splitlines() if one.startswith(name)]
    return int(line.split()[1]) / 1024


class Waits:
    """The record of `bench.children.healthz`. request_cpu_s: the API's processor time for one request."""

    def __init__(self, path: Path) -> None:
        self._file = path.open()
        self.request_cpu_s = 0.0

    def between(self, began: float, ended: float) -> tuple[float, int]:
        """The longest of the requests under way between these times, in seconds, and their number."""
        found = [0.0]
        last = began
        while last <= ended:  # Until one was sent after the end.
            line = self._file.readline()
            if not line.endswith("\n"):
                self._file.seek(self._file.tell() - len(line))
                time.sleep(0.01)
                continue
            last, answered = map(float, line.split())
            if answered >= began and last <= ended:
                found.append(answered - last)
        return max(found), len(found) - 1


@contextmanager
def _watched(url: str, path: Path) -> Generator[Waits]:
    with path.open("wb") as output:
        watcher = subprocess.Popen([sys.executable, "-m", "bench.children.healthz", url], stdout=output)
    try:
        yield Waits(path)
    finally:
        watcher.kill()
        watcher.wait()
