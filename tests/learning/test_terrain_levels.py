"""Levels of a terrain while PPO trains: a probe that flies goes up, and one that falls goes down."""

from pathlib import Path
from typing import Any

import pytest

from core.algorithms.events import CheckpointReady, TrainingProgress
from core.algorithms.run import Run
from tests.learning.runs import STEPS_PER_UPDATE, small_run
from tests.unit.environments.mjcf.probe import build

NUM_UPDATES = 6
# Without gravity, what flies goes on flying.
XML = b"""<mujoco>
  <option timestep="0.05" gravity="0 0 0"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="ball" pos="0 0 0.5"><freejoint/><geom size="0.1"/><site name="middle"/></body>
  </worldbody>
  <actuator><motor site="middle" gear="0.1 0 0 0 0 0"/></actuator>
</mujoco>"""
# Episodes of five steps of half a second, and ten levels of two kinds.
TERRAIN: dict[str, Any] = {"kinds": ["flat", "pits"]}


def run(folder: Path, *, resume: bytes | None = None, **options: Any) -> Run[Any]:
    environment = build(folder, XML, terrain=TERRAIN, n_frames=10, **options)
    return small_run(
        environment,
        num_timesteps=NUM_UPDATES * STEPS_PER_UPDATE,
        episode_length=5,
        reset_pool_size=20,
        num_evals=0,
        checkpoint_every_steps=STEPS_PER_UPDATE * NUM_UPDATES // 2,
        epoch_s=0.0,
        resume=resume,
    )


def followed(run: Run[Any]) -> tuple[list[dict[str, float]], dict[int, bytes]]:
    """The metrics of its updates, and its checkpoints by their steps."""
    metrics, kept = list[dict[str, float]](), dict[int, bytes]()
    for event in run.events():
        match event:
            case TrainingProgress():
                metrics.append(dict(event.metrics))
            case CheckpointReady():
                kept[event.step] = run.checkpoint()
            case _:
                pass
    return metrics, kept


@pytest.mark.extra
def test_who_walks_goes_up_and_a_resumed_run_has_the_same_levels(tmp_path: Path) -> None:
    # It flies at up to 10 m/s, and is off the terrain of 3 m within an episode.
    flies = {"reset": {"position_noise": 0.0, "velocity_noise": 10.0}, "termination": []}
    metrics, kept = followed(run(tmp_path, **flies))
    levels = [one["training/terrain_level"] for one in metrics]
    assert levels[0] < 3.0 < 4.0 < levels[-1]
    last = metrics[-1]
    shares = [last[f"training/terrain_level_{level}"] for level in range(10)]
    assert sum(shares) == pytest.approx(1.0, abs=1e-5)
    assert sum(n * share for n, share in enumerate(shares)) == pytest.approx(levels[-1], abs=1e-5)
    half, whole = sorted(kept)
    _, resumed = followed(run(tmp_path, resume=kept[half], **flies))
    assert resumed[whole] == kept[whole]


@pytest.mark.extra
def test_who_falls_goes_down(tmp_path: Path) -> None:
    falls = {"termination": [{"kind": "height_range", "range": [1.0, 2.0]}]}
    metrics, _ = followed(run(tmp_path, **falls))
    assert metrics[-1]["training/terrain_level"] == 0.0
