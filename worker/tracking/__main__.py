"""`python -m worker.tracking live`, to which its parent sends items; or `... write DOCUMENT`.

Prints `{"opened": true}` and `{"note": "..."}` as JSON lines. Exit status 0: everything is done.
"""

import json
import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any

from worker.host.processes import die_with_parent
from worker.tracking.board import lines_by_step
from worker.tracking.items import ITEM, About, EndItem, MetricsItem, WriteUp


def main(arguments: list[str]) -> int:
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Libraries may print anything to stdout; our messages leave by a copy of it.
    words = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    match arguments:
        case ["live"]:
            return live(sys.stdin.buffer, words)
        case ["write", document]:
            return write(WriteUp.model_validate_json(Path(document).read_bytes()), words)
        case _:
            return 2


def live(items: IO[bytes], words: IO[str]) -> int:
    """Send each item to the server as it comes."""
    about = About.model_validate_json(items.readline())
    try:
        from worker.tracking.run import log_item, open_run

        run = open_run(about, "online")
        say(words, opened=True)
        for line in items:
            item = ITEM.validate_json(line)
            log_item(run, item)
            if isinstance(item, EndItem):
                return 0
    except Exception as error:  # Whatever it is, the job continues.
        say(words, note=f"Weights & Biases accepted no more of this run: {reason(error)}")
    return 1


def write(task: WriteUp, words: IO[str]) -> int:
    """Write each requested file; one that cannot be written is a note, and the others are still written."""
    wanted: list[tuple[str, Callable[[], None]]] = [
        ("event file for TensorBoard", partial(write_scalars, task.measurements, task.events)),
        ("picture of the episodes", partial(write_curve, task.measurements, task.curve)),
    ]
    if task.about is not None and task.archive is not None:
        wanted.append(("file for `wandb sync`", partial(write_archive, task, task.about, task.archive)))
    status = 0
    for what, write_it in wanted:
        try:
            write_it()
        except Exception as error:  # Whatever it is, the job continues.
            say(words, note=f"There is no {what}: {reason(error)}")
            status = 1
    return status


def write_scalars(measurements: Path, path: Path) -> None:
    """The event file for TensorBoard."""
    from worker.tracking.board import write_events

    write_events(measurements, path)


def write_curve(measurements: Path, path: Path) -> None:
    """Return and epsilon by episode, for a run that has them."""
    with measurements.open() as lines:
        has_one = any("training/epsilon" in json.loads(line)["values"] for line in lines)
    if has_one:
        from core.rendering.plots.episodes import from_metrics  # Loads NumPy, and then matplotlib.
        from core.rendering.plots.style import save

        with measurements.open() as lines:
            figure = from_metrics([json.loads(line) for line in lines])
        if figure is not None:
            save(figure, path)


def write_archive(task: WriteUp, about: About, path: Path) -> None:
    """The whole job as an offline run."""
    from worker.tracking.run import archive, log_archived_policy, log_item, open_run

    run = open_run(about, "offline")
    for line in lines_by_step(task.measurements):
        log_item(run, MetricsItem.model_validate_json(line))
    for film in task.films:
        log_item(run, film)
    for policy in task.policies:
        log_archived_policy(run, policy)
    log_item(run, EndItem(exit_code=task.exit_code))
    archive(about.folder, path)


def reason(error: Exception) -> str:
    """The error in one line, without the key, which a library might quote."""
    text = next(iter(str(error).splitlines()), "")[:300]
    if key := os.environ.get("WANDB_API_KEY"):
        text = text.replace(key, "…")
    return f"{type(error).__name__}: {text}"


def say(words: IO[str], **word: Any) -> None:
    words.write(json.dumps(word) + "\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
