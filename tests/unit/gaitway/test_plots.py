import subprocess
import sys
from pathlib import Path
from typing import Any

from gaitway.plots import learning_curve, series

ROWS: list[dict[str, Any]] = [
    {"step": 2000, "values": {"eval/episode_reward": 5.0, "eval/forward_speed": 1.0}},
    {"step": 0, "values": {"eval/episode_reward": 1.0, "eval/forward_speed": 0.0}},
    {"step": 1000, "values": {"training/episode_reward": 2.0}},
]


def test_a_series_is_in_the_order_of_its_steps_and_skips_rows_without_the_metric() -> None:
    assert series(ROWS, "eval/episode_reward") == ([0.0, 2000.0], [1.0, 5.0])


def picture_height(path: Path) -> int:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    return int.from_bytes(content[20:24], "big")


def test_a_run_that_measured_speed_gets_two_panels(tmp_path: Path) -> None:
    learning_curve(ROWS, tmp_path / "both.png", title="ant")
    learning_curve(ROWS[2:], tmp_path / "one.png")
    assert picture_height(tmp_path / "both.png") > 1.5 * picture_height(tmp_path / "one.png")


def test_a_run_without_metrics_still_has_a_picture(tmp_path: Path) -> None:
    learning_curve([], tmp_path / "none.png")
    assert picture_height(tmp_path / "none.png") > 100


def test_matplotlib_is_loaded_only_when_something_is_drawn() -> None:
    code = "import sys, gaitway.plots; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
