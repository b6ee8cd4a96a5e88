"""An example with real parts, on a star so small that it takes seconds."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.environments import trajectory
from gaitway.client import Client

STAR = Path(__file__).parents[2] / "examples" / "brittle_star_q_learning.py"
SMALL: dict[str, Any] = {
    "environment": {
        "id": "brittle_star",
        "options": {
            "control": "cpg",
            "num_arms": 3,
            "num_segments_per_arm": 1,
            "simulation_time": 4.0,
            "target_distance": 1.0,
        },
    },
    "algorithm": {"kind": "q_learning", "num_episodes": 8, "num_envs": 4, "num_eval_envs": 2},
    "video": {"cameras": ["track", "top_camera"], "width": 160, "height": 120, "seconds": 1},
}


@pytest.mark.slow
def test_the_star_is_trained_by_the_client_and_its_video_table_and_curve_are_brought(
    client: Client, tmp_path: Path
) -> None:
    example = runpy.run_path(str(STAR))
    example["main"](client, {**example["JOB"], **SMALL}, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"video.mp4", *example["TABLE_AND_CURVE"]}
    with np.load(tmp_path / "tables.npz") as tables:
        # Of 2 rounds, 4 environments and 4 decisions of 25 steps none ends early: half an arm's length is not
        # 1 m.
        assert tables["q_table"].shape == (1, 3, 3)
        assert tables["visits"].sum() == 2 * 4 * 4
        assert tables["action_names"].tolist() == ["arm 0", "arm 1", "arm 2"]
    job = next(iter(client.list(limit=1)))
    shown = trajectory.load(client.download(job.id, "trajectory.npz", tmp_path))
    assert shown.episodes[0].action.shape[1] == 7 * 3 + 1
