"""The largest accepted form of each request: its costs, and how long others wait meanwhile."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import psutil

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, Table, at_most
from bench.stack.processes import Parts, running
from core.adapters.wiring import job_store
from core.settings import ApiSettings
from tests.faults.campaign.largest_requests import Form, Service, forms
from tests.faults.campaign.largest_sweeps import fill

_MOST_CPU_S, _MOST_MIB, _LONGEST_WAIT_MS = 1.0, 64.0, 100.0
_TIMEOUT_S = 300.0
_IDLE_S = 5.0
_STORES = ("postgres", "valkey", "weed")

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Send each form of each route to an embedded stack with one API process and one worker."""
    machine = this_machine()
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running(Path(folder, "stack"), workers=1) as parts,
        httpx.Client(base_url=parts.url, timeout=_TIMEOUT_S, trust_env=False) as http,
        _watched(parts.url, Path(folder, "waits")) as waits,
    ):
        store = job_store(ApiSettings.model_validate(_settings(parts)))
        service = Service(
            http, Path(folder), 0.01 if options.quick else 1.0, lambda sweep_id: fill(sweep_id, store)
        )
        document = http.get("/openapi.json").json()
        waits.request_cpu_s = _idle_cpu_s(parts, waits)
        rows = [_measured(form, http, parts, waits) for form in forms(service, document, options.only)]
        store.close()
    return Result(
        name="largest",
        title="The largest requests",
        command="./run bench largest",
        quick=options.quick,
        machine=machine,
        figures=_figures(rows),
        rows=rows,
        table=_table(rows),
        notes=[_note(rows)],
    )


def _settings(parts: Parts) -> dict[str, str]:
    prefix = "GAITWAY_"
    return {
        name.removeprefix(prefix).lower(): value
        for name, value in parts.environment.items()
        if name.startswith(prefix)
    }


def _idle_cpu_s(parts: Parts, waits: "Waits") -> float:
    """What the API takes for a request for `/healthz`, with nothing else to do."""
    before, began = _cpu_s(parts, "api"), time.monotonic()
    time.sleep(_IDLE_S)
    used, ended = _cpu_s(parts, "api") - before, time.monotonic()
    return used / max(1, waits.between(began, ended)[1])


def _measured(form: Form, http: httpx.Client, parts: Parts, waits: "Waits") -> Row:
    api = next(parts.family("api")).pid
    _reset_peak(api)
    before_mib, cpu_s, stores_s = _memory_mib(api, "VmRSS"), _cpu_s(parts, "api"), _stores_s(parts)
    began, size, failed = time.monotonic(), 0, ""
    try:
        size = form.send(http)
    except (AssertionError, httpx.HTTPError) as error:
        failed = str(error)[:300]
    ended = time.monotonic()
    longest_s, number = waits.between(began, ended)
    row = {
        "route": form.route,
        "form": form.what,
        "cpu_s": round(max(0.0, _cpu_s(parts, "api") - cpu_s - number * waits.request_cpu_s), 3),
        "mib": round(max(0.0, _memory_mib(api, "VmHWM") - before_mib), 1),
        "wait_ms": round(1000 * longest_s, 1),
        "s": round(ended - began, 3),
        "stores_cpu_s": round(_stores_s(parts) - stores_s, 3),
        "answer_bytes": size,
    }
    row |= {"failed": failed} if failed else {}
    print(*row.values(), sep="\t", flush=True)
    return row


def _cpu_s(parts: Parts, name: str) -> float:
    """Processor seconds of a part until now, with the processes that it has started."""
    used = 0.0
    for process in parts.family(name):
        with suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            used += times.user + times.system + times.children_user + times.children_system
    return used


def _stores_s(parts: Parts) -> float:
    return sum(_cpu_s(parts, name) for name in _STORES if name in parts.processes)


def _memory_mib(pid: int, name: str) -> float:
    """name: `VmRSS` now, or `VmHWM`, the most since `_reset_peak`."""
    [line] = [one for one in Path(f"/proc/{pid}/status").read_text().splitlines() if one.startswith(name)]
    return int(line.split()[1]) / 1024


def _reset_peak(pid: int) -> None:
    Path(f"/proc/{pid}/clear_refs").write_text("5")


class Waits:
    """What `bench.service.healthz_waits` writes down."""

    def __init__(self, path: Path) -> None:
        self._file = path.open()
        # The API's processor time for one request to /healthz: it is taken off what is measured.
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
        watcher = subprocess.Popen([sys.executable, "-m", "bench.service.healthz_waits", url], stdout=output)
    try:
        yield Waits(path)
    finally:
        watcher.kill()
        watcher.wait()


def _figures(rows: Sequence[Row]) -> list[Figure]:
    def worst(key: str, name: str, unit: str, most: float) -> Figure:
        value = float(max(row[key] for row in rows))
        return Figure(name=f"{name}, worst", value=value, unit=unit, target=at_most(most))

    return [
        Figure(name="routes", value=float(len({row["route"] for row in rows})), unit=""),
        Figure(name="forms", value=float(len(rows)), unit=""),
        Figure(
            name="forms beyond a bound", value=float(sum(map(_is_beyond, rows))), unit="", target=at_most(0)
        ),
        worst("cpu_s", "processor time", "s", _MOST_CPU_S),
        worst("mib", "memory grown", "MiB", _MOST_MIB),
        worst("wait_ms", "`/healthz` meanwhile", "ms", _LONGEST_WAIT_MS),
    ]


def _is_beyond(row: Row) -> bool:
    return (
        "failed" in row
        or row["cpu_s"] > _MOST_CPU_S
        or row["mib"] > _MOST_MIB
        or row["wait_ms"] > _LONGEST_WAIT_MS
    )


def _table(rows: Sequence[Row]) -> Table:
    """The worst form of each route, by processor time."""
    worst: dict[str, Row] = {}
    for row in sorted(rows, key=lambda row: (_is_beyond(row), row["cpu_s"]), reverse=True):
        worst.setdefault(row["route"], row)
    return Table(
        headings=["request", "its largest form", "processor s", "MiB", "`/healthz` ms"],
        rows=[
            [
                f"`{row['route']}`",
                row["form"],
                f"{row['cpu_s']:.2f}",
                f"{row['mib']:.0f}",
                f"{row['wait_ms']:.0f}",
            ]
            for row in worst.values()
        ],
    )


def _note(rows: Sequence[Row]) -> str:
    return (
        f"Each of {len(rows)} forms is sent once, over loopback. Processor time and memory are those of the "
        "API process; a second process asks for `/healthz` a hundred times a second meanwhile, and its "
        "longest wait is shown. "
        "The table has the worst form of each route."
    )
