"""Runs each measurement in its own process: none finds JAX, its caches or threads as another left them."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

_REQUEST, _ANSWER = "request.json", "answer.json"


class ChildFailed(RuntimeError):
    """reason: in one line."""

    def __init__(self, reason: str, output: str = "") -> None:
        self.reason = reason
        super().__init__(f"{reason}\n{output[-3000:]}" if output else reason)


class TookTooLong(ChildFailed):
    """The child was stopped at its time limit."""


def run_child(
    module: str,
    request: Mapping[str, Any],
    *,
    timeout_s: float,
    environment: Mapping[str, str] = os.environ,
) -> dict[str, Any]:
    """The answer of `python -m module` to the request, with began_at, the time of its start, and process_s,
    the seconds from its start to its end.

    The process sees no GPU unless the request's `device` is one.

    Raises ChildFailed with the end of its output if it fails, TookTooLong after `timeout_s`.
    """
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        answer = Path(folder, _ANSWER)
        # On the command line, a request could be too long.
        Path(folder, _REQUEST).write_text(json.dumps(request))
        command = [sys.executable, "-m", module, folder]
        began_at, began = time.time(), time.perf_counter()
        try:
            done = subprocess.run(
                command,
                env=dict(environment)
                if request.get("device") == "gpu"
                else {**environment, "JAX_PLATFORMS": "cpu"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                check=False,
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired:
            raise TookTooLong(f"{module} did not end within {timeout_s:.0f} s") from None
        process_s = time.perf_counter() - began
        if done.returncode or not answer.exists():
            raise ChildFailed(f"{_end(done.returncode)}: {_last_line(done.stdout)}", done.stdout)
        return {**json.loads(answer.read_bytes()), "began_at": began_at, "process_s": process_s}


def answer(work: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """The child's side, `python -m module FOLDER`: answer FOLDER/request.json in FOLDER/answer.json."""
    folder = Path(sys.argv[1])
    answered = work(json.loads((folder / _REQUEST).read_bytes()))
    (folder / _ANSWER).write_text(json.dumps(answered))


def _end(status: int) -> str:
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"ended with {status}"


def _last_line(output: str) -> str:
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    return lines[-1][:300] if lines else "it printed nothing"
