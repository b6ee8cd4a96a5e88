"""What a trial is measured by: the seconds until its settings bring a body to a mark."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna

from bench.measure import requests
from bench.measure.marks import NUM_EPISODES, Mark
from bench.tune.space import settings_of
from core.environments.info import Device
from core.errors import JobFailed, Rejected

# Benches use seeds from 0 on.
SEARCHED, CONFIRMED = range(1_001, 1_003), range(2_001, 2_006)
_NUM_EVALS = 1_000


@dataclass(frozen=True)
class Task:
    """most_s: seconds of training and evaluating for one run. every_steps: from evaluation to evaluation.

    module: what a run's process is, called like bench.ours.reach_mark.
    """

    environment: str
    device: Device
    mark: Mark
    most_s: float
    every_steps: int
    module: str = "bench.ours.reach_mark"

    def worst_seconds(self, trial: optuna.Trial) -> float:
        """To the mark with the worst of the seeds. One that does not come there counts as longer than it had.

        Raises TrialPruned if the trial is behind others, or its settings do not go together.
        """
        settings = settings_of(trial)
        try:
            requests.resolved(self.device, self.environment, settings)
        except Rejected as refusal:
            raise optuna.TrialPruned(refusal.detail) from None
        trial.set_user_attr("settings", settings)
        first, *others = SEARCHED
        seconds = [self.seconds(settings, first, trial)]
        if seconds[0] <= self.most_s:
            seconds += [self.seconds(settings, seed) for seed in others]
        return max(seconds)

    def seconds(self, settings: dict[str, Any], seed: int, trial: optuna.Trial | None = None) -> float:
        """Of training and evaluating, until the mark. trial: the one that may be stopped for it."""
        best, tenths = 0.0, 0
        with self._training(settings, seed) as evaluations:
            for _, value, at_work in evaluations:
                best = max(best, value)
                if value >= self.mark.least:
                    return at_work
                if at_work > self.most_s:
                    break
                # Trials are compared at the same tenths of their time.
                if trial is not None and 10 * at_work / self.most_s >= tenths + 1:
                    tenths = int(10 * at_work / self.most_s)
                    trial.report(-best, tenths)
                    if trial.should_prune():
                        raise optuna.TrialPruned
        return self.most_s * (2.0 - max(0.0, best / self.mark.least))

    @contextmanager
    def _training(self, settings: dict[str, Any], seed: int) -> Iterator[Iterator[Sequence[float]]]:
        """[steps, value, seconds at work] of each evaluation of a run, which ends with the block.

        Its budget is never spent, so a learning rate that falls with the budget hardly does.
        """
        budget = {"num_timesteps": _NUM_EVALS * self.every_steps, "num_evals": _NUM_EVALS}
        given = {**settings, **budget, "num_eval_envs": NUM_EPISODES}
        engine = requests.engine(self.device, self.environment, given)
        request = requests.ours(self.device, self.environment, engine, given, seed=seed)
        request |= {"mark": self.mark.in_request(), "cache": None}
        with tempfile.TemporaryDirectory(prefix="gaitway-tune-") as folder:
            Path(folder, "request.json").write_text(json.dumps(request))
            with (
                Path(folder, "log").open("w") as log,
                subprocess.Popen(
                    [sys.executable, "-m", self.module, folder],
                    env={**os.environ, **({} if self.device == "gpu" else {"JAX_PLATFORMS": "cpu"})},
                    stdout=subprocess.PIPE,
                    stderr=log,
                    text=True,
                ) as process,
            ):
                try:
                    yield _lines(process, Path(folder, "log"))
                finally:
                    process.kill()


def _lines(process: "subprocess.Popen[str]", log: Path) -> Iterator[Sequence[float]]:
    """Raises RuntimeError with the end of its log if the process fails; a run that diverges just ends."""
    if process.stdout is None:
        raise ValueError("The process has no pipe.")
    for line in process.stdout:
        if line.startswith("["):
            yield json.loads(line)
    if process.wait() and JobFailed.__name__ not in (said := log.read_text()):
        raise RuntimeError(said[-2000:])
