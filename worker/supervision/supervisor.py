"""One attempt at one job: start the training process, watch it, store what it says, end it for certain."""

import secrets
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import IO

import structlog

from core.errors import (
    JobFailed,
    LeaseLost,
    NotFound,
    ObjectNotFound,
    RecordsUnavailable,
    Rejected,
    Unavailable,
)
from core.jobs.attempts import Claim
from core.jobs.job import Job, utc_now
from core.jobs.spec import TrainSpec
from core.jobs.status import JobStatus
from core.jobs.store import Entry
from core.jobs.tallies import PHASE_SECONDS, Report, Tallies
from core.reasons import Reason
from core.retry import CalledOff, retry_while_unavailable
from core.settings import WorkerSettings
from worker.compile_cache.session import Caches
from worker.gang.members import Gang
from worker.host.cgroup import memory_group
from worker.host.child import TRAINING, TrainingProcess
from worker.host.device_health import SUSPICIOUS, DeviceTest, result_of, set_aside
from worker.host.disk import is_full, what_to_do
from worker.host.locks import SlotTaken, slots
from worker.host.memory import MemoryWatch, allowed_bytes
from worker.host.pool import Pool
from worker.protocol import Advanced, Failed, Finished, Noted, PhaseBegan, PhaseEnded
from worker.stopping import DRAIN_SIGNAL, STOP_SIGNAL, Draining, Stop
from worker.supervision.measurements import store_metrics
from worker.supervision.other_hosts import OtherHosts
from worker.supervision.outbox import Outbox
from worker.supervision.outcome import Outcome, drained, judge
from worker.supervision.spool import SPOOLS, end, leave, private, spool
from worker.supervision.starting_point import write_task
from worker.supervision.story import Story, ending, timed
from worker.supervision.tracking import Tracking
from worker.supervision.watching import Heartbeat, LogLimit, StallWatch

log = structlog.get_logger()

# How often the supervisor checks everything else while it waits for the process to end.
_POLL_S = 0.1
# The phases after which there are new programs, and new kernels.
_COMPILED = ("compile", "first_update")
# How long finished work waits for an unavailable store before the attempt is given up.
_STORAGE_TIMEOUT_S = 86_400.0
# The last uploads get at least this time, even if the training process has used up the grace time.
_LAST_S = 3.0
# For so long a signal to all processes may be on its way to this one.
_TOLD_WITHIN_S = 1.0


@dataclass
class Supervisor:
    """Runs one claimed attempt.

    draining: set, also by a signal handler, once the worker must shut down, or the job makes room for
    another; it then keeps a checkpoint and is given back. device_test: the program that tests the device
    after a failure that it may have caused. gang: the other hosts, connected, where several share the job.
    held: the devices' locks, if they were taken before; it releases them. pool: where they are from.
    tallies: gathers for monitoring.
    Afterwards the job has ended or is back in the queue, and no process and no spool is left.
    """

    claim: Claim
    settings: WorkerSettings
    device: str
    slot_names: tuple[str, ...]
    command: Sequence[str] = TRAINING
    draining: Draining = field(default_factory=Draining)
    device_test: Sequence[str] | None = None
    gang: Gang | None = None
    held: AbstractContextManager[tuple[int, ...]] | None = None
    pool: Pool | None = None
    tallies: Tallies = field(default_factory=Tallies)
    _is_told: bool = field(default=False, init=False)

    def run(self) -> None:
        folder = self.settings.data_dir.absolute()  # The training process has another working directory.
        own = folder / SPOOLS / f"{self.claim.job_id}.{self.claim.number}"
        caches = Caches(self.claim.objects, self.settings, self.device, own, private(own))
        report = Report(self.tallies, self.claim.store.add_tallies)
        try:
            with Heartbeat(self.claim, self.settings, self.draining, report.if_due) as heartbeat:
                outcome = self._outcome(heartbeat, caches, folder, own)
                self._tell(outcome)
                self._conclude(outcome)
        except LeaseLost:
            log.warning("attempt_abandoned", job_id=self.claim.job_id, attempt=self.claim.number)
        caches.close(self.draining.is_set)  # The job has ended: nobody waits for this.
        report.now()

    def _outcome(self, heartbeat: Heartbeat, caches: Caches, folder: Path, own: Path) -> Outcome:
        try:
            with spool(own):
                return self._attempt(heartbeat, caches, folder, own)
        except CalledOff:
            return drained(self.draining.room_for, " before it had started the job.")
        except SlotTaken as error:
            # The worker takes no further job before the device is free.
            with suppress(OSError):  # No room for it: the next job waits for the device, too.
                set_aside(folder, self.slot_names, str(error))
            return Outcome(None, Reason.DEVICE_HELD, str(error))
        except JobFailed as error:
            return Outcome(JobStatus.FAILED, error.reason, error.detail)
        except (NotFound, Rejected) as error:
            return Outcome(JobStatus.FAILED, Reason.BAD_CHECKPOINT, error.detail)
        except Unavailable as error:
            return Outcome(None, Reason.STORAGE_UNAVAILABLE, error.detail)
        except OSError as error:
            if not is_full(error):
                raise
            return Outcome(None, Reason.STORAGE_UNAVAILABLE, what_to_do(folder))

    def _attempt(self, heartbeat: Heartbeat, caches: Caches, folder: Path, spool: Path) -> Outcome:
        leaving = self.draining.is_set
        job = retry_while_unavailable(
            partial(self.claim.store.get, self.claim.job_id), _STORAGE_TIMEOUT_S, called_off=leaving
        )
        story = Story(job, spool)
        notes = retry_while_unavailable(
            partial(write_task, job, self.claim, self.device, spool),
            _STORAGE_TIMEOUT_S,
            called_off=leaving,
        )
        locks = [folder / "locks" / f"{name}.lock" for name in self.slot_names]
        with self.held or slots(locks, self.settings.grace.total_seconds(), leaving) as slot_fds:
            caches.open(job.spec.environment, leaving)
            outbox = Outbox(self.claim, spool, _checkpoints_kept(job), job.progress, story, self.tallies)
            outbox.put_all(story.begin())
            outbox.put(PhaseBegan(phase="preparing"))
            for note in notes:
                outbox.put(Noted(text=note))
            tracking = Tracking(job, self.claim, spool, self.settings, outbox)
            tracking.begin()
            models = self.settings.models
            others = OtherHosts(self.gang, outbox.put, self.settings.lease.total_seconds())
            others.begin(spool)
            process = TrainingProcess(
                self.command, spool, folder, self.device, slot_fds, models, self.claim.gpu_part
            )
            try:
                readers = OutputReaders(process, outbox, caches, tracking, StallWatch(self.settings.stall))
                memory_bytes = allowed_bytes(self.settings.memory_limit)
                with memory_group(process.pid, memory_bytes) as group:
                    memory = MemoryWatch(memory_bytes, group=group)
                    outcome = self._watch(process, readers, heartbeat, memory, job.spec.timeout_s, others)
            except BaseException:
                tracking.abandon()
                outbox.abandon()
                raise
            finally:
                process.kill()
                others.end()
            outcome = self._after_test(others.outcome(outcome), folder, slot_fds)
        if leaving():
            tracking.abandon()
        else:
            tracking.finish(outcome.status)
        outbox.put_all(story.end(outcome))
        for phase, seconds in story.seconds():
            self.tallies.add(PHASE_SECONDS, seconds, phase)
        self._is_told = True
        if not outbox.close(_STORAGE_TIMEOUT_S, self._must_leave(_LAST_S)):
            outbox.abandon()
            return _not_stored(self.draining)
        # A new one, of a name that no training can have foreseen; it goes with the spool.
        path = spool / f".metrics-{secrets.token_hex(8)}"
        try:
            with path.open("xb") as file:
                if self._stores_metrics(job, outcome, file, path):
                    tracking.write_up(path, outcome.status, leaving)
        except OSError as error:  # A finished job does not fail for it.
            log.warning("metrics_not_kept", job_id=self.claim.job_id, error=str(error))
        return outcome

    def _watch(
        self,
        process: TrainingProcess,
        readers: "OutputReaders",
        heartbeat: Heartbeat,
        memory: MemoryWatch,
        timeout_s: float,
        others: OtherHosts,
    ) -> Outcome:
        deadline = time.monotonic() + timeout_s
        stop: Stop | None = None
        kill_at = float("inf")
        while (status := process.poll(_POLL_S)) is None:
            if heartbeat.lost.is_set():
                raise LeaseLost(self.claim.job_id)
            readers.outbox.check()
            if stop is None and (stop := self._wanted(heartbeat, deadline, others.is_leaving)) is not None:
                log.info("training_stops", job_id=self.claim.job_id, why=stop)
                process.stop(stop)
                kill_at = time.monotonic() + self.settings.grace.total_seconds()
            elif stop is Stop.DRAIN:
                process.stop(stop)  # One may be lost: see worker/stopping.py.
            if time.monotonic() > kill_at:
                process.kill()
            for watch, reason in (
                (readers.stall, Reason.TRAINING_STALLED),
                (memory, Reason.OUT_OF_HOST_MEMORY),
                (others, Reason.TRAINING_KILLED),
            ):
                if (problem := watch.what_is_wrong(process.pid)) is not None:
                    log.warning(reason.value, job_id=self.claim.job_id, detail=problem)
                    process.kill()
                    readers.join()
                    return Outcome(None, reason, problem)
        memory_ran_out = memory.ran_out()
        process.kill()
        readers.join()
        if status == 0:  # A process that crashed may have left kernels that would crash the next.
            readers.caches.keep()
        if stop is None and self._was_told_to_leave(readers.last_word, status):
            stop = Stop.DRAIN
        return judge(
            readers.last_word,
            status,
            stop,
            timeout_s,
            memory_ran_out=memory_ran_out,
            room_for=self.draining.room_for,
        )

    def _was_told_to_leave(self, last_word: Failed | Finished | None, status: int) -> bool:
        """Whether a signal to all processes of the worker ended the training, before it was asked to drain.

        Slurm ends a job so; the worker and this process hear of it a moment before or after.
        """
        was_stopped = isinstance(last_word, Finished) and last_word.stopped
        if not was_stopped and -status not in (STOP_SIGNAL, DRAIN_SIGNAL):
            return False
        deadline = time.monotonic() + _TOLD_WITHIN_S
        while not self.draining.is_set() and time.monotonic() < deadline:
            time.sleep(0.05)
        return self.draining.is_set()

    def _after_test(self, outcome: Outcome, folder: Path, slot_fds: Sequence[int]) -> Outcome:
        """Test a device that may have caused the end; one that fails is set aside and named as the reason.

        GPUs of a pool that fail only together go on with jobs of one: each one's worker would find it well.
        """
        if self.device_test is None or outcome.status is not None or outcome.reason not in SUSPICIOUS:
            return outcome
        test = DeviceTest(self.device_test, self.device, folder, slot_fds)
        problem = result_of(test, self.draining.is_set)
        if problem is None:
            return outcome
        if self.pool is not None and test.each_works:
            self.pool.set_apart(problem)
        else:
            set_aside(folder, self.slot_names, problem)
        return Outcome(None, Reason.DEVICE_FAILED, f"{outcome.message} {problem}")

    def _stores_metrics(self, job: Job, outcome: Outcome, file: IO[bytes], path: Path) -> bool:
        """Whether there is a file of all metrics now. A worker that shuts down leaves it to the next attempt;
        where there is none, it has the grace time for it."""
        if not isinstance(job.spec, TrainSpec):
            return False
        leaving = self.draining.is_set if outcome.status is None else self._must_leave(_LAST_S)
        step = partial(store_metrics, self.claim, file, path, _checkpoints_kept(job), leaving)
        try:
            return retry_while_unavailable(step, _STORAGE_TIMEOUT_S, called_off=leaving)
        except CalledOff:
            return False
        except ObjectNotFound as error:  # The feed has lost a part.
            log.warning("metrics_not_kept", job_id=self.claim.job_id, error=str(error))
            return False

    def _wanted(self, heartbeat: Heartbeat, deadline: float, is_leaving: bool) -> Stop | None:
        """is_leaving: whether the worker of another host must shut down."""
        if heartbeat.cancelled.is_set():
            return Stop.CANCEL
        if self.draining.is_set() or is_leaving:
            return Stop.DRAIN
        return Stop.TIMEOUT if time.monotonic() > deadline else None

    def _must_leave(self, at_least_s: float = 0.0) -> Callable[[], bool]:
        """Whether the grace time of a drain is over, and `at_least_s` from now have passed."""
        grace_s, not_before = self.settings.grace.total_seconds(), time.monotonic() + at_least_s
        return lambda: self.draining.for_s() >= grace_s and time.monotonic() >= not_before

    def _tell(self, outcome: Outcome) -> None:
        """Write the end of an attempt that never began into the log, if the record is there just now."""
        if self._is_told:
            return
        said = [Entry(kind="line", time=utc_now(), data={"text": line}) for line in timed(ending(outcome))]
        with suppress(RecordsUnavailable):
            self.claim.store.record(
                self.claim.job_id, self.claim.token, "logs", said, write_id=secrets.token_hex(8)
            )

    def _conclude(self, outcome: Outcome) -> None:
        record_end = partial(end, self.claim, outcome)
        try:
            job = retry_while_unavailable(record_end, _STORAGE_TIMEOUT_S, called_off=self._must_leave())
        except CalledOff:  # PostgreSQL is unavailable: the next worker records it, or the lease runs out.
            log.warning("attempt_left", job_id=self.claim.job_id, detail=outcome.message)
            with suppress(OSError):  # No room for it: the job counts as a lost worker's.
                leave(self.settings.data_dir, self.claim, outcome)
            return
        log.info(
            "attempt_ended", job_id=job.id, status=job.status, reason=outcome.reason, detail=outcome.message
        )


class OutputReaders:
    """Two threads that read the process's pipes, so that a full pipe never blocks it."""

    def __init__(
        self,
        process: TrainingProcess,
        outbox: Outbox,
        caches: Caches,
        tracking: Tracking,
        stall: StallWatch,
    ) -> None:
        self.last_word: Failed | Finished | None = None
        self.stall = stall
        self.outbox = outbox
        self.caches = caches
        self._process = process
        self._tracking = tracking
        self._threads = [
            threading.Thread(target=target, name=target.__name__, daemon=True)
            for target in (self._read_messages, self._read_lines)
        ]
        for thread in self._threads:
            thread.start()

    def join(self) -> None:
        """Wait until both pipes have been read to their ends; the outbox then has the whole log."""
        for thread in self._threads:
            thread.join()

    def _read_messages(self) -> None:
        for message in self._process.messages():
            self.stall.hear(is_progress=isinstance(message, Advanced))
            if isinstance(message, Failed | Finished):
                self.last_word = message
            self._tracking.send(message)
            self.outbox.put(message)
            if isinstance(message, PhaseEnded) and message.name in _COMPILED:
                self.caches.keep()

    def _read_lines(self) -> None:
        limit = LogLimit()
        for line in self._process.lines():
            self.stall.hear()
            for told in limit.pass_on(line, self.outbox.num_waiting):
                self.outbox.put(told)
        for told in limit.end():
            self.outbox.put(told)


def _not_stored(draining: Draining) -> Outcome:
    """The outcome of an attempt whose results could not be stored."""
    why = "PostgreSQL or the object store was unavailable, or refused; the worker's log says which"
    if draining.is_set():
        return drained(draining.room_for, f" before everything was stored: {why}.")
    hours = _STORAGE_TIMEOUT_S / 3600
    message = f"The results could not be stored for {hours:.0f} hours: {why}."
    return Outcome(None, Reason.STORAGE_UNAVAILABLE, message)


def _checkpoints_kept(job: Job) -> int:
    return job.spec.checkpoints.keep if isinstance(job.spec, TrainSpec) else 1
