"""`python -m worker.validation FOLDER HOW LIMITS…`: examine the file `model` in the folder.

Writes `answer.json` there, and again with each new finding. HOW: `confined`, or `unconfined`, which does
without the layers that the kernel refuses.
"""

import os
import sys
from pathlib import Path

from worker.confinement.confinement import Layer, Limits, Unconfined, confine
from worker.host.processes import die_with_parent


def main() -> None:
    folder, how = Path(sys.argv[1]), sys.argv[2]
    try:
        layers = confine(Limits.of(sys.argv[3:]), folder, strictly=how != "unconfined")
    except Unconfined as error:
        refusal = (
            "This worker's system cannot confine the process that reads models, so it reads none "
            f"({error}). See docs/settings.md, GAITWAY_MODELS."
        )
        _say_plainly(folder, refusal)
        return
    die_with_parent()  # Last: a change of user or privileges would undo it.
    _look(folder, layers)


def _say_plainly(folder: Path, refusal: str) -> None:
    """Without any of the service's modules: this process is not confined."""
    import json

    (folder / "answer.json").write_text(json.dumps({"refusal": refusal}))


def _look(folder: Path, layers: tuple[Layer, ...]) -> None:
    # Imported only now, so that all they load is confined.
    from core.errors import GaitwayError
    from worker.validation.answer import ModelAnswer
    from worker.validation.findings import findings

    def say(answer: ModelAnswer) -> None:
        part = folder / "answer.part"
        part.write_text(answer.model_copy(update={"layers": layers}).model_dump_json())
        os.replace(part, folder / "answer.json")

    try:
        for description in findings(folder / "model"):
            say(ModelAnswer(description=description))
    except GaitwayError as error:
        say(ModelAnswer(refusal=error.detail))
    except MemoryError:
        say(ModelAnswer(refusal="The model takes more memory than a model may."))


if __name__ == "__main__":
    main()
