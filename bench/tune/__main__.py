"""Search for the settings of PPO under which a body reaches a mark soonest: `./run tune ant --minutes 60`.

Each trial trains in a process of its own, on seeds that no bench uses; one that is behind is stopped. What
counts is the worst seed's seconds of training and evaluating. Trials are kept in a file, and another call
goes on from them. At the end the best, and the present settings, are tried on more seeds, and the winner is
written to a file: its `settings` are a job's `algorithm`.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from bench.measure.machine import this_machine
from bench.measure.marks import ON_A_CPU, ON_A_GPU, Mark
from bench.tune.space import first_trial
from bench.tune.task import CONFIRMED, Task
from core.environments import catalog
from core.environments.info import Device
from core.errors import Rejected
from worker.host.device import visible_gpus

_NUM_FINALISTS = 3


def main() -> int:
    given = _arguments()
    task = _task(given)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings(category=optuna.exceptions.ExperimentalWarning, action="ignore"):
        sampler = optuna.samplers.TPESampler(seed=0, multivariate=True, n_startup_trials=12)
    study = optuna.create_study(
        study_name=f"{task.environment} on a {task.device}: {task.mark} within {task.most_s:g} s",
        storage=JournalStorage(JournalFileBackend(str(given.study))),
        sampler=sampler,
        pruner=optuna.pruners.PercentilePruner(50.0, n_startup_trials=6),
        direction="minimize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(first_trial(task.environment, task.device))
    study.optimize(task.worst_seconds, given.trials, timeout=60 * given.minutes, callbacks=[_tell])
    found = _confirmed(task, study)
    if found is None:
        print("No trial reached the mark with every seed: try more --minutes, or more --seconds for a run.")
        return 1
    seconds, settings = found
    out = given.out or Path(f"tuned-{task.environment}-{task.device}.json")
    out.write_text(json.dumps(_record(task, settings, seconds), indent=1) + "\n")
    print(f"At most {max(seconds):.1f} s over {len(seconds)} seeds. Written to {out}.")
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="./run tune", description=__doc__)
    parser.add_argument("environment", help="an environment of the catalog, such as ant")
    parser.add_argument("--mark", type=_mark, metavar="METRIC=VALUE", help="what an evaluation has to reach")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the search, without its end")
    parser.add_argument("--trials", type=int, metavar="N", help="at most so many in this call")
    parser.add_argument("--seconds", type=float, default=40.0, help="at most for a run, compiling apart")
    parser.add_argument("--every-steps", type=int, default=50_000, help="training between two evaluations")
    parser.add_argument("--study", type=Path, default=Path("tune.journal"), help="the file with the trials")
    parser.add_argument("--out", type=Path, help="what is found (tuned-ENVIRONMENT-DEVICE.json)")
    given = parser.parse_args()
    if given.environment not in catalog.BUILT_IN:
        known = ", ".join(catalog.BUILT_IN)
        parser.error(f"There is no environment {given.environment!r}; there are {known}.")
    try:
        catalog.resolve(given.environment, {})
    except Rejected as refusal:
        parser.error(f"{refusal.detail} For such a body a sweep searches (docs/sweeps.md).")
    return given


def _mark(text: str) -> Mark:
    metric, _, least = text.partition("=")
    return Mark(metric, float(least), "")


def _task(given: argparse.Namespace) -> Task:
    device: Device = "gpu" if visible_gpus() else "cpu"
    mark = given.mark or (ON_A_GPU if device == "gpu" else ON_A_CPU).get(given.environment)
    if mark is None:
        raise SystemExit(
            f"Nobody has set a mark for {given.environment!r} on a {device.upper()}: name one, such as "
            "--mark eval/episode_reward=2500."
        )
    return Task(given.environment, device, mark, given.seconds, given.every_steps)


def _tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
    ended = _ended(study)
    value = f"{trial.value:.1f} s" if trial.state == TrialState.COMPLETE else "stopped"
    best = f", the best {ended[0][0]:.1f} s" if ended else ""
    print(f"{time.strftime('%H:%M:%S')} trial {trial.number}: {value}{best}. {trial.params}", flush=True)


def _ended(study: optuna.Study) -> list[tuple[float, int]]:
    """Seconds and numbers of the trials that were not stopped (those have values, too), the best first."""
    return sorted((one.value or 0.0, one.number) for one in study.get_trials(states=[TrialState.COMPLETE]))


def _confirmed(task: Task, study: optuna.Study) -> tuple[list[float], dict[str, Any]] | None:
    """The finalist whose worst seed is soonest at the mark, with the seconds of its seeds."""
    found: list[tuple[list[float], dict[str, Any]]] = []
    for rank, (_, number) in enumerate(_ended(study)):
        # The first trial has the present settings: a winner is to be surer than they are.
        if rank >= _NUM_FINALISTS and number != 0:
            continue
        settings = study.trials[number].user_attrs["settings"]
        seconds = [task.seconds(settings, seed) for seed in CONFIRMED]
        print(f"trial {number} again: {', '.join(f'{one:.1f} s' for one in seconds)}", flush=True)
        if max(seconds) <= task.most_s:
            found.append((seconds, settings))
    return min(found, key=lambda one: max(one[0]), default=None)


def _record(task: Task, settings: dict[str, Any], seconds: Sequence[float]) -> dict[str, Any]:
    """What is needed to find them again."""
    return {
        "settings": {"kind": "ppo", **settings},
        "command": " ".join(["./run tune", *sys.argv[1:]]),
        "mark": task.mark.in_request(),
        "seconds": [round(one, 1) for one in seconds],
        "machine": this_machine().model_dump(),
    }


if __name__ == "__main__":
    sys.exit(main())
