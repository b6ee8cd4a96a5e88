"""Starts the render process, which turns a trajectory into a video."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from pydantic import ValidationError

from core.rendering.gl import DRIVER_CRASHES, Backend, RenderingFailed, backends, last_line, no_gl
from core.rendering.request import RenderFailure, RenderRequest, RenderResult
from worker.host.child import collect, launch

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
    with tempfile.TemporaryDirectory(prefix=".render-", dir=request.video.parent) as folder:
        document = Path(folder, "request.json")
        document.write_text(request.model_dump_json())
        with launch(
            [sys.executable, "-m", _ENTRY, str(document)],
            {**os.environ, **backend.environ},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            in_own_session=False,  # A signal that ends a training ends its video.
        ) as child:
            try:
                output, errors = collect(child, timeout_s)
            except subprocess.TimeoutExpired:
                _remove_parts(request)
                message = f"The video was not ready within {timeout_s:.0f} s."
                return RenderFailure(reason="timeout", message=message)
    if child.returncode != 0:
        _remove_parts(request)
    return _understood(child.returncode, output, errors)


def _understood(status: int, output: str, errors: str) -> RenderResult | RenderFailure:
    try:
        return (RenderResult if status == 0 else RenderFailure).model_validate_json(last_line(output))
    except ValidationError:
        how = f"signal {-status}" if status < 0 else f"exit status {status}"
        message = f"The render process ended with {how}: {last_line(errors) or 'it said nothing'}"
        # A broken GL driver crashes its process; another back-end may work.
        reason = "no_gl" if -status in DRIVER_CRASHES else "crashed"
        return RenderFailure(reason=reason, message=message)


def _remove_parts(request: RenderRequest) -> None:
    for target in (request.video, request.poster):
        for part in target.parent.glob(f".{target.name}.*.part"):
            part.unlink(missing_ok=True)
