"""Starts the process that draws stills; imports nothing numerical itself."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

import structlog
from pydantic import ValidationError

from core.clips.record import ARCHIVE
from core.errors import ObjectDamaged
from core.jobs.job import utc_now
from core.previews import library
from core.previews.record import PreviewRequest
from core.rendering.gl import DRIVER_CRASHES, RenderingFailed, backends, no_gl
from core.rendering.request import RenderFailure
from core.settings import Confinement
from core.storage import keys
from core.storage.objects import ObjectStore, read_whole, save_whole
from core.variables import variable
from worker.host.child import environment, kill, launch, tail
from worker.host.disk import read_plain

# Playground's environments compile a reset on MJX, which takes a busy machine a minute.
_TIMEOUT_S = 180.0
_MAX_PICTURE, _MAX_FAILURE = 64 * 2**20, 2**16  # bytes
log = structlog.get_logger()


def draw(
    request: PreviewRequest,
    objects: ObjectStore,
    folder: Path,
    data_dir: Path,
    timeout_s: float = _TIMEOUT_S,
    models: Confinement = "confined",
) -> None:
    """Draw the stills, unless they are stored already, and store them, or the reason why there are none.

    folder: an empty one, absolute, for temporary files. models: whether the process confines itself
    (worker/confinement/own_files.py). Raises ObjectNotFound if the model has been deleted meanwhile.
    """
    if library.find(request, objects) is not None:
        return
    if request.model:
        try:
            sha256 = request.model.removeprefix("sha256:")
            (folder / "model").write_bytes(read_whole(keys.model_source(request.model), sha256, objects))
        except ObjectDamaged as error:
            message = f"The stored model is damaged: {error.why}. Delete it, and send it again."
            failure = RenderFailure(reason="bad_request", message=message)
            library.keep_failure(request, failure, objects, utc_now())
            return
    for number, (file_id, sha256) in enumerate(request.clips.items()):
        try:
            save_whole(keys.made_of_clips(file_id, ARCHIVE), sha256, objects, folder / f"clips-{number}.npz")
        except ObjectDamaged as error:
            message = f"The stored clips are damaged: {error.why}. Delete them, and send them again."
            failure = RenderFailure(reason="bad_request", message=message)
            library.keep_failure(request, failure, objects, utc_now())
            return
    (folder / "request.json").write_text(request.model_dump_json())
    failure = _drawn(folder, data_dir, timeout_s, models)
    if failure is not None:
        log.warning("preview_failed", preview=request.id, reason=failure.reason, detail=failure.message)
        library.keep_failure(request, failure, objects, utc_now())
        return
    try:
        # The process may have been taken over: no link that it left is followed.
        pictures = [read_plain(folder / f"{n}.png", _MAX_PICTURE) for n in range(len(request.cameras))]
    except OSError as error:
        log.warning("preview_not_kept", preview=request.id, error=str(error))
        left = RenderFailure(reason="crashed", message="Drawing left something else than its pictures.")
        library.keep_failure(request, left, objects, utc_now())
        return
    library.keep(request, pictures, objects, utc_now())
    log.info("preview_drawn", preview=request.id, environment=request.environment, stills=len(pictures))


def _drawn(folder: Path, data_dir: Path, timeout_s: float, models: Confinement) -> RenderFailure | None:
    """None once the pictures are there; back-ends are tried in turn."""
    reasons: dict[str, str] = {}
    for backend in backends(os.environ):
        failure = _attempt({**backend.environ, variable("models"): models}, folder, data_dir, timeout_s)
        if failure is None or failure.reason != "no_gl":
            return failure
        reasons[backend.name] = failure.message
    nothing: RenderingFailed = no_gl(reasons)
    return RenderFailure(reason="no_gl", message=nothing.detail)


def _attempt(
    variables: Mapping[str, str], folder: Path, data_dir: Path, timeout_s: float
) -> RenderFailure | None:
    # Not in the folder: a back-end before may have left a link there.
    with tempfile.TemporaryFile() as text:
        child = launch(
            [sys.executable, "-m", "worker.preview", str(folder)],
            {**environment("cpu", data_dir, os.environ), **variables},
            stdout=text,
            cwd=folder,
        )
        try:
            status = child.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return RenderFailure(reason="timeout", message=f"It was not drawn within {timeout_s:g} s.")
        finally:
            kill(child)
        return None if status == 0 else _why(status, folder, text)


def _why(status: int, folder: Path, text: IO[bytes]) -> RenderFailure:
    with suppress(OSError, ValidationError):
        return RenderFailure.model_validate_json(read_plain(folder / "failure.json", _MAX_FAILURE))
    log.warning("preview_crashed", status=status, text=tail(text, 1000))
    # A broken GL driver crashes its process; another back-end may work.
    if -status in DRIVER_CRASHES:
        return RenderFailure(reason="no_gl", message=f"the driver crashed ({signal.Signals(-status).name})")
    how = f"signal {-status}" if status < 0 else f"exit status {status}"
    return RenderFailure(
        reason="crashed", message=f"Drawing ended with {how}; the worker's log has its last output."
    )
