"""A job without the service: its training process alone, on a machine that has no stores.

`python -m bench.run_job FOLDER SPEC.json [--model FILE] [--gpu [N]] [--set PATH=VALUE]` fills FOLDER while
the job runs, so that an interrupted job leaves what it has so far: its files, `metrics.jsonl`, and `job.json`
with what the process reported about itself; `curve.png` comes at the end. The video is drawn as in the
service. `bench/jobs` and `examples` have jobs.
"""

import argparse
import json
import os
import shutil
import threading
import time
from pathlib import Path
from typing import Any

from core.environments.mjcf.describe import inventory
from core.environments.mjcf.model import compiled, read
from core.jobs.spec import JOB_SPEC, TrainSpec
from core.physics.availability import BodySize
from gaitway.cli.submit import assigned
from gaitway.plots import learning_curve
from worker.compile_cache.local import CACHE
from worker.host.child import TRAINING, TrainingProcess
from worker.protocol import Advanced, Failed, Finished, Measured, Message, Noted, PhaseEnded, Started, Task


def main() -> None:
    """Run the job to its end. Exits with 1 if it fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("spec", type=Path)
    parser.add_argument(
        "--gpu",
        type=int,
        nargs="?",
        const=1,
        metavar="N",
        help="on the first GPU, or the first N, of CUDA_VISIBLE_DEVICES if it is set; else on the CPU",
    )
    parser.add_argument("--model", type=Path, help="the user's own model that the job names, as sent")
    parser.add_argument(
        "--set",
        dest="assignments",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        help="another value of a field, as in `gaitway submit`: seed=1, algorithm.num_timesteps=200000",
    )
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    document = json.loads(arguments.spec.read_bytes())
    for text in arguments.assignments:
        assigned(document, text)
    spec = JOB_SPEC.validate_json(json.dumps(document))
    device = gpus(arguments.gpu) if arguments.gpu else "cpu"
    (folder / CACHE).mkdir(exist_ok=True)  # Of a user's model, the process writes nowhere else.
    if arguments.model:
        shutil.copyfile(arguments.model, folder / "model")  # The process may read no other file.
    model = "model" if arguments.model else None
    body = size_of(folder / "model") if arguments.model else None
    task = Task(job_id="bench", attempt=1, spec=spec, device=device, model=model, body=body)
    (folder / "task.json").write_text(task.model_dump_json())
    began = time.perf_counter()
    process = TrainingProcess(TRAINING, folder, folder / "data", device, [])
    # Read in parallel to the messages: a full pipe would stop the process.
    printing = threading.Thread(target=lambda: print(*process.lines(), sep="\n"))
    printing.start()
    story = Story(folder, began)
    for message in process.messages():
        story.take(message)
    printing.join()
    if isinstance(spec, TrainSpec) and story.rows:
        learning_curve(story.rows, folder / "curve.png", title=arguments.spec.stem)
    raise SystemExit(0 if process.poll(60) == 0 and "failed" not in story.told else 1)


def size_of(model: Path) -> BodySize | None:
    """Of a user's own model, as sent."""
    with read(model) as (spec, _):
        return inventory(compiled(spec)).body_size


def gpus(number: int) -> str:
    """The first so many cards, of CUDA_VISIBLE_DEVICES if it is set: `gpu:0,1`. Exits if that has fewer."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    cards = list(map(str, range(number))) if visible is None else [one for one in visible.split(",") if one]
    if len(cards) < number:
        raise SystemExit(f"CUDA_VISIBLE_DEVICES has {len(cards)} GPUs; {number} are asked for.")
    return "gpu:" + ",".join(cards[:number])


class Story:
    """Prints and stores the process's messages as they come. folder: files of an earlier job are deleted."""

    def __init__(self, folder: Path, began: float) -> None:
        self.rows: list[dict[str, Any]] = []
        self.told: dict[str, Any] = {"phases": {}, "notes": []}
        self._metrics, self._job = folder / "metrics.jsonl", folder / "job.json"
        self._began = began
        self._metrics.write_text("")

    def take(self, message: Message) -> None:
        """Print and store one message."""
        wall_s = round(time.perf_counter() - self._began, 2)
        match message:
            case Started(device=device, engine=engine, details=details):
                self.told |= {"device": device, "engine": engine, "details": details}
            case PhaseEnded(name=name, seconds=seconds):
                self.told["phases"][name] = seconds
            case Measured(step=step, values=values):
                self.rows.append({"step": step, "values": values, "wall_s": wall_s})
                with self._metrics.open("a") as file:
                    file.write(json.dumps(self.rows[-1]) + "\n")
            case Advanced(step=step, total=total, steps_per_second=rate):
                self.told |= {"step": step, "total": total}
                print(f"{wall_s:8.1f} s  {step:,}/{total:,}  {rate or 0:,.0f}/s", flush=True)
            case Noted(text=text):
                self.told["notes"].append(text)
            case Failed(message=text):
                self.told["failed"] = text
                print(text, flush=True)
            case Finished():
                self.told["wall_s"] = wall_s
            case _:
                return
        self._job.write_text(json.dumps(self.told, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
