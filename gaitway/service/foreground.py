"""One training in this very process, without a service: `gaitway run job.json`.

A debugger stops in the training, and Ctrl-C ends it with a checkpoint. A user's model is loaded without the
confinement that a worker gives it.
"""

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from core.environments.mjcf.model import read
from core.environments.task_model import compiled
from core.environments.terms.describe import inventory
from core.errors import Rejected
from core.jobs.spec import JOB_SPEC, JobSpec, TrainSpec
from core.jobs.submission import completed
from core.start_up import start_lean
from worker.compile_cache.local import CACHE
from worker.host.child import device_variables
from worker.protocol import (
    Advanced,
    FileReady,
    Measured,
    Message,
    Noted,
    PhaseBegan,
    PhaseEnded,
    Started,
    Task,
)
from worker.stopping import StopRequest
from worker.training.event_writer import EventWriter

_MODEL = "model"
INTERRUPTED = 130


def run_job(
    document: dict[str, Any], out: Path, *, gpus: int, model: Path | None, resume: Path | None
) -> int:
    """Train, and leave all files in `out`; returns the exit status: 0, or 130 after Ctrl-C.

    gpus: how many of CUDA_VISIBLE_DEVICES to use; 0: the CPU. resume: a checkpoint of the same job. Raises
    GaitwayError for a document that no service would accept, and where the training fails.
    """
    spec = training(document)
    checkpoint = resume and str(resume.resolve(strict=True))
    task = begin(spec, out, device=device_of(gpus), model=model, checkpoint=checkpoint)
    events = Told(Path.cwd(), keeps_rows=checkpoint is not None)
    return _train(task, spec, events)


def begin(
    spec: JobSpec, out: Path, *, device: str, model: Path | None, checkpoint: str | None = None
) -> Task:
    """The task of this process, whose working directory is `out` from now on. model: the user's own."""
    out.mkdir(parents=True, exist_ok=True)
    (out / CACHE).mkdir(exist_ok=True)
    if model is not None:
        shutil.copyfile(model, out / _MODEL)
    os.environ |= device_variables(device)
    os.chdir(out)  # MuJoCo writes its log there, and the programs' cache has a relative path.
    return Task(
        job_id="run",
        attempt=1,
        spec=spec,
        device=device,
        checkpoint=checkpoint,
        model=_MODEL if model else None,
        body=_size() if model else None,
    )


def training(document: dict[str, Any]) -> TrainSpec:
    """The specification of a training. Raises Rejected for any other document."""
    spec = parsed({"kind": "train", **document})
    if not isinstance(spec, TrainSpec):
        raise Rejected("A rollout needs a service; `gaitway run` trains.")
    if spec.source is not None:
        raise Rejected("`resume_from` names a job of a service; here, name a file: --resume CHECKPOINT.")
    return spec


def parsed(document: dict[str, Any]) -> JobSpec:
    """The specification of any job. Raises Rejected where it is not valid."""
    try:
        return completed(JOB_SPEC.validate_json(json.dumps(document)))
    except ValidationError as error:
        raise Rejected("\n".join(_sentences(error))) from None


def _train(task: Task, spec: TrainSpec, events: "Told") -> int:
    stopping = StopRequest()

    def stop(_number: int, _frame: object) -> None:
        if stopping.asked:
            raise KeyboardInterrupt
        stopping.asked = True
        sys.stderr.write("Ending after this update, with a checkpoint (Ctrl-C again: at once).\n")

    before = signal.signal(signal.SIGINT, stop)
    try:
        start_lean()
        # They import JAX, which reads the device's variables.
        from worker.training.built_environment import build_environment
        from worker.training.train import train

        stopped = train(task, spec, build_environment(task), events, stopping)
    finally:
        signal.signal(signal.SIGINT, before)
    return INTERRUPTED if stopped else 0


def device_of(gpus: int) -> str:
    """`cpu`, or the first `gpus` cards, of CUDA_VISIBLE_DEVICES if it is set: `gpu:0,1`. Raises Rejected."""
    if not gpus:
        return "cpu"
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    cards = list(map(str, range(gpus))) if visible is None else [card for card in visible.split(",") if card]
    if len(cards) < gpus:
        raise Rejected(f"CUDA_VISIBLE_DEVICES has {len(cards)} GPUs, but --gpus asks for {gpus}.")
    return "gpu:" + ",".join(cards[:gpus])


def _size() -> Any:
    """The size of the user's model, from which `auto` picks the engine."""
    with read(Path(_MODEL)) as (spec, _):
        return inventory(compiled(spec)).body_size


def _sentences(error: ValidationError) -> Iterator[str]:
    for problem in error.errors():
        yield f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}"


class Told(EventWriter):
    """Prints the messages of a training, and keeps its files and rows of metrics in a folder.

    keeps_rows: whether to add to the metrics of an earlier run there.
    """

    def __init__(self, folder: Path, *, keeps_rows: bool) -> None:
        super().__init__(folder, os.open(os.devnull, os.O_WRONLY))
        self._began = time.perf_counter()
        self._rows = (folder / "metrics.jsonl").open("a" if keeps_rows else "w", buffering=1)
        self._return = ""

    def send(self, message: Message) -> None:
        match message:
            case Started(device=device, engine=engine):
                self._say(f"{engine} on {device}")
                (self.spool / "started.json").write_text(message.model_dump_json(indent=1) + "\n")
            case PhaseBegan(phase=phase):
                self._say(phase)
            case PhaseEnded(name=name, seconds=seconds):
                self._say(f"{name}: {seconds:.1f} s")
            case Measured(values=values):
                self._rows.write(message.model_dump_json(exclude={"type"}) + "\n")
                if (reached := values.get("eval/episode_reward")) is not None:
                    self._return = f"  return {reached:,.1f}"
            case Advanced(step=step, total=total, steps_per_second=rate):
                self._say(f"{step:,}/{total:,} steps  {rate or 0:,.0f}/s{self._return}")
            case FileReady(path=path):
                self._say(f"kept {path}")
            case Noted(text=text):
                self._say(text)
            case _:
                pass

    def keep(self, name: str, content: bytes, *described: Any, **more: Any) -> None:
        """Write a file; one of the same name is replaced, as in a job's record."""
        partial = self.spool / f".{name}"
        partial.write_bytes(content)
        partial.rename(self.spool / name)
        self.hand_over(name, *described, **more)

    def _say(self, text: str) -> None:
        sys.stdout.write(f"{time.perf_counter() - self._began:8.1f} s  {text}\n")
        sys.stdout.flush()
