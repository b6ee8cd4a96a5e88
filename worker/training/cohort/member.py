"""A member of a cohort: a training whose run is in the process that trains all of them."""

from collections.abc import Generator, Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from numpy.typing import NDArray

from core.algorithms.catalog import resolve
from core.algorithms.events import Event
from core.devices import gpu_indices
from core.environments.info import Device
from core.errors import JobFailed
from core.jobs.spec import TrainSpec
from core.reasons import Reason
from worker.protocol import Task
from worker.training.built_environment import build_environment
from worker.training.cohort.messages import Begun, Request, unpack
from worker.training.event_writer import EventWriter
from worker.training.stopping import StopRequest
from worker.training.train import follow


def train_as_member(
    task: Task, spec: TrainSpec, events: EventWriter, stopping: StopRequest, connection: Connection
) -> bool:
    """Like `train`. The cohort's process has the device and the engine; this one draws its videos on the CPU,
    on whatever engine suits that."""
    run = MemberRun(connection, task)
    device: Device = "gpu" if gpu_indices(task.device) else "cpu"
    drawn = spec.model_copy(update={"physics": "auto"})
    built = build_environment(task.model_copy(update={"device": "cpu", "spec": drawn}))
    begun = run.begun()
    trained_by = replace(
        built, engine=begun.engine, engine_reason=begun.engine_reason, device_name=begun.device
    )
    settings = resolve(spec.algorithm, built.info, device)
    facts = {"hyperparameters": settings.model_dump(), "resumed_at_step": 0}
    events.send(trained_by.started(**facts, trained_together=begun.num_members))
    return follow(run, spec, settings, built, events, stopping, best_before=task.best, others_wait=True)


class MemberRun:
    """Stands in for a training's `Run`: the cohort's process answers.

    Everything raises JobFailed("cohort_ended") once that has ended.
    """

    def __init__(self, connection: Connection, task: Task) -> None:
        self.step = self.total = 0
        self._connection = connection
        self._last: dict[Request, bytes] = {}
        self._send(task.model_dump_json().encode())

    def begun(self) -> Begun:
        """Waits until the cohort is complete."""
        begun = Begun.model_validate_json(self._answer())
        self.total = begun.total
        return begun

    def events(self) -> Generator[Event]:
        """Like `Run.events`. The others wait until this member asks for the next event, or closes this.

        Afterwards `checkpoint` and `policy` are those of the last event. Raises JobFailed also where this
        member diverged.
        """
        try:
            while (seen := self._next()) is not None:
                if isinstance(seen, JobFailed):
                    raise seen
                yield seen
        finally:
            self._leave()

    def checkpoint(self) -> bytes:
        return self._asked(Request.CHECKPOINT)

    def policy(self) -> bytes:
        return self._asked(Request.POLICY)

    def tables(self) -> Mapping[str, NDArray[Any]]:
        """None of the algorithms that train together has any."""
        return {}

    def _next(self) -> Event | JobFailed | None:
        moment = unpack(self._asked(Request.NEXT))
        self.step = moment.step
        return moment.seen

    def _leave(self) -> None:
        """Take along what is asked for later; the others no longer wait."""
        if not self._connection.closed:
            try:
                self._last = {one: self._asked(one) for one in (Request.CHECKPOINT, Request.POLICY)}
            finally:
                self._connection.close()

    def _asked(self, request: Request) -> bytes:
        if request in self._last:
            return self._last[request]
        self._send(request.value)
        return self._answer()

    def _send(self, content: bytes) -> None:
        try:
            self._connection.send_bytes(content)
        except OSError as error:
            raise _cohort_ended() from error

    def _answer(self) -> bytes:
        try:
            return self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            raise _cohort_ended() from error


def _cohort_ended() -> JobFailed:
    return JobFailed(
        Reason.COHORT_ENDED,
        "The process that trained this job together with other trials of its sweep has ended; the next "
        "attempt trains alone.",
    )
