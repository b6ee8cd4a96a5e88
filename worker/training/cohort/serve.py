"""Trains a cohort, and gives each member its events, checkpoints and policy when it asks."""

from collections.abc import Iterable, Mapping, Sequence, Set
from multiprocessing.connection import Connection, wait
from typing import Any, cast

from core.algorithms.catalog import ALGORITHMS, loaded, resolve
from core.algorithms.cohort import CohortRun
from core.jobs.spec import TrainSpec
from worker.protocol import Task
from worker.training.built_environment import build_environment
from worker.training.cohort.messages import Begun, Moment, Request, pack
from worker.training.train import steps_between_checkpoints


def serve(connections: Iterable[Connection]) -> None:
    """Train those that send their tasks, until all of them have left."""
    tasks = dict(_tasks(connections))
    if tasks:
        members = list(tasks)
        run, begun = _begin(list(tasks.values()))
        _Members(run, members).see_to_the_end(begun)


def _tasks(connections: Iterable[Connection]) -> Iterable[tuple[Connection, Task]]:
    """Every member's task; one that ends before it sends its own is left out."""
    for connection in connections:
        try:
            yield connection, Task.model_validate_json(connection.recv_bytes())
        except (EOFError, OSError):
            connection.close()


def _begin(tasks: Sequence[Task]) -> tuple[CohortRun[Any], Begun]:
    built = build_environment(tasks[0])
    specs = [cast("TrainSpec", task.spec) for task in tasks]
    settings = [resolve(spec.algorithm, built.info, built.device) for spec in specs]
    algorithm = loaded(ALGORITHMS[settings[0].algorithm()].algorithm)
    run = CohortRun[Any](
        [
            algorithm(built.environment, one, seed=spec.seed, devices=1)
            for one, spec in zip(settings, specs, strict=True)
        ],
        checkpoint_every_steps=steps_between_checkpoints(specs[0], settings[0]),
    )
    begun = Begun(
        device=built.device_name,
        engine=built.engine,
        engine_reason=built.engine_reason,
        total=run.total,
        num_members=len(tasks),
    )
    return run, begun


class _Members:
    """The members that have not left. connections: in the order of the run's members."""

    def __init__(self, run: CohortRun[Any], connections: Sequence[Connection]) -> None:
        self._run = run
        self._here: Mapping[int, Connection] = dict(enumerate(connections))
        self._waiting: set[int] = set()

    def see_to_the_end(self, begun: Begun) -> None:
        for member in list(self._here):
            self._send(member, begun.model_dump_json().encode())
        for moment in self._run.moments():
            self._answer_until_all_wait()
            for member, seen in moment:
                self._tell(Moment(self._run.step(member), seen), member)
            if not self._at_work():
                break
        self._answer_until_all_wait()
        for member in self._at_work():
            self._tell(Moment(self._run.step(member), None), member)
        while self._here:
            self._answer()

    def _at_work(self) -> Set[int]:
        """Those that are here and have not failed; without any, there is nothing left to train."""
        return self._here.keys() - self._run.failed

    def _answer_until_all_wait(self) -> None:
        """Until each member at work asks for what comes next; one that has failed is answered meanwhile."""
        self._answer(0.0)
        while self._at_work() - self._waiting:
            self._answer()

    def _answer(self, timeout_s: float | None = None) -> None:
        """What is asked by now; without a time, wait until somebody asks."""
        ready = wait(self._here.values(), timeout_s)
        for member in [member for member, connection in self._here.items() if connection in ready]:
            try:
                request = Request(self._here[member].recv_bytes())
            except (EOFError, OSError):
                self._drop(member)
                continue
            if request is Request.NEXT:
                self._waiting.add(member)
            else:
                state = self._run.checkpoint if request is Request.CHECKPOINT else self._run.policy
                self._send(member, state(member))

    def _tell(self, moment: Moment, member: int) -> None:
        self._waiting.discard(member)
        if member in self._here:
            self._send(member, pack(moment))

    def _send(self, member: int, content: bytes) -> None:
        try:
            self._here[member].send_bytes(content)
        except OSError:
            self._drop(member)

    def _drop(self, member: int) -> None:
        self._waiting.discard(member)
        left = {one: connection for one, connection in self._here.items() if one != member}
        self._here[member].close()
        self._here = left
