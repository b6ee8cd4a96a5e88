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
    """The child failed, or did not end in time. reason: in one line."""

    def __init__(self, reason: str, output: str = "") -> None:
        self.reason = reason
        super().__init__(f"{reason}\n{output[-3000:]}")


def run_child(
    module: str, request: Mapping[str, Any], *, timeout_s: float, environment: Mapping[str, str] = os.environ
) -> dict[str, Any]:
    """The answer of `python -m module FOLDER` to the request, with began_at, the time of its start.

    The process sees no GPU unless the request's `device` is one. It keeps Python's bytecode, as installed
    packages have it: each process would compile again all that it imports, for seconds. Raises ChildFailed.
    """
    platforms = {} if request.get("device") == "gpu" else {"JAX_PLATFORMS": "cpu"}
    environment = {name: value for name, value in environment.items() if name != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        answer = Path(folder, _ANSWER)
        Path(folder, _REQUEST).write_text(json.dumps(request))
        began_at = time.time()
        try:
            done = subprocess.run(
                [sys.executable, "-m", module, folder],
                env={**environment, **platforms},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                check=False,
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired:
            raise ChildFailed(f"{module} did not end within {timeout_s:.0f} s") from None
        if done.returncode or not answer.exists():
            raise ChildFailed(f"{module} {_end(done.returncode)}", done.stdout)
        return {**json.loads(answer.read_bytes()), "began_at": began_at}


def answer(work: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """The child's side: answer FOLDER/request.json in FOLDER/answer.json."""
    folder = Path(sys.argv[1])
    answered = work(json.loads((folder / _REQUEST).read_bytes()))
    (folder / _ANSWER).write_text(json.dumps(answered))


def _end(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with {status}"
