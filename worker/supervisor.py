"""One attempt at one job: start the training process, watch it, store what it says, end it for certain."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import get_args

import structlog

from core.errors import JobFailed, LeaseLost, NotFound, Rejected, StorageUnavailable
from core.jobs.attempts import Holding
from core.jobs.checks import source_checkpoint
from core.jobs.job import Artifact, Attempt, Job, utc_now
from core.jobs.own_model import engines_that_cannot, model_of
from core.jobs.spec import CheckpointPolicy, RolloutSpec, TrainSpec
from core.jobs.status import JobStatus, Reason
from core.models import library
from core.patience import CalledOff, through_outages
from core.physics.availability import EngineName
from core.settings import WorkerSettings
from core.storage import keys
from worker.caches import Caches
from worker.disk import is_full, what_to_do
from worker.draining import Draining
from worker.heartbeat import Heartbeat
from worker.messages import Failed, Finished, PhaseEnded, Task
from worker.outbox import Outbox
from worker.outcome import Outcome, Stop, judge
from worker.process import TRAINING, TrainingProcess
from worker.slot import SlotTaken, slots
from worker.spool import SPOOLS, spool
from worker.tracking.attempt import Tracking

log = structlog.get_logger()

# How often the supervisor looks up from waiting for the process to end.
_GLANCE_S = 0.1
# The phases after which there are new programs, and new kernels.
_COMPILED = ("compile", "first_update")
# How long finished work waits for a store that is away, before the attempt is given up.
_STORAGE_PATIENCE_S = 900.0


@dataclass
class Supervisor:
    """Runs one claimed attempt.

    draining: set, also by a signal handler, once the worker has to go; the job then keeps a checkpoint
    and is given back. Leaves behind: the job ended or back in the queue, no process, no spool.
    """

    holding: Holding
    settings: WorkerSettings
    device: str
    slot_names: tuple[str, ...]
    command: Sequence[str] = TRAINING
    draining: Draining = field(default_factory=Draining)

    def run(self) -> None:
        folder = self.settings.data_dir.absolute()  # The training process stands elsewhere.
        own = folder / SPOOLS / f"{self.holding.job_id}.{self.holding.number}"
        caches = Caches(self.holding.objects, self.settings, self.device, own)
        try:
            with spool(own), Heartbeat(self.holding, self.settings) as heartbeat:
                self._attempt(heartbeat, caches, folder, own)
        except LeaseLost:
            log.warning("attempt_abandoned", job_id=self.holding.job_id, attempt=self.holding.number)
        except CalledOff:
            message = "The worker was shut down before it had begun with the job."
            self._conclude(Outcome(None, Reason.WORKER_DRAINED, message))
        except SlotTaken as error:
            self._conclude(Outcome(None, Reason.WORKER_LOST, str(error)))
        except JobFailed as error:
            self._conclude(Outcome(JobStatus.FAILED, Reason(error.reason), error.detail))
        except (NotFound, Rejected) as error:
            self._conclude(Outcome(JobStatus.FAILED, Reason.BAD_CHECKPOINT, error.detail))
        except StorageUnavailable as error:
            self._conclude(Outcome(None, Reason.STORAGE_UNAVAILABLE, error.detail))
        except OSError as error:
            if not is_full(error):
                raise
            self._conclude(Outcome(None, Reason.STORAGE_UNAVAILABLE, what_to_do(folder)))
        caches.close(self.draining.is_set)  # The job has ended: nobody waits for this.

    def _attempt(self, heartbeat: Heartbeat, caches: Caches, folder: Path, spool: Path) -> None:
        leaving = self.draining.is_set
        job = through_outages(
            partial(self.holding.store.get, self.holding.job_id), _STORAGE_PATIENCE_S, called_off=leaving
        )
        through_outages(
            partial(write_task, job, self.holding, self.device, spool),
            _STORAGE_PATIENCE_S,
            called_off=leaving,
        )
        locks = [folder / "locks" / f"{name}.lock" for name in self.slot_names]
        with slots(locks, self.settings.grace.total_seconds(), leaving) as slot_fds:
            caches.open(_cached_as(job), leaving)
            outbox = Outbox(self.holding, spool, _checkpoints_kept(job))
            tracking = Tracking(job, self.holding, spool, self.settings, outbox)
            tracking.begin()
            process = TrainingProcess(self.command, spool, folder, self.device, slot_fds)
            try:
                ear = _Ear(process, outbox, caches, tracking)
                outcome = self._watch(process, ear, heartbeat, job.spec.timeout_s)
            except BaseException:
                tracking.abandon()
                raise
            finally:
                process.kill()
        if leaving():
            tracking.abandon()
        else:
            tracking.finish(outcome.status)
        if not outbox.close(_STORAGE_PATIENCE_S):
            raise StorageUnavailable(
                f"The results could not be stored for {_STORAGE_PATIENCE_S / 60:.0f} minutes: Redis or the "
                "object store was away, or refused; the worker's log says which."
            )
        tracking.write_up(outcome.status, leaving)
        self._conclude(outcome)

    def _watch(
        self,
        process: TrainingProcess,
        ear: "_Ear",
        heartbeat: Heartbeat,
        timeout_s: float,
    ) -> Outcome:
        deadline = time.monotonic() + timeout_s
        stop: Stop | None = None
        kill_at = float("inf")
        while (status := process.poll(_GLANCE_S)) is None:
            if heartbeat.lost.is_set():
                raise LeaseLost(self.holding.job_id)
            ear.outbox.check()
            if stop is None and (stop := self._wanted(heartbeat, deadline)) is not None:
                log.info("training_stops", job_id=self.holding.job_id, why=stop)
                process.stop(stop)
                kill_at = time.monotonic() + self.settings.grace.total_seconds()
            elif stop is Stop.DRAIN:
                process.stop(stop)  # It may have been deaf for a moment: see worker/training/stopping.py.
            if time.monotonic() > kill_at:
                process.kill()
        process.kill()
        ear.join()
        if status == 0:  # A process that crashed may have left kernels that would crash the next.
            ear.caches.keep()
        return judge(ear.last_word, status, stop, timeout_s)

    def _wanted(self, heartbeat: Heartbeat, deadline: float) -> Stop | None:
        if heartbeat.cancelled.is_set():
            return Stop.CANCEL
        if self.draining.is_set():
            return Stop.DRAIN
        return Stop.TIMEOUT if time.monotonic() > deadline else None

    def _conclude(self, outcome: Outcome) -> None:
        job = through_outages(partial(self._end, outcome), _STORAGE_PATIENCE_S)
        log.info(
            "attempt_ended", job_id=job.id, status=job.status, reason=outcome.reason, detail=outcome.message
        )

    def _end(self, outcome: Outcome) -> Job:
        now = utc_now()
        if outcome.status is None:
            return self.holding.give_back(outcome.reason, outcome.message, now)
        return self.holding.end(outcome.status, outcome.reason, outcome.message, now)


class _Ear:
    """Two threads that hear what the process says, so that no pipe ever fills up and halts it."""

    def __init__(self, process: TrainingProcess, outbox: Outbox, caches: Caches, tracking: Tracking) -> None:
        self.last_word: Failed | Finished | None = None
        self.outbox = outbox
        self.caches = caches
        self._process = process
        self._tracking = tracking
        self._threads = [
            threading.Thread(target=target, name=target.__name__, daemon=True)
            for target in (self._hear_messages, self._hear_lines)
        ]
        for thread in self._threads:
            thread.start()

    def join(self) -> None:
        """Both pipes have been read to their ends; the log is on its way to the store."""
        for thread in self._threads:
            thread.join()

    def _hear_messages(self) -> None:
        for message in self._process.messages():
            if isinstance(message, Failed | Finished):
                self.last_word = message
            self._tracking.tell(message)
            self.outbox.put(message)
            if isinstance(message, PhaseEnded) and message.name in _COMPILED:
                self.caches.keep()

    def _hear_lines(self) -> None:
        for line in self._process.lines():
            self.outbox.put(line)


def write_task(job: Job, holding: Holding, device: str, spool: Path) -> None:
    """Leave in the spool what the training process needs: the task, and the checkpoint it starts from.

    And the user's own model, where it names one. Raises Rejected or NotFound where the checkpoint of another
    job has gone meanwhile, JobFailed("bad_model") where the model has.
    """
    checkpoint = _checkpoint_to_use(job, holding)
    task = _as_begun(Task(job_id=job.id, attempt=holding.number, spec=job.spec, device=device), job.begun)
    if checkpoint is not None:
        with holding.objects.open(checkpoint.key) as pieces, (spool / "start.msgpack").open("wb") as file:
            for piece in pieces:
                file.write(piece)
        task = task.model_copy(
            update={"checkpoint": "start.msgpack", "checkpoint_step": checkpoint.step or 0}
        )
    task = _with_model(task, holding, spool)
    (spool / "task.json").write_text(task.model_dump_json())


def _as_begun(task: Task, begun: Attempt | None) -> Task:
    """With what the attempt before resolved: tuned values and the choice of `auto` may be others by now."""
    spec = task.spec
    if begun is None or not isinstance(spec, TrainSpec):
        return task
    had = begun.details.get("hyperparameters", {})
    known = {name: value for name, value in had.items() if name in type(spec.algorithm).model_fields}
    if known:
        spec = spec.model_copy(update={"algorithm": type(spec.algorithm).model_validate(known)})
    # Environments with physics of their own name that instead, and have no choice.
    engine = begun.engine if begun.engine in get_args(EngineName) else None
    return task.model_copy(update={"spec": spec, "begun_on": engine})


def _with_model(task: Task, holding: Holding, spool: Path) -> Task:
    model_id = model_of(task.spec.environment)
    if model_id is None:
        return task
    try:
        record = library.find(model_id, holding.objects)
        (spool / "model").write_bytes(holding.objects.get(keys.model_source(model_id)))
    except NotFound:
        raise JobFailed("bad_model", f"The model {model_id} was deleted before the job began.") from None
    cannot = dict(engines_that_cannot(record.description))
    return task.model_copy(update={"model": "model", "engines_that_cannot": cannot})


def _checkpoint_to_use(job: Job, holding: Holding) -> Artifact | None:
    """Its own newest one, if an earlier attempt got that far; else the one its specification names."""
    own = job.newest("checkpoint")
    match job.spec:
        case TrainSpec(resume_from=None):
            return own
        case TrainSpec(resume_from=point) if own is None and point is not None:
            return source_checkpoint(job.spec, point.job, point.step, "/resume_from", holding.store.get)
        case RolloutSpec(policy=CheckpointPolicy(job=source, step=step)):
            return source_checkpoint(job.spec, source, step, "/policy", holding.store.get)
        case _:
            return own


def _cached_as(job: Job) -> str:
    """What is compiled for one model of a user is of no use to another. A name without slashes."""
    model_id, environment_id = model_of(job.spec.environment) or "", job.spec.environment.id.replace("/", "-")
    return "-".join(filter(None, (environment_id, model_id.removeprefix("sha256:")[:16])))


def _checkpoints_kept(job: Job) -> int:
    return job.spec.checkpoints.keep if isinstance(job.spec, TrainSpec) else 1
