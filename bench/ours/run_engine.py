"""One engine under one body: a few updates of training, then physics alone.

`python -m bench.ours.run_engine FOLDER`; the request is that of bench.ours.run_physics.
"""

from typing import Any

from bench.measure.child import answer
from bench.ours import run_physics, train_ppo


def work(request: dict[str, Any]) -> dict[str, Any]:
    """The answers of bench.ours.train_ppo and bench.ours.run_physics."""
    return {**train_ppo.work(request), **run_physics.work(request)}


if __name__ == "__main__":
    answer(work)
