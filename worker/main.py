"""The worker: an RQ worker that forks a supervisor for each attempt. Composition root.

It never loads the numerical stack: a process that holds JAX must not fork.
"""

import contextlib
import os
import secrets
import signal
import socket
import time
from collections.abc import Sequence
from datetime import timedelta
from math import inf
from typing import Any

import rq
import structlog
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import OutOfMemoryError, RedisError
from redis.exceptions import TimeoutError as RedisTimeoutError
from rq.exceptions import StopRequested
from rq.serializers import JSONSerializer

from core.adapters.rq.queue import job_of
from core.adapters.startup import check_stores
from core.adapters.wiring import connect_redis, job_store, object_store
from core.configuration import read, stopping_if_misconfigured
from core.environments.catalog import PLUGINS, find
from core.environments.plugins import log_each
from core.errors import EnvironmentNotFound, Misconfigured, Unavailable
from core.installation import to_install
from core.jobs.job import utc_now
from core.jobs.queue import MODELS, PREVIEWS, SHARED, queue_names
from core.jobs.slots import kind_of_queue
from core.jobs.store import JobStore
from core.jobs.tallies import Report, Tallies
from core.jobs.workers import WorkerInfo, WorkerState, packages_here
from core.settings import WorkerSettings
from core.telemetry import configure_logging
from core.variables import variable
from worker.gang.members import Gang, set_gang
from worker.gang.place import Place, place_of
from worker.host import device_health
from worker.host.allocation import TimeLeft, allocation
from worker.host.device import device_memory, device_of, visible_gpus
from worker.host.device_health import DeviceHealth, SeatHealth
from worker.host.disk import check_folder
from worker.host.health import show_life
from worker.host.locks import remove_free_locks, slot_names
from worker.host.pool import Membership, pool_of
from worker.host.processes import PARENT, die_with_parent
from worker.preparation.programs import IdlePreparation
from worker.stopping import Draining
from worker.supervision.member import GangMember
from worker.supervision.spool import SPOOLS, record_left, remove_left_over
from worker.supervision.watching import is_stopped
from worker.tasks import NamedJob

log = structlog.get_logger()

# A worker shows a sign of life at least this often; it is shown as gone after three missed ones.
_ANNOUNCE_EVERY_S = 10
# Between two tries to reach a queue that is unavailable.
_PAUSE_S = 1.0
# A Redis that is full, away or silent; each of them ends without the worker.
_OUTAGES = (OutOfMemoryError, RedisConnectionError, RedisTimeoutError)
# Between two checks of a device that is being tested.
_POLL_S = 0.1
# A worker that has waited this long for a job prepares for it.
_IDLE_S = 4.0
# How long the worker waits for a message before it checks whether it must shut down.
_DEQUEUE_TIMEOUT_S = 5


class GaitwayWorker(rq.Worker):
    """RQ's forking worker, which announces itself to the service and passes a shutdown on to its job."""

    def __init__(
        self,
        settings: WorkerSettings,
        device: str,
        store: JobStore,
        health: DeviceHealth | None = None,
        tallies: Tallies | None = None,
        gang: Gang | None = None,
    ) -> None:
        self._store = store
        self._gang = gang
        pool = pool_of(settings, device)
        self._membership = None if pool is None else Membership(pool)
        self._tallies = tallies or Tallies()
        self._report = Report(self._tallies, store.add_tallies)
        self._objects = object_store(settings)
        if pool is not None and pool.seat > 0:
            self._health = SeatHealth(pool.data_dir, pool.locks[pool.own])
        else:
            self._health = health or health_of(device, settings)
        self._alive_file = settings.alive_file
        self._data_dir = settings.data_dir
        self._horse_is_stopped = False
        self._is_announcing = False
        # Of a pool's workers one is enough: it uses a GPU that a job of several may wait for.
        prepares = gang is None and (pool is None or (pool.own, pool.seat) == (min(pool.locks), 0))
        self._preparation = IdlePreparation(device, settings.prepared if prepares else ())
        self._idle_since = inf
        self._had_turns = tuple[str, ...]()
        self._time_left = TimeLeft(settings.ends_at, settings.grace, settings.start_margin)
        self._idle_exit_s = settings.idle_exit.total_seconds() if settings.idle_exit else inf
        self._had_job_at = time.monotonic()
        name = f"{socket.gethostname()}:{device}:{secrets.token_hex(3)}"
        hosts = 1 if gang is None else gang.place.hosts
        queues = queue_names(device, hosts, 1 if pool is None else len(pool.locks))
        if pool is not None and pool.seat > 0:
            queues = SHARED
        now = utc_now()
        self._info = WorkerInfo(
            name=name,
            host=socket.gethostname(),
            pid=os.getpid(),
            device=device,
            hosts=hosts,
            pool=None if pool is None else pool.device,
            seats=1 if pool is None else pool.seats,
            seat=0 if pool is None else pool.seat,
            queues=queues,
            memory_bytes=device_memory(device, settings.memory_limit),
            packages=packages_here(),
            allocation=allocation(os.environ) or None,
            started_at=now,
            seen_at=now,
        )
        super().__init__(  # pyright: ignore[reportUnknownMemberType]
            list(queues),
            name=name,
            # RQ sets a time limit of its own: a worker blocks while nothing is there for it.
            connection=connect_redis(settings.redis_url.get_secret_value()),
            serializer=JSONSerializer,
            job_class=NamedJob,
            worker_ttl=15 + _DEQUEUE_TIMEOUT_S,  # RQ waits 15 s less than this.
            job_monitoring_interval=_ANNOUNCE_EVERY_S,
        )

    def register_birth(self) -> None:
        """Wait for a Redis that is full or away, as for one that goes away later."""
        was_tried = False
        while True:
            try:
                super().register_birth()
            except _OUTAGES as error:
                was_tried = True
                self._wait_for_queue(error)
            except ValueError:  # Its name is taken: by itself, where the answer was lost.
                if not was_tried:
                    raise
                return
            else:
                return

    def register_death(self) -> None:
        """RQ forgets a worker by itself that could not say so."""
        with contextlib.suppress(RedisError):
            super().register_death()

    def set_state(self, *args: Any, **kwargs: Any) -> None:
        """Only for those who look into Redis: its outage must not end the worker."""
        with contextlib.suppress(*_OUTAGES):
            super().set_state(*args, **kwargs)

    def set_current_job_working_time(self, *args: Any, **kwargs: Any) -> None:
        """As the state. RQ does this before it notes that a work-horse has ended."""
        with contextlib.suppress(*_OUTAGES):
            super().set_current_job_working_time(*args, **kwargs)

    def check_for_suspension(self, burst: bool) -> None:
        while True:
            try:
                super().check_for_suspension(burst)
            except _OUTAGES as error:
                self._wait_for_queue(error)
            else:
                return

    def run_maintenance_tasks(self) -> None:
        """RQ tries again at its next turn."""
        with contextlib.suppress(*_OUTAGES):
            super().run_maintenance_tasks()

    def execute_job(self, job: Any, queue: Any) -> None:
        """The record says how the job ended: RQ's bookkeeping may fail."""
        try:
            super().execute_job(job, queue)
        except _OUTAGES as error:
            self.set_state(rq.worker.WorkerStatus.IDLE)
            self._wait_for_queue(error)
        finally:
            self._had_job_at = time.monotonic()

    def handle_job_failure(self, *args: Any, **kwargs: Any) -> None:
        """RQ forgets the execution before Redis has: a second try would leave the message as started."""
        execution = self.execution
        try:
            super().handle_job_failure(*args, **kwargs)  # pyright: ignore[reportUnknownMemberType]
        except RedisError:
            self.execution = execution
            raise

    def _wait_for_queue(self, error: RedisError) -> None:
        """A pause between two tries to reach Redis. Raises StopRequested if the worker must shut down."""
        log.warning("queue_bookkeeping_waits", error=str(error))
        self._go_if_told()
        with contextlib.suppress(RedisError):
            self.announce()
        time.sleep(_PAUSE_S)

    def heartbeat(self, *args: Any, **kwargs: Any) -> None:
        """Show a sign of life. Raises StopRequested if the worker must shut down."""
        self._end_in_time()
        self._go_if_told()
        self._end_stopped_horse()
        self._clear_up()
        began = time.perf_counter()
        try:
            super().heartbeat(*args, **kwargs)
            self._tallies.observe_store("redis", time.perf_counter() - began, failed=False)
        except _OUTAGES as error:
            self._tallies.observe_store("redis", time.perf_counter() - began, failed=True)
            if self._idle_since < inf:  # It waits for a message: that needs Redis.
                raise
            log.warning("queue_bookkeeping_waits", error=str(error))
        self.announce()
        if self._idle_since < inf and not self._is_complete():
            raise _MustWait
        if time.monotonic() - self._idle_since >= _IDLE_S:
            self._preparation.go_on()

    def dequeue_job_and_maintain_ttl(self, *args: Any, **kwargs: Any) -> Any:
        """The next job, once the device works. Raises StopRequested if the worker must shut down."""
        while True:
            self._wait_for_device()
            self._idle_since = time.monotonic()
            try:
                return super().dequeue_job_and_maintain_ttl(*args, **kwargs)
            except _OUTAGES as error:  # RQ itself waits for nothing but a connection.
                self._wait_for_queue(error)
            except _MustWait:
                pass
            finally:
                self._idle_since = inf
                self._preparation.stop()

    def reorder_queues(self, reference_queue: Any) -> None:
        """RQ calls it with the queue of the message that it has just taken.

        A preview comes before all jobs, and a model after it. Then a job has its turn: any client can send
        both.
        """
        self._idle_since = inf
        self._had_turns = {PREVIEWS: (PREVIEWS,), MODELS: (PREVIEWS, MODELS)}.get(reference_queue.name, ())
        self._order_queues()

    def _order_queues(self) -> None:
        """Those that it asks now, in their order: a pool's worker asks for no more than is free."""
        queues = self.queues
        if (members := self._membership) is not None:
            queues = [
                queue
                for queue in queues
                if members.asks(kind_of_queue(queue.name), shared=queue.name in SHARED)
            ]
        self._ordered_queues = sorted(queues, key=lambda queue: queue.name in self._had_turns)

    def _end_in_time(self) -> None:
        """Shut down before the machine is taken away, or because nothing has been there to do for long."""
        if self._stop_requested:
            return
        if self.get_state() == rq.worker.WorkerStatus.BUSY:
            self._stop_requested = self._time_left.is_over()
            if self._stop_requested:
                log.info("worker_drains", detail="Its machine is taken away soon.")
        elif self._time_left.is_too_short():
            log.info("worker_ends", detail="The time that is left is too short for another job.")
            self._stop_requested = True
        elif time.monotonic() - self._had_job_at >= self._idle_exit_s:
            log.info("worker_ends", detail=f"It has had no job for {self._idle_exit_s:g} s.")
            self._stop_requested = True

    def _wait_for_device(self) -> None:
        shown, shown_at = "", 0.0
        try:
            while not (self._health.is_fit() and self._is_complete()):
                self._go_if_told()
                if shown != self._shown_state or time.monotonic() - shown_at > _ANNOUNCE_EVERY_S:
                    shown, shown_at = self._shown_state, time.monotonic()
                    self._show_idle()
                time.sleep(_POLL_S)
        finally:
            self._health.close()

    def _is_complete(self) -> bool:
        """Whether all hosts are there, and its GPU is no other worker's."""
        if self._membership is None:
            return self._gang is None or self._gang.look()
        may_take = self._membership.look(prepares=self._preparation.is_running)
        if self._membership.state == "lent":  # It is of use, and does not end for having no job.
            self._had_job_at = time.monotonic()
        self._order_queues()
        return may_take

    @property
    def _shown_state(self) -> WorkerState:
        """Whether it takes a job, or has one."""
        if self._health.state != "ready" or self.horse_pid:
            return self._health.state
        if self._membership is not None:
            return self._membership.state
        return "incomplete" if self._gang is not None and self._gang.problem else "ready"

    @property
    def _problem(self) -> str | None:
        """A sentence on the state."""
        match self._shown_state:
            case "incomplete":
                return self._gang.problem if self._gang else None
            case "lent" | "kept":
                return self._membership.problem if self._membership else None
            case "ready" if self._membership is not None:
                return self._membership.problem
            case _:
                return self._health.problem

    @property
    def _served(self) -> tuple[str, ...]:
        """The queues whose jobs it could have once others have ended."""
        if self._membership is None:
            return self._info.queues
        most = self._membership.pool.most_gpus
        return tuple(name for name in self._info.queues if kind_of_queue(name).gpus <= most)

    def _show_idle(self) -> None:
        try:
            self.heartbeat()
        except RedisError as error:
            log.warning("queue_bookkeeping_waits", error=str(error))
            self.announce()

    def _end_stopped_horse(self) -> None:
        """End a work-horse that is found stopped by a signal at two heartbeats: it would keep its device."""
        was_stopped, self._horse_is_stopped = self._horse_is_stopped, is_stopped(self.horse_pid or 0)
        if was_stopped and self._horse_is_stopped:
            log.error("work_horse_stopped", pid=self.horse_pid)
            self.kill_horse()

    def monitor_work_horse(self, job: Any, queue: Any) -> None:
        """Wait for the job's end, through any outage of Redis: RQ alone would give up and orphan the job."""
        while True:
            try:
                super().monitor_work_horse(job, queue)
            except RedisError as error:
                log.warning("queue_bookkeeping_waits", error=str(error))
                if self._stop_requested and not self.horse_pid:
                    break  # It has left its job to others; nobody needs to hear of it before the worker goes.
                time.sleep(_PAUSE_S)
            else:
                break
        if self._gang is not None:
            self._gang.release()
        self._clear_up()

    def _clear_up(self) -> None:
        """Remove what a killed work-horse has left on the disk."""
        remove_left_over(self._data_dir / SPOOLS)
        remove_free_locks(self._data_dir / "locks")

    def announce(self) -> None:
        """Update this worker in `GET /workers`, and record what an earlier worker here could not record.

        A missed announcement does no harm: the next one makes up for it.
        """
        show_life(self._alive_file)
        job = self.get_current_job_id()
        news = {
            "job": job_of(job) if job else None,
            "state": self._shown_state,
            "problem": self._problem,
            "queues": self._served,
        }
        info = self._info.model_copy(update={"seen_at": utc_now(), **news})
        self._is_announcing = True
        try:
            self._store.announce(info, timedelta(seconds=4 * _ANNOUNCE_EVERY_S))
            record_left(self._data_dir, self._store, self._objects)
            self._report.if_due()
        except Unavailable as error:
            log.warning("announcement_missed", error=error.detail)
        finally:
            self._is_announcing = False
        self._go_if_told()

    def request_stop(self, signum: Any, frame: Any) -> None:
        """First signal: the job drains, then the worker goes. RQ itself would only wait.

        A second SIGINT ends the job at once. Other signals come again without asking for that: Slurm sends
        SIGTERM to every process of a job, then again at its end, and a batch script passes it on, too.

        The code that the exception interrupts may swallow it, as redis-py does where it counts commands. So
        the exception is only the fast way, and every heartbeat checks again.
        """
        if self._stop_requested:
            return
        self._stop_requested = True
        signal.signal(signal.SIGINT, self.request_force_stop)
        # A database's driver may take an exception for a failure of its own.
        if not self._is_announcing:
            self._go_if_told()

    def _install_signal_handlers(self) -> None:
        super()._install_signal_handlers()
        # Slurm's warning, where a script asks for this signal and Slurm sends it to all processes.
        signal.signal(signal.SIGUSR1, self.request_stop)

    def _go_if_told(self) -> None:
        if not self._stop_requested:
            return
        if self.get_state() != rq.worker.WorkerStatus.BUSY:
            raise StopRequested
        if self.horse_pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.horse_pid, signal.SIGTERM)


class _MustWait(Exception):
    """While the worker waits for a job a host has left, or its GPU was lent."""


def health_of(device: str, settings: WorkerSettings) -> DeviceHealth:
    """The health of a device that has not been tested yet."""
    names = slot_names(device, os.getpid())
    return DeviceHealth(device, settings.data_dir.absolute(), names, device_health.command_for(device))


def check_prepared(environments: Sequence[str]) -> None:
    """Raises Misconfigured for one that there is not."""
    for environment in environments:
        try:
            find(environment)
        except EnvironmentNotFound as error:
            raise Misconfigured(f"{variable('prepare')}: {error.detail}") from None


def serve_as_member(place: Place, settings: WorkerSettings, device: str) -> None:
    """Run this host's part of the jobs of a gang, until a SIGTERM or SIGINT."""
    draining = Draining()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1):
        signal.signal(number, draining.set)
    log.info("member_started", rank=place.rank, hosts=place.hosts, leader=place.host)
    names, health = slot_names(device, os.getpid()), health_of(device, settings)
    GangMember(place, settings, device, names, object_store(settings), health, draining).serve()
    health.close()


@stopping_if_misconfigured()
def main() -> None:
    """Serve until a SIGTERM."""
    configure_logging("worker")
    log_each(PLUGINS)
    if PARENT in os.environ:
        die_with_parent(signal.SIGTERM)
    settings = read(WorkerSettings)
    device = device_of(settings.device)
    if settings.device == "auto" and device == "cpu" and visible_gpus():
        log.warning("gpu_not_used", remedy=f"JAX cannot use it: {to_install('cuda')}.")
    check_folder(settings.data_dir)
    place = place_of(settings)
    if place is not None and place.rank > 0:
        serve_as_member(place, settings, device)
        return
    check_stores(settings)
    # Without a pool: a connection must not be shared with what is forked.
    tallies = Tallies()
    store = job_store(settings, pool_size=0, observe=tallies.observe_store)
    check_prepared(settings.prepared)
    gang = None if place is None else Gang(place, device)
    if gang is not None:
        set_gang(gang)
    worker = GaitwayWorker(settings, device, store, tallies=tallies, gang=gang)
    log.info("worker_started", worker=worker.name)
    try:
        worker.work(logging_level="WARNING")
    finally:
        with contextlib.suppress(Unavailable):
            store.withdraw(worker.name)


if __name__ == "__main__":
    main()
