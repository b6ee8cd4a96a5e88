"""Search for the settings of PPO under which a body reaches a mark soonest: `./run tune ant --minutes 60`.

Each trial trains in a process of its own, on seeds that no bench uses; one that is behind is stopped. What
counts is the worst seed's seconds of training and evaluating. Trials are kept in a file, and another call
goes on from them. At the end the best are tried on more seeds, and the winner is written where the catalog's
tuned values come from: core/algorithms/ppo/tuned/found/.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from bench.measure import requests
from bench.measure.machine import Machine, this_machine
from bench.measure.marks import NUM_EPISODES, ON_A_CPU, ON_A_GPU
from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog
from core.environments.info import Device
from core.errors import Rejected
from worker.host.device import visible_gpus

# Benches use seeds from 0 on.
_SEARCHED, _CONFIRMED = range(1_001, 1_003), range(2_001, 2_006)
_NUM_FINALISTS = 3
_FOUND = Path("core/algorithms/ppo/tuned/found")
_LAYERS: Mapping[str, list[int]] = {
    "1x64": [64],
    "2x32": [32] * 2,
    "2x64": [64] * 2,
    "2x128": [128] * 2,
    "3x64": [64] * 3,
    "4x32": [32] * 4,
    "3x256": [256] * 3,
    "5x256": [256] * 5,
}


def main() -> int:
    given = _arguments()
    task = _Task.of(given)
    study = optuna.create_study(
        study_name=f"{given.environment}, {task.device}, {task.mark}, {given.seconds:g} s",
        storage=JournalStorage(JournalFileBackend(str(given.study))),
        sampler=optuna.samplers.TPESampler(
            seed=0, multivariate=True, constant_liar=True, n_startup_trials=12
        ),
        pruner=optuna.pruners.PercentilePruner(50.0, n_startup_trials=6),
        direction="minimize",
        load_if_exists=True,
    )
    if not study.trials:
        study.enqueue_trial(_as_trial(task))
    study.optimize(task.seconds_to_the_mark, timeout=60 * given.minutes, callbacks=[_tell])
    best = _confirmed(task, study)
    if best is None:
        print("No trial reached the mark with every seed. Give it more --minutes, or more --seconds a trial.")
        return 1
    seconds, settings = best
    path = _store(task, settings, seconds)
    print(f"{max(seconds):.1f} s with the worst of {len(seconds)} seeds. Written to {path}.")
    return 0


@dataclass(frozen=True)
class _Task:
    """most_s: seconds of training and evaluating for one run. every_steps: from evaluation to evaluation."""

    environment: str
    device: Device
    mark: dict[str, Any]
    most_s: float
    every_steps: int

    @classmethod
    def of(cls, given: argparse.Namespace) -> "_Task":
        device: Device = "gpu" if visible_gpus() else "cpu"
        marks = ON_A_GPU if device == "gpu" else ON_A_CPU
        if given.mark:
            metric, least = given.mark.split("=")
            mark = {"metric": metric, "least": float(least)}
        elif given.environment in marks:
            mark = marks[given.environment].in_request()
        else:
            raise SystemExit(
                f"Nobody set a mark for {given.environment!r} on a {device.upper()}: name one, such as "
                "--mark eval/forward_speed=1.0."
            )
        return cls(given.environment, device, mark, given.seconds, given.every_steps)

    def seconds_to_the_mark(self, trial: optuna.Trial) -> float:
        """With the worst of the seeds. One that does not come there counts as longer than it had."""
        settings = _settings(trial)
        try:
            requests.resolved(self.device, self.environment, settings)
        except Rejected as refusal:
            raise optuna.TrialPruned(refusal.detail) from None
        trial.set_user_attr("settings", settings)
        return max(
            self._seconds(settings, seed, trial if seed == _SEARCHED[0] else None) for seed in _SEARCHED
        )

    def _seconds(self, settings: dict[str, Any], seed: int, trial: optuna.Trial | None) -> float:
        best, at_work, reported = 0.0, 0.0, -1
        least = self.mark["least"]
        with self._training(settings, seed) as evaluations:
            for _, value, at_work in evaluations:
                best = max(best, value)
                if value >= least:
                    return at_work
                # The pruner compares trials at the same tenth of their time.
                tenth = int(10 * at_work / self.most_s)
                if trial is not None and tenth > reported:
                    trial.report(-best, tenth)
                    reported = tenth
                    if trial.should_prune():
                        raise optuna.TrialPruned
                if at_work > self.most_s:
                    break
        return self.most_s * (2.0 - min(1.0, max(0.0, best / least)))

    @contextmanager
    def _training(self, settings: dict[str, Any], seed: int) -> Iterator[Iterator[Sequence[float]]]:
        """The evaluations of a run in a process of its own, which ends with the block."""
        budget = 1_000 * self.every_steps
        given = {**settings, "num_timesteps": budget, "num_evals": 1_000, "num_eval_envs": NUM_EPISODES}
        engine = requests.engine(self.device, self.environment, given)
        request = requests.ours(self.device, self.environment, engine, given, seed=seed)
        with tempfile.TemporaryDirectory(prefix="gaitway-tune-") as folder:
            cache = Path(tempfile.gettempdir(), "gaitway-tune-cache")
            content = {**request, "mark": self.mark, "cache": str(cache)}
            Path(folder, "request.json").write_text(json.dumps(content))
            process = subprocess.Popen(
                [sys.executable, "-m", "bench.ours.reach_mark", folder],
                env=dict(os.environ) if self.device == "gpu" else {**os.environ, "JAX_PLATFORMS": "cpu"},
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            try:
                yield _lines(process)
            finally:
                process.kill()
                process.wait()

    def confirmed_seconds(self, settings: dict[str, Any]) -> list[float]:
        """By seed, those that take part in no search."""
        return [self._seconds(settings, seed, None) for seed in _CONFIRMED]


def _lines(process: "subprocess.Popen[str]") -> Iterator[Sequence[float]]:
    assert process.stdout is not None  # noqa: S101 - it is a pipe
    for line in process.stdout:
        if line.startswith("["):
            yield json.loads(line)


def _settings(trial: optuna.Trial) -> dict[str, Any]:
    """Hyperparameters by name. The environments of an update divide its unrolls, as PPO asks."""
    num_envs = 2 ** trial.suggest_int("log2_num_envs", 5, 11)
    unrolls = num_envs * 2 ** trial.suggest_int("log2_unrolls_per_env", 0, 3)
    num_minibatches = min(unrolls, 2 ** trial.suggest_int("log2_num_minibatches", 1, 5))
    is_adaptive = trial.suggest_categorical("adaptive", [False, True])
    return {
        "num_envs": num_envs,
        "unroll_length": trial.suggest_int("unroll_length", 4, 20),
        "num_minibatches": num_minibatches,
        "batch_size": unrolls // num_minibatches,
        "num_updates_per_batch": trial.suggest_int("num_updates_per_batch", 1, 8),
        "learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
        "learning_rate_schedule": "ADAPTIVE_KL" if is_adaptive else "NONE",
        "entropy_cost": trial.suggest_float("entropy_cost", 1e-5, 3e-2, log=True),
        "discounting": 1.0 - trial.suggest_float("1 - discounting", 0.005, 0.1, log=True),
        "gae_lambda": trial.suggest_float("gae_lambda", 0.85, 0.99),
        "clipping_epsilon": trial.suggest_float("clipping_epsilon", 0.1, 0.4),
        "reward_scaling": trial.suggest_float("reward_scaling", 0.03, 10.0, log=True),
        "policy_hidden_layer_sizes": _LAYERS[trial.suggest_categorical("policy", ["2x32", "2x64", "4x32"])],
        "value_hidden_layer_sizes": _LAYERS[trial.suggest_categorical("value", [*_LAYERS])],
        "activation": trial.suggest_categorical("activation", ["swish", "tanh", "elu"]),
        "bootstrap_on_timeout": True,
        "normalize_observations": True,
    }


def _as_trial(task: _Task) -> dict[str, Any]:
    """The present settings, as near as the search's space comes."""
    info = catalog.find(task.environment)
    has = resolve(PPOSpec(), info, task.device)
    unrolls = has.batch_size * has.num_minibatches
    return {
        "log2_num_envs": min(11, has.num_envs.bit_length() - 1),
        "log2_unrolls_per_env": min(3, max(0, (unrolls // has.num_envs).bit_length() - 1)),
        "log2_num_minibatches": min(5, has.num_minibatches.bit_length() - 1),
        "unroll_length": has.unroll_length,
        "num_updates_per_batch": has.num_updates_per_batch,
        "learning_rate": has.learning_rate,
        "adaptive": False,
        "entropy_cost": max(1e-5, has.entropy_cost),
        "1 - discounting": 1.0 - has.discounting,
        "gae_lambda": has.gae_lambda,
        "clipping_epsilon": has.clipping_epsilon,
        "reward_scaling": has.reward_scaling,
        "policy": "4x32",
        "value": "2x64",
        "activation": has.activation,
    }


def _confirmed(task: _Task, study: optuna.Study) -> tuple[list[float], dict[str, Any]] | None:
    """The finalist whose worst seed is soonest there, with the seconds of its seeds."""
    ended = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    ended.sort(key=lambda trial: trial.value or 0.0)
    found: list[tuple[list[float], dict[str, Any]]] = []
    for trial in ended[:_NUM_FINALISTS]:
        settings = trial.user_attrs["settings"]
        seconds = task.confirmed_seconds(settings)
        print(f"trial {trial.number}: " + ", ".join(f"{one:.1f} s" for one in seconds), flush=True)
        if max(seconds) <= task.most_s:
            found.append((seconds, settings))
    return min(found, key=lambda one: max(one[0]), default=None)


def _store(task: _Task, settings: dict[str, Any], seconds: Sequence[float]) -> Path:
    """As `core.algorithms.ppo.tuned.found` reads it."""
    machine: Machine = this_machine()
    path = _FOUND / f"{task.environment}_{task.device}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    record = {
        "settings": settings,
        "command": " ".join(["./run tune", *sys.argv[1:]]),
        "mark": task.mark,
        "seconds": [round(one, 1) for one in seconds],
        "machine": machine.model_dump(),
    }
    path.write_text(json.dumps(record, indent=1) + "\n")
    return path


def _tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
    value = "stopped" if trial.value is None else f"{trial.value:.1f} s"
    complete = [one.value for one in study.trials if one.value is not None]
    best = f"; the best {min(complete):.1f} s" if complete else ""
    print(f"{time.strftime('%H:%M:%S')} trial {trial.number}: {value}{best} {trial.params}", flush=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="./run tune", description=__doc__)
    parser.add_argument("environment", help="an environment of the catalog, such as ant")
    parser.add_argument("--mark", metavar="METRIC=VALUE", help="what an evaluation has to reach")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the search, without its end")
    parser.add_argument("--seconds", type=float, default=40.0, help="at most for a run, compiling apart")
    parser.add_argument("--every-steps", type=int, default=50_000, help="training between two evaluations")
    parser.add_argument("--study", type=Path, default=Path("tune.journal"), help="the file with the trials")
    given = parser.parse_args()
    if given.environment not in catalog.BUILT_IN:
        parser.error(
            f"There is no environment {given.environment!r}; there are {', '.join(catalog.BUILT_IN)}."
        )
    return given


if __name__ == "__main__":
    sys.exit(main())
