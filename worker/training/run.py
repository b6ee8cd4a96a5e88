"""Runs a task and reports how it ended, whatever happens."""

import io
import sys
import time
import traceback
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from core.errors import GaitwayError, JobFailed
from core.jobs.spec import RolloutSpec, TrainSpec
from core.reasons import Reason
from worker.protocol import Failed, Finished, PhaseEnded, Task
from worker.training.event_writer import EventWriter
from worker.training.failure import failure
from worker.training.stopping import StopRequest


def run(spool: Path, events_fd: int, stopping: StopRequest) -> int:
    """Run the task in the spool; returns the exit status. The last message is Finished or Failed."""
    events, device = EventWriter(spool, events_fd), "cpu"
    try:
        task = Task.model_validate_json((spool / "task.json").read_bytes())
        device = task.device
        stopped = _dispatch(task, events, stopping)
    except JobFailed as error:
        events.send(Failed(reason=error.reason, message=error.detail))
    except GaitwayError as error:
        events.send(Failed(reason=Reason.TRAINING_CRASHED, message=error.detail))
    except Exception as error:  # Every way to end must reach the job's record.
        traceback.print_exc()
        events.send(failure(error, device))
    else:
        events.send(Finished(stopped=stopped))
        return 0
    return 1


def _dispatch(task: Task, events: EventWriter, stopping: StopRequest) -> bool:
    """Run the task; returns whether a stop cut it short."""
    began = time.perf_counter()
    with _without_warnings_of_warp():
        from worker.training.built_environment import build_environment
        from worker.training.roll_out import roll_out
        from worker.training.train import train

    events.send(PhaseEnded(name="import", seconds=time.perf_counter() - began))
    built = build_environment(task)
    match task.spec:
        case TrainSpec():
            return train(task, task.spec, built, events, stopping)
        case RolloutSpec():
            return roll_out(task, task.spec, built, events, stopping)


@contextmanager
def _without_warnings_of_warp() -> Generator[None]:
    """Drops what MJX prints at import when its optional engine is missing, which is no error."""
    with redirect_stdout(io.StringIO()) as said:
        yield
    sys.stdout.writelines(
        f"{line}\n" for line in said.getvalue().splitlines() if not line.startswith("Failed to import ")
    )
