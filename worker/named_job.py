"""The only work that Redis may ask of a worker."""

from collections.abc import Callable
from typing import Any, ClassVar

from rq.job import Job

from worker import tasks


class UnknownTask(Exception):
    """The queue holds a task that this service does not have."""


class NamedJob(Job):
    """An RQ job that is one of our three tasks. RQ itself would call whatever Python function it names.

    Callbacks are never run: their names come from Redis, too.
    """

    tasks: ClassVar[dict[str, Callable[..., None]]] = {
        f"{task.__module__}.{task.__name__}": task
        for task in (tasks.run_attempt, tasks.validate_model, tasks.draw_preview)
    }

    @property
    def success_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def failure_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def stopped_callback(self) -> None:
        """None, whatever Redis says."""
        return None

    @property
    def func(self) -> Callable[..., Any]:
        """The task. Raises UnknownTask."""
        task = self.tasks.get(str(self.func_name))
        if task is None or self.instance is not None:
            raise UnknownTask(f"{str(self.func_name)[:80]!r} is no task of a Gaitway worker.")
        return task
