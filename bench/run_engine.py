"""One engine under one body: a few updates of training, then physics alone.

`python -m bench.run_engine ANSWER REQUEST`; the request is that of bench.run_physics.
"""

from typing import Any

from bench import run_physics, train_ours
from bench.child import answer


def work(request: dict[str, Any]) -> dict[str, Any]:
    """The answers of bench.train_ours and bench.run_physics."""
    return {**train_ours.work(request), **run_physics.work(request)}


if __name__ == "__main__":
    answer(work)
