"""`python -m worker.validation FOLDER PARENT_PID HOW LIMITS…`: look at the file `model` in the folder.

Writes `answer.json` there, and again with each thing that it finds out. HOW: `confined`, or `unconfined`:
then what the kernel refuses is done without.
"""

import os
import sys
from pathlib import Path

from worker.confinement.confinement import Layer, Unconfined, confine
from worker.confinement.limits import Limits
from worker.host.parent_death import die_with_parent


def main() -> None:
    folder, parent, how = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    try:
        layers = confine(Limits.of(sys.argv[4:]), folder, strictly=how != "unconfined")
    except Unconfined as error:
        refusal = (
            "This worker's system cannot confine the process that reads models, so it reads none "
            f"({error}). docs/settings.md, GAITWAY_MODELS."
        )
        _say_plainly(folder, refusal)
        return
    die_with_parent(parent)  # After it: what changes a process' rights ends such a promise.
    _look(folder, layers)


def _say_plainly(folder: Path, refusal: str) -> None:
    """Without any of the service's modules: this process is not bound."""
    import json

    (folder / "answer.json").write_text(json.dumps({"refusal": refusal}))


def _look(folder: Path, layers: tuple[Layer, ...]) -> None:
    # Only now: what they load is bound already.
    from core.errors import GaitwayError
    from worker.validation.answer import Answer
    from worker.validation.findings import findings

    def say(answer: Answer) -> None:
        part = folder / "answer.part"
        part.write_text(answer.model_copy(update={"layers": layers}).model_dump_json())
        os.replace(part, folder / "answer.json")

    try:
        for description in findings(folder / "model"):
            say(Answer(description=description))
    except GaitwayError as error:
        say(Answer(refusal=error.detail))
    except MemoryError:
        say(Answer(refusal="The model takes more memory than a model may."))


if __name__ == "__main__":
    main()
