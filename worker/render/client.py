"""Starts the render process, for whoever has a trajectory and wants to see it."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from pydantic import ValidationError

from core.rendering.gl import DRIVER_CRASHES, Backend, RenderingFailed, backends, last_line, no_gl
from core.rendering.request import RenderFailure, RenderRequest, RenderResult

_ENTRY = "worker.render.process"


def render(request: RenderRequest, *, timeout_s: float) -> RenderResult:
    """The video and its poster, made in a process of its own; back-ends are tried in turn.

    The process dies with the calling thread. Raises RenderingFailed, with a reason; no file is then
    left under the video's name.
    """
    reasons: dict[str, str] = {}
    for backend in backends(os.environ):
        answer = _attempt(request, backend, timeout_s)
        if isinstance(answer, RenderResult):
            return answer
        if answer.reason != "no_gl":
            raise RenderingFailed(answer.reason, answer.message)
        reasons[backend.name] = answer.message
    raise no_gl(reasons)


def _attempt(request: RenderRequest, backend: Backend, timeout_s: float) -> RenderResult | RenderFailure:
    surroundings = {**os.environ, **backend.environ, "GAITWAY_PARENT_PID": str(os.getpid())}
    with tempfile.TemporaryDirectory(prefix=".render-", dir=request.video.parent) as folder:
        document = Path(folder, "request.json")
        document.write_text(request.model_dump_json())
        try:
            done = subprocess.run(
                [sys.executable, "-m", _ENTRY, str(document)],
                env=surroundings,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                check=False,
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired:
            _remove_parts(request)
            return RenderFailure(
                reason="timeout", message=f"The video was not ready within {timeout_s:.0f} s."
            )
    if done.returncode != 0:
        _remove_parts(request)
    return _understood(done)


def _understood(done: subprocess.CompletedProcess[str]) -> RenderResult | RenderFailure:
    line = last_line(done.stdout)
    try:
        return (RenderResult if done.returncode == 0 else RenderFailure).model_validate_json(line)
    except ValidationError:
        how = f"signal {-done.returncode}" if done.returncode < 0 else f"exit status {done.returncode}"
        message = f"The render process ended with {how}: {last_line(done.stderr) or 'it said nothing'}"
        # A broken GL driver takes its process along; another back-end may work.
        reason = "no_gl" if -done.returncode in DRIVER_CRASHES else "crashed"
        return RenderFailure(reason=reason, message=message)


def _remove_parts(request: RenderRequest) -> None:
    for target in (request.video, request.poster):
        for part in target.parent.glob(f".{target.name}.*.part"):
            part.unlink(missing_ok=True)
