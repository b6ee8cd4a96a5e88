"""The battery of a policy that follows clips: every clip from many moments, in C MuJoCo, on the CPU."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from core.algorithms.battery.result import (
    MOST_NUMBERS,
    BatteryResult,
    ClipErrors,
    ClipResult,
    OverTime,
    Table,
    judged_by_clips,
)
from core.algorithms.battery.run import on_the_cpu
from core.algorithms.battery.spec import BatterySpec, battery_options
from core.algorithms.following import BINS, ErrorsOverTime, FollowingResult, followed
from core.algorithms.trained_policy import TrainedPolicy
from core.environments.task import TaskEnv
from core.environments.terms.task import TaskOptions

# Episodes run side by side: of more clips than this, each has one.
_MOST_EPISODES = 2048


class ClipBattery:
    """See `Battery`, whose manner this has. Raises ValueError if the task has no reference."""

    def __init__(
        self,
        make: Callable[[TaskOptions], TaskEnv],
        options: TaskOptions,
        policy: TrainedPolicy,
        spec: BatterySpec,
    ) -> None:
        with on_the_cpu():
            self._environment = make(battery_options(options, spec))
        self._policy, self._spec = policy, spec
        self._rows = spread(self._environment, spec.starts)

    def run(
        self, parameters: Any, *, seed: int, is_stopped: Callable[[], bool] = lambda: False
    ) -> BatteryResult | None:
        """The result of the policy with these parameters; None if it was stopped."""
        began = time.perf_counter()
        policy = replace(self._policy, parameters=parameters)
        found = followed(self._environment, policy, self._rows, seed=seed, is_stopped=is_stopped)
        if is_stopped():
            return None
        whole, clips, over_time = found
        rows = [_row(name, one) for name, one in clips.items()]
        passed, criteria = judged_by_clips(_row("", whole), self._spec.bounds)
        return BatteryResult(
            passed=passed,
            criteria=criteria,
            commands=[],
            clips=rows,
            over_time=self._over_time(rows, over_time),
            spec=self._spec,
            seed=seed,
            engine="native",
            legs=[],
            took_s=time.perf_counter() - began,
        )

    def _over_time(self, rows: list[ClipResult], found: Mapping[str, ErrorsOverTime]) -> OverTime:
        joints, bodies = self._environment.compared
        most = max(1, MOST_NUMBERS // (BINS * (len(joints) + len(bodies))))
        worst = sorted(rows, key=lambda row: (row.reached, -row.joint_error))[:most]
        kept = {row.clip for row in worst}
        seconds = {one.name: (one.num_frames - 1) * self._environment.dt for one in self._environment.clips}
        return OverTime(
            joints=[*joints],
            bodies=[*bodies],
            clips=[
                ClipErrors(
                    clip=name, seconds=seconds[name], joints=_table(one.joints), bodies=_table(one.bodies)
                )
                for name, one in found.items()
                if name in kept
            ],
        )


def spread(environment: TaskEnv, starts: int) -> np.ndarray:
    """Rows of the reference's frames: of each clip so many at equal distances, as far as it has frames, from
    its first to the last but one."""
    if environment.playback is None:
        raise ValueError("The task follows no reference.")
    frames = environment.playback.frames
    most = max(1, min(starts, _MOST_EPISODES // len(frames.starts)))
    rows = [
        first + np.unique(np.linspace(0, length - 2, most).round().astype(int))
        for first, length in zip(frames.starts, frames.lengths, strict=True)
    ]
    return np.concatenate(rows).astype(np.int32)


def _table(means: np.ndarray) -> Table:
    """Rounded to 0.01 mrad or mm."""
    return [[None if np.isnan(one) else round(one, 5) for one in row] for row in means.tolist()]


def _row(name: str, found: FollowingResult) -> ClipResult:
    return ClipResult(
        clip=name,
        episodes=found.starts,
        reached=found.reached,
        root_error=found.root_error,
        root_turn_error=found.root_turn_error,
        joint_error=found.joint_error,
        body_error=found.body_error,
    )
