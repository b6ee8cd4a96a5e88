"""Starts the confined process that examines a file of a user, and keeps what it says of a model."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, get_args

import structlog

from core.errors import ObjectDamaged, ObjectNotFound
from core.jobs.job import utc_now
from core.physics.availability import EngineName
from core.storage import keys
from core.storage.objects import ObjectStore
from core.uploads import library
from core.uploads.record import KindName
from core.user_models.record import MODELS, ModelStore
from worker.confinement.confinement import Limits
from worker.host.child import environment, kill, launch, tail
from worker.validation.answer import ModelAnswer, read_answer

ANSWER = "answer.json"
_PASSED_VARIABLES = (
    "PATH",
    "LANG",
    "LC_ALL",
    "LC_CTYPE",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "GAITWAY_STACK_ID",
)
_PROGRAM = ("-m", "worker.validation")
_POLL_S = 0.05
# How long engines may be tried once jobs can use the model, and when that begins to give way to such jobs.
_TRIALS_S, _GIVES_WAY_AFTER_S, _ASKS_EVERY_S = 60.0, 15.0, 2.0
log = structlog.get_logger()

_INTERRUPTED = "A worker was stopped while it refused the model; send it again to learn why."
_OUT_OF_TIME = f"not tried here: the trials took more than {_TRIALS_S:g} s"
_GAVE_WAY = "not tried here: a job waited for the worker"


def validate(  # noqa: PLR0913 # Which model, and the places that are needed.
    model_id: str,
    store: ModelStore,
    objects: ObjectStore,
    folder: Path,
    data_dir: Path,
    *,
    strictly: bool = True,
    is_wanted: Callable[[], bool] = lambda: False,
) -> None:
    """Examine a model that awaits validation, and store the findings; of a refused model, only the refusal.

    folder: an empty one, for temporary files. strictly: refuse the model if the kernel cannot confine the
    process. is_wanted: whether a job waits for this worker; trials of engines then end early. Raises
    ModelNotFound.
    """
    record = library.find(model_id, store)
    if record.status != "validating":
        return
    try:
        body = library.source(record, MODELS, objects)
    except ObjectDamaged as error:
        answers = iter([ModelAnswer(refusal=f"The stored model is damaged: {error.why}. Send it again.")])
    except ObjectNotFound:  # It was interrupted before its last step, or somebody is deleting the model.
        answers = iter([ModelAnswer(refusal=_INTERRUPTED)])
    else:
        answers = look(body, folder, data_dir, Limits(), strictly=strictly, is_wanted=is_wanted)
    # Jobs can use it once it is described; loading all the engines takes longer than everything before.
    for answer in answers:
        if answer.description is not None:
            found = record.model_copy(update={"status": "ready", "description": answer.description})
        else:
            told = {"status": "refused", "message": answer.refusal, "refused_at": utc_now()}
            found = record.model_copy(update=told)
        if found.status == "refused":  # First: once it is refused, it may be sent again.
            objects.delete_prefix(keys.model_source(model_id))
        store.settle(found)  # Raises if somebody has deleted it meanwhile.
        log.info(
            "model_validated",
            model=model_id,
            status=found.status,
            detail=found.message,
            confined_by=" ".join(answer.layers),
        )


def look(
    body: bytes,
    folder: Path,
    data_dir: Path,
    limits: Limits,
    *,
    strictly: bool = True,
    is_wanted: Callable[[], bool] = lambda: False,
) -> Iterator[ModelAnswer]:
    """The first and the last answer of a confined process about the file; the reason if it gives none."""
    (folder / "model").write_bytes(body)
    said = folder / ANSWER
    with (folder / "log").open("w+b") as text:
        child = _started("model", folder, data_dir, limits, text, strictly=strictly)
        try:
            until, heard, why = time.monotonic() + limits.wall_s, False, _OUT_OF_TIME
            asks_at = float("inf")
            while (status := _ended(child)) is None and (now := time.monotonic()) < until:
                if not heard and said.exists():
                    first = read_answer(said, ModelAnswer)
                    heard = True
                    until, asks_at = min(until, now + _TRIALS_S), now + _GIVES_WAY_AFTER_S
                    if first.description is not None:
                        yield first
                if now > asks_at:
                    asks_at = now + _ASKS_EVERY_S
                    if is_wanted():
                        why = _GAVE_WAY
                        break
        finally:
            kill(child)
        yield _answer(folder, status, limits, text, why)


def run_to_its_end(
    what: KindName,
    folder: Path,
    data_dir: Path,
    limits: Limits,
    *,
    strictly: bool = True,
    look_up: Callable[[], object] = lambda: None,
) -> int | None:
    """Have the confined process examine the file in the folder; its exit status, None if it took too long.

    look_up: is called every two seconds; what it raises ends the process.
    """
    with (folder / "log").open("w+b") as text:
        child = _started(what, folder, data_dir, limits, text, strictly=strictly)
        try:
            until, status = time.monotonic() + limits.wall_s, None
            while status is None and (left := until - time.monotonic()) > 0:
                with suppress(subprocess.TimeoutExpired):
                    status = child.wait(min(left, _ASKS_EVERY_S))
                look_up()
        finally:
            kill(child)
        if status != 0:
            log.warning("file_not_understood", kind=what, status=status, text=tail(text, 1000))
    return status


def _started(
    what: KindName, folder: Path, data_dir: Path, limits: Limits, text: IO[bytes], *, strictly: bool
) -> "subprocess.Popen[bytes]":
    how = "confined" if strictly else "unconfined"
    return launch(
        [sys.executable, *_PROGRAM, what, str(folder), how, *limits.arguments()],
        _environment(folder, data_dir),
        stdout=text,
        cwd=folder,
    )


def _environment(folder: Path, data_dir: Path) -> dict[str, str]:
    """Only what these libraries need."""
    surroundings = environment(
        "cpu", data_dir, {name: os.environ[name] for name in _PASSED_VARIABLES if name in os.environ}
    )
    return {
        **surroundings,
        **dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME"), str(folder)),
        # One thread each: linear algebra libraries reserve memory for one per core.
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MALLOC_ARENA_MAX": "2",
    }


def _ended(child: "subprocess.Popen[bytes]") -> int | None:
    """Its exit status; None if it still runs after a short wait."""
    try:
        return child.wait(_POLL_S)
    except subprocess.TimeoutExpired:
        return None


def _answer(folder: Path, status: int | None, limits: Limits, text: IO[bytes], why: str) -> ModelAnswer:
    """why: engines were not tried, if it had to be stopped."""
    answer = read_answer(folder / ANSWER, ModelAnswer)
    if answer.refusal is not None or (answer.description is not None and status == 0):
        return answer
    if (said := answer.description) is not None:  # It compiles and moves: only the engines were too much.
        left = [name for name in get_args(EngineName) if said.engines.get(name) is None]
        trials = {**dict.fromkeys(left, why), **said.trials}
        described = said.model_copy(update={"trials": trials, "complete": True})
        return answer.model_copy(update={"description": described})
    log.warning("model_not_understood", status=status, text=tail(text, 1000))
    return ModelAnswer(refusal=why_without_answer("MuJoCo", "model", status, limits))


def why_without_answer(reader: str, what: str, status: int | None, limits: Limits) -> str:
    """The refusal of a file whose process said nothing of it, by its exit status; None: it took too long."""
    if status is None:
        return f"{reader} was not done with the {what} within {limits.wall_s:g} s; make it smaller."
    if status in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"{reader} was not done with the {what} in the time that it may take; make it smaller."
    if status < 0:
        return f"{reader} crashed on the {what} ({signal.Signals(-status).name})."
    return f"The {what} could not be read: its content is not as its format asks."
