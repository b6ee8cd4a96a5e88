"""`python -m worker.validation FOLDER PARENT_PID LIMITS…`: look at the file `model` in the folder.

Writes `answer.json` there, and again with each thing that it finds out.
"""

import os
import sys
from pathlib import Path

from worker.lifeline import die_with_parent
from worker.validation.limits import Limits, confine


def main() -> None:
    folder, parent = Path(sys.argv[1]), int(sys.argv[2])
    confine(Limits.of(sys.argv[3:]))
    die_with_parent(parent)  # After it: what changes a process' rights ends such a promise.
    # Only now: what they load is bound already.
    from core.errors import GaitwayError
    from worker.validation.answer import Answer
    from worker.validation.findings import findings

    def say(answer: Answer) -> None:
        part = folder / "answer.part"
        part.write_text(answer.model_dump_json())
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
