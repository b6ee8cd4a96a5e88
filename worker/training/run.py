"""Runs a task and reports how it ended, whatever happens: an exception becomes its last message."""

import io
import re
import sys
import time
import traceback
from collections.abc import Generator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

import structlog

from core.errors import GaitwayError, JobFailed
from core.jobs.spec import RolloutSpec, TrainSpec
from core.reasons import Reason
from core.telemetry import configure_logging
from worker.host.disk import is_full, what_to_do
from worker.host.memory import LESS_MEMORY
from worker.protocol import Failed, Finished, PhaseEnded, Task
from worker.stopping import StopRequest
from worker.training.event_writer import EventWriter

log = structlog.get_logger()

# XLA's word, and Warp's.
_DEVICE_MEMORY = re.compile(
    r"RESOURCE_EXHAUSTED|CUDA_ERROR_OUT_OF_MEMORY|Failed to allocate \d+ bytes on device"
)
# CUDA's words, as XLA and Warp pass them on, and those of the driver.
_DEVICE_FAILED = re.compile(
    r"CUDA_ERROR_|Warp CUDA error|CUDA error|\bECC\b|device is lost|fallen off the bus|\bXid\b", re.IGNORECASE
)
# The library by which GPUs speak to each other.
_NOT_TOGETHER = re.compile("nccl", re.IGNORECASE)


def failure(error: Exception, device: str, *, in_gang: bool = False, gpu_part: float | None = None) -> Failed:
    """Blames memory, device or disk if it was one of these. device: `cpu`, or the worker's GPUs.

    in_gang: whether other hosts have the job, too; GPUs then fail together when another host is lost.
    gpu_part: of the GPU's memory, if the job shares the GPU.
    """
    if is_full(error):
        return Failed(reason=Reason.STORAGE_UNAVAILABLE, message=what_to_do())
    text = f"{type(error).__name__}: {error}"
    line = text.splitlines()[0][:500]
    has_no_memory = _DEVICE_MEMORY.search(text) is not None
    # Native physics reports a lack of memory through XLA, and by Python's name for it.
    if "MemoryError" in text or (has_no_memory and device == "cpu"):
        return Failed(
            reason=Reason.OUT_OF_HOST_MEMORY, message=f"The worker's memory ran out. {LESS_MEMORY} {line}"
        )
    if has_no_memory:
        message = f"The memory of {device} ran out. {LESS_MEMORY} {line}"
        if gpu_part is not None:
            message = (
                f"The job shares {device}, and its {gpu_part:.0%} of the memory ran out. Ask for more by "
                f"`gpu_memory_gib`, or leave out `share_gpu`. {LESS_MEMORY} {line}"
            )
        return Failed(reason=Reason.OUT_OF_MEMORY, message=message)
    is_failed = _DEVICE_FAILED.search(text) or (not in_gang and _NOT_TOGETHER.search(text))
    if device != "cpu" and is_failed:
        return Failed(reason=Reason.DEVICE_FAILED, message=f"The device {device} reported an error. {line}")
    return Failed(reason=Reason.TRAINING_CRASHED, message=f"{line} (the log has the traceback)")


def run(spool: Path, events_fd: int, stopping: StopRequest) -> int:
    """Run the task in the spool; returns the exit status. The last message is Finished or Failed."""
    events, device, in_gang, gpu_part = EventWriter(spool, events_fd), "cpu", False, None
    try:
        task = Task.model_validate_json((spool / "task.json").read_bytes())
        device, in_gang, gpu_part = task.device, task.gang is not None, task.gpu_part
        configure_logging(
            "training", job_id=task.job_id, attempt=task.attempt, correlation_id=task.correlation_id
        )
        log.info("training_process_began", device=device)
        stopped = _dispatch(task, events, stopping)
    except JobFailed as error:
        events.send(Failed(reason=error.reason, message=error.detail))
    except GaitwayError as error:
        events.send(Failed(reason=Reason.TRAINING_CRASHED, message=error.detail))
    except Exception as error:  # Every way to end must reach the job's record.
        traceback.print_exc()
        events.send(failure(error, device, in_gang=in_gang, gpu_part=gpu_part))
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
        from worker.training.train import follow, train

    events.send(PhaseEnded(name="import", seconds=time.perf_counter() - began))
    built = build_environment(task)
    match task.spec:
        case TrainSpec() if task.gang is not None and task.gang.rank > 0:
            follow(task, task.spec, built, events)
            return False
        case TrainSpec():
            return train(task, task.spec, built, events, stopping)
        case RolloutSpec():
            return roll_out(task, task.spec, built, events, stopping)


@contextmanager
def _without_warnings_of_warp() -> Generator[None]:
    """Drops what MJX prints at import when its optional engine is missing, which is no error."""
    with redirect_stdout(io.StringIO()) as output:
        yield
    sys.stdout.writelines(
        f"{line}\n" for line in output.getvalue().splitlines() if not line.startswith("Failed to import ")
    )
