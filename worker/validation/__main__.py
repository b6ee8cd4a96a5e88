"""`python -m worker.validation WHAT FOLDER HOW LIMITS…`: examine the file in the folder that is called WHAT.

WHAT: `model` or `clips`. Writes `answer.json` there, and again with each new finding. HOW:
`confined`, or `unconfined`, which does without the layers that the kernel refuses.
"""

import os
import sys
from importlib import import_module
from pathlib import Path

from worker.confinement.confinement import Layer, Limits, Unconfined, confine
from worker.host.processes import die_with_parent


def main() -> None:
    what, folder, how = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
    try:
        layers = confine(Limits.of(sys.argv[4:]), folder, strictly=how != "unconfined")
    except Unconfined as error:
        refusal = (
            "This worker's system cannot confine the process that reads models, so it reads none "
            f"({error}). See docs/settings.md, GAITWAY_MODELS."
        )
        _say_plainly(folder, refusal)
        return
    die_with_parent()  # Last: a change of user or privileges would undo it.
    _look(what, folder, layers)


def _say_plainly(folder: Path, refusal: str) -> None:
    """Without any of the service's modules, which this process may not be able or allowed to load."""
    import json

    (folder / "answer.json").write_text(json.dumps({"refusal": refusal}))


def _look(what: str, folder: Path, layers: tuple[Layer, ...]) -> None:
    # Imported only now, so that all they load is confined.
    try:
        from core.errors import GaitwayError
        from worker.validation.answer import ClipsAnswer, ModelAnswer

        reader = import_module(f"worker.validation.{'findings' if what == 'model' else 'clip_findings'}")
    except (ImportError, OSError) as error:
        refusal = (
            f"This worker cannot load the programs that read such files ({error}). That is no fault of the "
            "file: send it again once whoever runs the worker has mended it."
        )
        _say_plainly(folder, refusal)
        return

    kind = ModelAnswer if what == "model" else ClipsAnswer

    def say(answer: ModelAnswer | ClipsAnswer) -> None:
        part = folder / "answer.part"
        part.write_text(answer.model_copy(update={"layers": layers}).model_dump_json())
        os.replace(part, folder / "answer.json")

    try:
        if what == "model":
            for description in reader.findings(folder / "model"):
                say(ModelAnswer(description=description))
        else:
            say(ClipsAnswer(description=reader.clip_findings(folder)))
    except GaitwayError as error:
        # It may quote the file, and not all of that may be text that can be stored.
        said = error.detail.encode(errors="backslashreplace").decode().replace("\0", "\\0")
        say(kind(refusal=said))
    except MemoryError:
        say(kind(refusal="It takes more memory than such a file may."))


if __name__ == "__main__":
    main()
