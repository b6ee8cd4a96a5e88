"""From a task to its last word, whatever happens on the way."""

import io
import sys
import time
import traceback
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from core.errors import GaitwayError, JobFailed
from core.jobs.spec import RolloutSpec, TrainSpec
from core.jobs.status import Reason
from worker.protocol import Failed, Finished, PhaseEnded, Task
from worker.training.channel import EventWriter
from worker.training.failure import failure
from worker.training.stopping import Stopping


def run(spool: Path, events_fd: int, stopping: Stopping) -> int:
    """Do the task in the spool; the process' exit status. The last message is Finished or Failed."""
    channel, device = EventWriter(spool, events_fd), "cpu"
    try:
        task = Task.model_validate_json((spool / "task.json").read_bytes())
        device = task.device
        stopped = _dispatch(task, channel, stopping)
    except JobFailed as error:
        channel.send(Failed(reason=Reason(error.reason), message=error.detail))
    except GaitwayError as error:
        channel.send(Failed(reason=Reason.TRAINING_CRASHED, message=error.detail))
    except Exception as error:  # Every way to end must reach the job's record.
        traceback.print_exc()
        channel.send(failure(error, device))
    else:
        channel.send(Finished(stopped=stopped))
        return 0
    return 1


def _dispatch(task: Task, channel: EventWriter, stopping: Stopping) -> bool:
    """Whether a stop cut it short."""
    began = time.perf_counter()
    with _without_warnings_of_warp():
        from worker.training.body import load_body
        from worker.training.roll_out import roll_out
        from worker.training.train import train

    channel.send(PhaseEnded(name="import", seconds=time.perf_counter() - began))
    body = load_body(task)
    match task.spec:
        case TrainSpec():
            return train(task, task.spec, body, channel, stopping)
        case RolloutSpec():
            return roll_out(task, task.spec, body, channel, stopping)


@contextmanager
def _without_warnings_of_warp() -> Generator[None]:
    """MJX prints at import that its optional engine is missing; whoever reads the log would wonder."""
    with redirect_stdout(io.StringIO()) as said:
        yield
    sys.stdout.writelines(
        f"{line}\n" for line in said.getvalue().splitlines() if not line.startswith("Failed to import ")
    )
