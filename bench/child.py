"""Measurements in a process of their own: none finds JAX, its caches or its threads as another left them."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def run_child(module: str, request: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
    """What `python -m module` answers to the request, and `process_s`: seconds from its start to its end.

    It sees no GPU unless the request's `device` is one.

    Raises RuntimeError with the end of what it printed where it fails or takes longer than `timeout_s`.
    """
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder:
        answer = Path(folder, "answer.json")
        command = [sys.executable, "-m", module, str(answer), json.dumps(request)]
        began = time.perf_counter()
        try:
            done = subprocess.run(
                command,
                env=dict(os.environ)
                if request.get("device") == "gpu"
                else {**os.environ, "JAX_PLATFORMS": "cpu"},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired:
            raise RuntimeError(
                f"{module} did not end within {timeout_s:.0f} s: {json.dumps(request)}"
            ) from None
        process_s = time.perf_counter() - began
        if done.returncode or not answer.exists():
            raise RuntimeError(f"{module} ended with {done.returncode}:\n{done.stdout[-3000:]}")
        return {**json.loads(answer.read_bytes()), "process_s": process_s}


def answer(work: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """The child's side: do the request on the command line, and leave the answer where the parent looks."""
    Path(sys.argv[1]).write_text(json.dumps(work(json.loads(sys.argv[2]))))
