"""Times a user's own body from `POST /models` to its description, with a real worker."""

import statistics
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, below
from bench.measure.statistics import spread
from bench.stack.embedded import running_stack

_LONGEST_S = 120.0
_POLL_S = 0.05

Row = dict[str, Any]


def measure(options: Options) -> Result:
    """Send the humanoid's XML, each time with another comment: the same bytes would be the same model."""
    machine = this_machine()
    body = _humanoid()
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running_stack(Path(folder)) as stack,
        httpx.Client(base_url=stack.url, timeout=_LONGEST_S, trust_env=False) as http,
    ):
        rows = [
            {"round": turn, **_sent(http, body + f"\n<!-- {turn} -->\n".encode())}
            for turn in range(1 if options.quick else 7)
        ]
    rate = statistics.median(row["steps_per_s"] for row in rows)
    return Result(
        name="models",
        title="A body of one's own",
        command="./run bench models",
        quick=options.quick,
        machine=machine,
        figures=[
            Figure.of(
                "`POST /models` to its 201, humanoid",
                spread([row["described_s"] for row in rows]),
                "s",
                below(3),
            ),
            Figure.of(
                "the same, until each engine was tried", spread([row["complete_s"] for row in rows]), "s"
            ),
        ],
        rows=rows,
        notes=[
            f"The humanoid's file of the brax wheel ({len(body):,} bytes, nv {rows[0]['nv']}, nu "
            f"{rows[0]['nu']}) over loopback to an idle embedded stack with one worker: stored, queued, "
            "compiled in a confined process that is started for it, let go for 2 s of its time, described, "
            f"answered. C MuJoCo made {rate:,.0f} steps/s of it there.",
            "Each engine: loading MJX and MuJoCo Warp takes most of the time, for every model.",
        ],
    )


def _humanoid() -> bytes:
    brax = find_spec("brax")
    if brax is None or brax.origin is None:
        raise RuntimeError("The brax package is not installed; it brings the humanoid's file.")
    return (Path(brax.origin).parent / "envs" / "assets" / "humanoid.xml").read_bytes()


def _sent(http: httpx.Client, body: bytes) -> Row:
    """One model from its upload to the end of its validation; it is deleted afterwards."""
    began = time.perf_counter()
    answer = http.post("/models", content=body, headers={"Content-Type": "application/xml"})
    described_s = time.perf_counter() - began
    if answer.status_code != 201:
        raise RuntimeError(f"POST /models answered {answer.status_code}: {answer.text[:500]}")
    found = answer.json()
    while not found["description"]["complete"]:
        if time.perf_counter() - began > _LONGEST_S:
            raise RuntimeError(f"After {_LONGEST_S:g} s not all engines were tried.")
        time.sleep(_POLL_S)
        found = http.get(found["links"]["self"]).raise_for_status().json()
    complete_s = time.perf_counter() - began
    http.delete(found["links"]["self"]).raise_for_status()
    description = found["description"]
    return {
        "described_s": described_s,
        "complete_s": complete_s,
        "steps_per_s": description["physics_steps_per_second"],
        "engines": ", ".join(name for name, why in description["engines"].items() if why is None),
        "nv": description["inventory"]["sizes"]["nv"],
        "nu": description["inventory"]["sizes"]["nu"],
    }
