"""Writes what an attempt at a training job keeps for other tools: the supervisor's side."""

import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, cast

import structlog

from core.errors import GaitwayError, LeaseLost
from core.installation import to_install
from core.jobs.attempts import Claim
from core.jobs.job import Artifact, Job
from core.jobs.spec import TrainSpec
from core.jobs.status import JobStatus
from core.settings import WorkerSettings
from worker.protocol import FileReady, Message, Noted
from worker.supervision.outbox import Outbox
from worker.supervision.spool import private
from worker.tracking.child import end, start
from worker.tracking.config import about_run, as_resolved
from worker.tracking.items import About, PolicyItem, VideoItem, WriteUp
from worker.tracking.live import Live

log = structlog.get_logger()

_FOLDER = "tracking"
EVENTS, ARCHIVE, CURVE = "events.out.tfevents", "wandb.tar", "episodes.png"
# How long a job's end waits for its files to be written, and to be stored, before it does without.
_WRITE_S, _STORE_S = 60.0, 60.0
_POLL_S = 0.05
_NO_PACKAGE = f"This worker has no package wandb ({to_install('wandb')}): the run is not tracked there."
_NO_KEY = "This worker has no GAITWAY_WANDB_API_KEY: the run is not sent, and kept for `wandb sync`."


@dataclass
class Tracking:
    """Nothing in here ends a job, except a lost lease.

    Call `send` with each message, `finish` when the training process has ended, `write_up` when all its
    messages are stored; or `abandon`, if the attempt must end at once.
    """

    job: Job
    claim: Claim
    spool: Path
    settings: WorkerSettings
    outbox: Outbox
    _about: About | None = field(default=None, init=False)
    _live: Live | None = field(default=None, init=False)

    def begin(self) -> None:
        """Call it from a thread that lives as long as the attempt."""
        if not isinstance(self.job.spec, TrainSpec):
            return
        self._folder.mkdir()
        wanted = self.job.spec.tracking.wandb
        if wanted is None:
            return
        if find_spec("wandb") is None:
            self._note(_NO_PACKAGE)
            return
        self._about = about_run(self.job.id, self.job.spec, self._folder)
        if self._about is None or wanted.mode == "offline":
            return
        if self.settings.wandb_api_key is None:
            self._note(_NO_KEY)
            return
        try:
            self._live = Live(self._about, self.spool, self.settings, self._note)
        except OSError as error:
            self._note(f"Nothing is sent to Weights & Biases: {error.strerror}")

    @property
    def _folder(self) -> Path:
        """Out of the training process's reach: a process that holds an account's key works in it."""
        return private(self.spool) / _FOLDER

    def send(self, message: Message) -> None:
        if self._live is not None:
            self._live.send(message)

    def finish(self, status: JobStatus | None) -> None:
        """Send the rest, within a time limit. status: the job's, if it ends with this attempt."""
        if self._live is not None and self._live.finish(_exit_code(status)):
            self._about = None  # The server has everything: no file is needed.

    def abandon(self) -> None:
        """End its process."""
        if self._live is not None:
            self._live.kill()

    def write_up(self, rows: Path, status: JobStatus | None, called_off: Callable[[], bool]) -> None:
        """Store the whole job, over all of its attempts, as files for TensorBoard and for `wandb sync`.

        rows: the file of its metrics, as `store_metrics` writes it.
        """
        if not isinstance(self.job.spec, TrainSpec):
            return
        try:
            self._write_up(self.job.spec, rows, _exit_code(status), called_off)
        except LeaseLost:
            raise
        except (GaitwayError, OSError) as error:
            log.warning("tracking_not_kept", error=str(error))

    def _write_up(self, spec: TrainSpec, rows: Path, exit_code: int, called_off: Callable[[], bool]) -> None:
        folder = self._folder
        if called_off():
            return
        task = WriteUp(
            job_id=self.job.id,
            measurements=rows,
            events=folder / EVENTS,
            curve=folder / CURVE,
        )
        if self._about is not None:
            task = self._with_archive(task, self._about, exit_code)
        (folder / "task.json").write_text(task.model_dump_json())
        child = start(["write", str(folder / "task.json")], folder, self.settings, with_key=False)
        with cast("IO[bytes]", child.stdout) as words:
            try:
                said = _last_words(child, words, called_off)
            finally:
                end(child)
        self._keep(said, spec.checkpoints.keep, called_off)

    def _with_archive(self, task: WriteUp, about: About, exit_code: int) -> WriteUp:
        job = self.claim.store.get(self.job.id)
        last = job.attempts[-1]
        config = {**about.config, **as_resolved(last.device, last.engine, last.details)}
        kept = about.folder / "kept"
        kept.mkdir()
        videos = sorted(
            (artifact for artifact in job.artifacts if artifact.role == "video"),
            key=lambda artifact: artifact.step or 0,
        )
        policies = [artifact for artifact in job.artifacts if artifact.role == "policy"]
        return task.model_copy(
            update={
                "about": about.model_copy(update={"config": config}),
                "archive": about.folder / ARCHIVE,
                "films": [VideoItem(**self._fetch(it, kept)) for it in videos],
                "policies": [PolicyItem(**self._fetch(it, kept)) for it in policies],
                "exit_code": exit_code,
            }
        )

    def _fetch(self, artifact: Artifact, folder: Path) -> dict[str, Any]:
        """Bring a stored file into the folder; returns its path there, its step, and its seed of several."""
        path = folder / artifact.name
        with self.claim.objects.open(artifact.key) as pieces, path.open("wb") as file:
            file.writelines(pieces)
        seed = artifact.metadata.get("seed")
        return {"path": path, "step": artifact.step or 0, "seed": seed if seed in self.job.seeds else None}

    def _keep(self, notes: list[str], keep_checkpoints: int, called_off: Callable[[], bool]) -> None:
        """Store what was written, through a short outage if need be."""
        later = Outbox(self.claim, self._folder, keep_checkpoints)
        for note in notes:
            later.put(Noted(text=note))
        for file in (
            FileReady(
                name=EVENTS,
                path=EVENTS,
                role="tensorboard",
                media_type="application/octet-stream",
            ),
            FileReady(name=CURVE, path=CURVE, role="picture", media_type="image/png"),
            FileReady(name=ARCHIVE, path=ARCHIVE, role="wandb", media_type="application/x-tar"),
        ):
            if (self._folder / file.path).exists():
                later.put(file)
        if not later.close(_STORE_S, called_off):
            log.warning("tracking_not_kept", error=f"not stored within {_STORE_S:g} s, or before a drain")

    def _note(self, text: str) -> None:
        self.outbox.put(Noted(text=text))


def _last_words(
    child: subprocess.Popen[bytes], words: IO[bytes], called_off: Callable[[], bool]
) -> list[str]:
    """Its notes, once it has ended or taken too long; they are few enough to wait in their pipe."""
    deadline = time.monotonic() + _WRITE_S
    while child.poll() is None:
        if time.monotonic() > deadline or called_off():
            return [f"Files for TensorBoard and Weights & Biases were not ready within {_WRITE_S:g} s."]
        time.sleep(_POLL_S)
    return [word["note"] for word in map(json.loads, words) if "note" in word]


def _exit_code(status: JobStatus | None) -> int:
    return 0 if status is JobStatus.SUCCEEDED else 1
