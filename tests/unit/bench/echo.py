"""A child that does as it is told, for the tests of what starts it."""

import os
import signal
import time
from pathlib import Path
from typing import Any

from bench.measure.child import answer
from bench.measure.turn import Turn


def work(request: dict[str, Any]) -> dict[str, Any]:
    match request["do"]:
        case "fail":
            raise ValueError("a sentence that says why")
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "sleep":
            time.sleep(60)
        case "time":
            with Turn():
                began = time.monotonic()
                time.sleep(0.1)
                return {"timed": [began, time.monotonic()]}
        case _:
            pass
    cache = request["cache"]
    if cache:
        Path(cache, "compiled").touch()
    return {"said": request["do"]}


if __name__ == "__main__":
    answer(work)
