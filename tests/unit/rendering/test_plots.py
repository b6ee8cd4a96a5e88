"""What is drawn is looked up in the figure, or in its pixels where only they tell."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.rendering.plots.episodes import episode_curves, from_metrics, moving_mean
from core.rendering.plots.path import Walk, path_from_above
from core.rendering.plots.style import compact, save
from core.rendering.plots.tables import pictures, q_table, visit_counts

# The second action is the best of the first state; the second state has learnt nothing yet.
VALUES = np.array([[0.0, 2.0, 1.0], [0.5, 0.5, 0.5]])
VISITS = np.array([[3, 12345, 0], [0, 0, 0]])


def walk(*points: tuple[float, float], terminated: bool = False, target: Any = None) -> Walk:
    targets = None if target is None else np.repeat(np.array([target]), len(points), axis=0)
    return Walk(0.1 * np.arange(len(points)), np.array(points), terminated, targets)


def legend(figure: Any) -> list[str]:
    return [text.get_text() for box in figure.legends for text in box.get_texts()]


def numbers(figure: Any) -> dict[tuple[float, float], str]:
    """The text of the cells, by (column, row)."""
    return {text.get_position(): text.get_text() for text in figure.axes[0].texts}


def test_each_episode_is_a_line_of_its_own_from_its_start_to_how_it_ended() -> None:
    walks = [walk((0, 0), (1, 0), (1, 1)), walk((0, 0), (-2, 0), terminated=True, target=(-2, 0.5, 0.1))]
    figure = path_from_above(walks)
    axes = figure.axes[0]
    lines = {line.get_label(): line.get_xydata().tolist() for line in axes.lines}
    assert lines["episode 0"] == [[0, 0], [1, 0], [1, 1]]
    assert lines["episode 1"] == [[0, 0], [-2, 0]]
    marks = [
        (line.get_marker(), line.get_xydata().tolist()) for line in axes.lines if len(line.get_xdata()) == 1
    ]
    assert marks == [
        ("o", [[0, 0]]),
        ("s", [[1, 1]]),
        ("*", [[-2, 0.5]]),
        ("o", [[0, 0]]),
        ("X", [[-2, 0]]),
    ]
    assert {"start", "end: cut off", "end: by the environment", "target"} <= set(legend(figure))
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x in m", "y in m")


def test_one_episode_is_coloured_by_time_and_a_body_at_rest_has_a_scale_of_ten_centimetres() -> None:
    figure = path_from_above([walk((3, 3), (3, 3), (3, 3))])
    assert figure.axes[1].get_ylabel() == "time in s"
    low, high = figure.axes[0].get_xlim()
    assert low < 2.96 < 3.04 < high
    assert high - low < 0.3


def test_the_greedy_action_is_framed_unless_all_are_worth_the_same() -> None:
    figure = q_table(VALUES, visits=VISITS)
    frames = [box.get_center() for box in figure.axes[0].patches]  # black, and white upon it
    np.testing.assert_allclose(frames, [[1, 0], [1, 0]], atol=1e-9)
    assert legend(figure) == ["greedy action", "never tried"]
    assert numbers(figure)[(1, 0)] == "2.00"
    # What was never tried has no colour: the ground shows.
    shown = figure.axes[0].images[0].get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), VISITS == 0)


def test_of_several_agents_the_mean_is_shown_and_whether_they_agree() -> None:
    both = np.stack([VALUES, VALUES[:, ::-1]])
    figure = q_table(both)
    # (2 + 2) / 2, (0 + 1) / 2: both agents have the same best action.
    assert numbers(figure)[(1, 0)] == "2.00"
    assert numbers(figure)[(0, 0)] == "0.50"
    assert {box.get_linestyle() for box in figure.axes[0].patches} == {"solid"}
    apart = q_table(np.stack([VALUES, np.array([[9.0, 0, 0], [0, 0, 0]])]))
    assert apart.axes[0].patches[-1].get_linestyle() != "solid"
    assert "greedy of the mean; agents differ" in legend(apart)
    with pytest.raises(ValueError, match="this one has 1"):
        q_table(np.zeros(3))


def test_visits_are_counted_over_agents_on_a_logarithmic_scale() -> None:
    figure = visit_counts(np.stack([VISITS, VISITS]), states=["near", "far"], actions=["a", "b", "c"])
    axes = figure.axes[0]
    assert numbers(figure)[(1, 0)] == "24.7k"
    assert [label.get_text() for label in axes.get_yticklabels()] == ["near", "far"]
    assert type(axes.images[0].norm).__name__ == "LogNorm"
    assert legend(figure) == ["never tried"]


def test_many_states_lie_along_the_width_without_numbers(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(300, 4))
    figure = q_table(values)
    axes = figure.axes[0]
    assert axes.images[0].get_array().shape == (4, 300)
    assert axes.get_xlabel() == "state"
    assert not axes.texts
    assert len(axes.lines[0].get_xdata()) == 300
    save(figure, tmp_path / "a.png")
    save(q_table(values), tmp_path / "b.png")
    content = (tmp_path / "a.png").read_bytes()
    assert content == (tmp_path / "b.png").read_bytes()
    assert int.from_bytes(content[16:20], "big") == 1280  # twice the width of a page
    assert len(list(tmp_path.iterdir())) == 2


def test_the_moving_mean_of_the_first_points_is_of_fewer() -> None:
    # Windows of two: 4, (4 + 2) / 2, (2 + 6) / 2, (6 + 0) / 2.
    np.testing.assert_allclose(moving_mean(np.array([[4.0, 2, 6, 0]]), 2), [[4, 3, 4, 3]])


def test_agents_have_a_band_of_their_middle_and_epsilon_a_panel() -> None:
    figure = episode_curves(np.arange(12.0).reshape(3, 4), epsilon=np.array([1, 0.5, 0.1, 0.1]))
    returns, epsilon = figure.axes
    thick = [line for line in returns.lines if line.get_label() == "mean of 3 agents"]
    np.testing.assert_allclose(thick[0].get_xydata(), [[1, 4], [2, 5], [3, 6], [4, 7]])
    assert len(returns.lines) == 4
    np.testing.assert_allclose(epsilon.lines[0].get_ydata(), [1, 0.5, 0.1, 0.1])


def test_metrics_of_a_tabular_run_become_curves_and_those_of_another_none() -> None:
    def row(step: int, episodes: float, **own: float) -> dict[str, Any]:
        names = {f"training/{name.replace('__', '/')}": value for name, value in own.items()}
        return {"step": step, "values": {"training/episodes": episodes, **names}}

    several = {"agent_0__episode_reward": 1.0, "agent_10__episode_reward": 3.0}
    rows = [
        row(2000, 20, epsilon=0.5, episode_reward=2.0, **several),
        row(1000, 10, epsilon=1.0, episode_reward=0.0, **several),
        {"step": 1000, "values": {"eval/episode_reward": 5.0}},
    ]
    figure = from_metrics(rows)
    assert figure is not None
    np.testing.assert_allclose(figure.axes[0].lines[-1].get_xydata(), [[10, 2], [20, 2]])
    np.testing.assert_allclose(figure.axes[1].lines[0].get_xydata(), [[10, 1.0], [20, 0.5]])
    assert {line.get_marker() for axes in figure.axes for line in axes.lines} == {"None"}
    assert from_metrics([{"step": 0, "values": {"training/episode_reward": 1.0}}]) is None


def test_a_run_of_one_round_is_a_point_that_one_sees() -> None:
    row = {"training/episodes": 100.0, "training/epsilon": 0.2, "training/episode_reward": 2.4}
    figure = from_metrics([{"step": 50_000, "values": row}])
    assert figure is not None
    assert [line.get_marker() for axes in figure.axes for line in axes.lines] == ["o", "o"]


def test_only_tables_that_are_there_are_drawn() -> None:
    assert list(pictures({"q_table": VALUES, "anything": np.zeros(2)})) == ["q_table"]
    names = {"state_names": np.array(["near", "far"]), "action_names": np.array(["a", "b", "c"])}
    both = pictures({"q_table": VALUES, "visits": VISITS, **names}, title="a body")
    assert list(both) == ["q_table", "visits"]
    assert [label.get_text() for label in both["q_table"].axes[0].get_xticklabels()] == ["a", "b", "c"]
    assert both["visits"].get_suptitle() == "a body: visits"


def test_numbers_are_written_with_three_digits() -> None:
    assert [compact(value) for value in (0.0, 7.0, 999.4, 12345.0, -4e6)] == ["0", "7", "999", "12.3k", "-4M"]
