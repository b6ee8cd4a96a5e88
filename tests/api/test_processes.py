"""Several processes behind one socket: they share the work, are replaced when they die, and end together."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
import pytest

from core.adapters.wiring import job_store
from core.jobs.store import JobQuery
from core.settings import StoreSettings, WorkerSettings
from gaitway.service.embedded.processes import are_free

pytestmark = pytest.mark.extra

NUMBER = 2


@dataclass
class Service:
    """The API as users start it, in `NUMBER` processes."""

    process: subprocess.Popen[str]
    port: int
    http: httpx.Client

    def serving(self) -> dict[int, psutil.Process]:
        """Those that listen, by their ids; the one that watches them, and Python's own, do not accept."""
        found: dict[int, psutil.Process] = {}
        for child in psutil.Process(self.process.pid).children():
            with suppress(psutil.Error):
                if any(part.startswith("from multiprocessing.spawn") for part in child.cmdline()):
                    found[child.pid] = child
        return found


def until(is_so: Callable[[], bool], seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def service(settings: WorkerSettings) -> Iterator[Service]:
    said = settings.model_dump(include=set(StoreSettings.model_fields), exclude_none=True)
    secret = {"database_url", "redis_url", "s3_secret_key"}
    said |= {name: getattr(settings, name).get_secret_value() for name in secret}
    environment = {f"GAITWAY_{name.upper()}": str(value) for name, value in said.items()}
    with subprocess.Popen(
        [sys.executable, "-m", "api", "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, **environment, "GAITWAY_API_PROCESSES": str(NUMBER)},
        start_new_session=True,
    ) as process:
        try:
            assert process.stdout is not None
            port = next(line["port"] for line in map(json.loads, process.stdout) if "port" in line)
            url = f"http://127.0.0.1:{port}"
            with httpx.Client(base_url=url, timeout=30, verify=False) as http:  # noqa: S501
                service = Service(process, port, http)
                assert http.get("/readyz").status_code == 200
                until(lambda: len(service.serving()) == NUMBER)
                yield service
        finally:
            os.killpg(process.pid, signal.SIGKILL)


def test_one_that_dies_is_replaced_and_all_end_together(service: Service, settings: WorkerSettings) -> None:
    kept: list[str] = []
    victim = next(iter(service.serving().values()))
    victim.kill()

    def submit() -> bool:
        with suppress(httpx.TransportError):  # The one that was killed may have held the connection.
            answer = service.http.post("/jobs", json={"kind": "train", "environment": "ant"})
            assert answer.status_code == 202
            kept.append(answer.json()["id"])
        present = service.serving()
        return len(present) == NUMBER and victim.pid not in present

    until(submit)
    children = service.serving().values()
    with service.http.stream("GET", f"/jobs/{kept[0]}/events") as stream:
        assert stream.status_code == 200
        service.process.terminate()
        stream.read()  # It ends whole: the connection is not broken.
    # uvicorn first waits for the new one to start.
    assert service.process.wait(60) == 0
    assert not any(child.is_running() for child in children)
    assert are_free([service.port])
    store = job_store(settings)
    assert set(kept) <= {job.id for job in store.list(JobQuery(), limit=200).jobs}
    store.close()


def test_they_end_with_the_process_that_watches_them(service: Service) -> None:
    children = service.serving().values()
    service.process.kill()
    _, left = psutil.wait_procs(list(children), timeout=10)
    assert left == []
    assert are_free([service.port])


def test_whichever_process_answers_tells_what_all_have_counted(service: Service) -> None:
    wanted, number = 'gaitway_http_requests_total{method="GET",route="/healthz",status="200"}', 40
    for _ in range(number):
        httpx.get(f"{service.http.base_url}/healthz", verify=False)  # noqa: S501 # Each on a connection of its own.
    told = set[float]()
    for _ in range(12):
        lines = httpx.get(f"{service.http.base_url}/metrics", verify=False).text.splitlines()  # noqa: S501
        (line,) = (line for line in lines if line.startswith(wanted))
        told.add(float(line.rpartition(" ")[2]))
        assert any(line.startswith("gaitway_record_up 1") for line in lines)
        assert any(line.startswith('gaitway_store_seconds_count{store="postgresql"}') for line in lines)
    assert told == {float(number)}
