import subprocess
import sys
from pathlib import Path
from typing import Any

from gaitway.plots import _terms, learning_curve, series

ROWS: list[dict[str, Any]] = [
    {"step": 2000, "values": {"eval/episode_reward": 5.0, "eval/forward_speed": 1.0}},
    {"step": 0, "values": {"eval/episode_reward": 1.0, "eval/forward_speed": 0.0}},
    {"step": 1000, "values": {"training/episode_reward": 2.0}},
]


def test_a_series_is_in_the_order_of_its_steps_and_skips_rows_without_the_metric() -> None:
    assert series(ROWS, "eval/episode_reward") == ([0.0, 2000.0], [1.0, 5.0])


def size(path: Path) -> tuple[int, int]:
    """Width and height in pixels."""
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    return int.from_bytes(content[16:20], "big"), int.from_bytes(content[20:24], "big")


def test_a_run_that_measured_speed_gets_two_panels(tmp_path: Path) -> None:
    learning_curve(ROWS, tmp_path / "both.png", title="ant")
    learning_curve(ROWS[2:], tmp_path / "one.png")
    assert size(tmp_path / "both.png")[0] > 1.5 * size(tmp_path / "one.png")[0]


def test_terms_of_the_reward_that_were_ever_paid_share_a_panel_behind_return_and_speed(
    tmp_path: Path,
) -> None:
    terms = {"training/reward_forward": 0.5, "training/reward_ctrl": -0.1, "training/reward_contact": 0.0}
    rows = [*ROWS, {"step": 1000, "values": terms}]
    learning_curve(ROWS, tmp_path / "without.png")
    learning_curve(rows, tmp_path / "with.png")
    # Three panels need a second line.
    assert size(tmp_path / "with.png")[1] > 1.5 * size(tmp_path / "without.png")[1]
    unpaid = [*ROWS, {"step": 1000, "values": {"training/reward_contact": 0.0}}]
    learning_curve(unpaid, tmp_path / "unpaid.png")
    assert size(tmp_path / "unpaid.png") == size(tmp_path / "without.png")


def test_every_term_is_drawn_once_whatever_its_name() -> None:
    measured = {"reward_linvel": 2.0, "forward_reward": 2.0, "distance_reward": 0.1, "episode_reward": 3.0}
    own = {"reward_alive": 0.5, "reward_upright": 0.5, "reward/pose": 0.2, "reward_contact": 0.0}
    rows = [{"step": 0, "values": {f"training/{name}": value for name, value in (measured | own).items()}}]
    # Brax tells of forward speed twice; two terms of a body's own may happen to be equal.
    assert list(_terms(rows)) == ["alive", "distance", "linvel", "pose", "upright"]


def test_distance_is_from_the_start_where_that_was_measured_and_else_from_the_origin(tmp_path: Path) -> None:
    def drawn(**measured: float) -> bytes:
        values = {f"training/{name}": value for name, value in measured.items()}
        learning_curve([{"step": 0, "values": values}], tmp_path / "curve.png")
        return (tmp_path / "curve.png").read_bytes()

    # A corridor begins 5 m from the origin.
    both = drawn(distance_from_start=0.0, distance_from_origin=5.0)
    assert both == drawn(distance_from_start=0.0)
    assert both != drawn(distance_from_origin=0.0)


def test_a_value_that_was_not_finite_is_left_out() -> None:
    rows = [{"step": 0, "values": {"a": None}}, {"step": 1, "values": {"a": 2.0}}]
    assert series(rows, "a") == ([1.0], [2.0])


def test_a_run_without_metrics_still_has_a_picture(tmp_path: Path) -> None:
    learning_curve([], tmp_path / "none.png")
    assert size(tmp_path / "none.png")[1] > 100


def test_matplotlib_is_loaded_only_when_something_is_drawn() -> None:
    code = "import sys, gaitway.plots; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
