"""From `POST` to the first update of an ant on a new machine: with nothing prepared, and after an idle worker
has prepared it."""

import os
import tempfile
import time
from pathlib import Path

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_least
from bench.stack.embedded import running_stack
from gaitway.client import Client

_ENVIRONMENT = "ant"
_PREPARE_S = 900.0


def measure(options: Options) -> Result:
    """Measure on two fresh stacks, one after the other."""
    machine, environment = this_machine(), "inverted_pendulum" if options.quick else _ENVIRONMENT
    cold, _ = _first_update_s(environment, prepared=False)
    warm, prepared_in_s = _first_update_s(environment, prepared=True)
    return Result(
        name="preparation",
        title="What an idle worker compiles before a job comes",
        command="./run bench preparation",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure(name=f"`POST` to the first update, {environment}, nothing prepared", value=cold, unit="s"),
            Figure(name="the same, prepared", value=warm, unit="s"),
            Figure(name="ratio", value=cold / warm, unit="×", target=at_least(2)),
            Figure(name="preparing it, from the start of the stack", value=prepared_in_s, unit="s"),
        ],
        rows=[{"cold_s": cold, "prepared_s": warm}],
        notes=["Each stack has an empty data folder. A job that comes while a worker prepares ends that."],
    )


def _first_update_s(environment: str, *, prepared: bool) -> tuple[float, float]:
    """Seconds from `POST` to the first progress, and from the stack's start until it was prepared."""
    os.environ["GAITWAY_PREPARE"] = environment if prepared else ""
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        data, began = Path(folder, "data"), time.monotonic()
        with running_stack(data) as stack, Client(stack.url) as client:
            if prepared:
                _wait_until_prepared(data)
            prepared_in_s, submitted = time.monotonic() - began, time.time()
            job = client.submit({"kind": "train", "environment": environment})
            for event in client.events(job.id):
                if event.kind == "progress" and event.time is not None:
                    client.cancel(job.id)
                    return event.time.timestamp() - submitted, prepared_in_s
    raise RuntimeError(f"Job {job.id} ended without progress.")


def _wait_until_prepared(data: Path) -> None:
    deadline = time.monotonic() + _PREPARE_S
    while not list(data.glob("prepared/*")):
        if time.monotonic() > deadline:
            raise RuntimeError(f"Nothing was prepared within {_PREPARE_S:.0f} s.")
        time.sleep(0.2)
