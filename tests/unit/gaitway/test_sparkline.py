"""The curve of a job on a terminal."""

import io

from gaitway.cli.progress import History, JobProgress
from gaitway.cli.terminal import Console
from gaitway.frames import sparkline
from gaitway.views import Event


def test_each_value_is_a_bar_between_the_least_and_the_greatest() -> None:
    assert sparkline([0.0, 7.0, 3.0, 3.6]) == "▁█▄▅"  # sevenths: 0, 7, 3, and 3.6 is nearer to 4
    assert sparkline([2.0, 2.0]) == "▄▄"
    assert sparkline([]) == ""


def test_more_values_than_fit_are_drawn_by_the_means_of_their_parts() -> None:
    # Means of 0 1 | 2 3 | 4 5: 0.5, 2.5, 4.5. The middle one is half way, at 3.5 sevenths, rounded to even.
    assert sparkline([0, 1, 2, 3, 4, 5], width=3) == "▁▅█"
    assert len(sparkline(range(1000))) == 24


def test_an_attempt_that_began_again_replaces_what_followed_its_checkpoint() -> None:
    history = History()
    for step, value in [(0, 1.0), (10, 2.0), (20, 3.0), (10, 5.0), (30, None)]:
        history.add(step, value)
    assert (history.steps, history.values) == ([0, 10], [1.0, 5.0])


def shown(encoding: str) -> str:
    text = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with JobProgress(Console(file=text, width=200), every_s=0) as shows:
        for step, value in [(0, 0.0), (10, 7.0), (20, 3.0)]:
            shows.update(Event(kind="metrics", data={"step": step, "values": {"eval/episode_reward": value}}))
    text.seek(0)
    return text.read()


def test_watching_draws_the_return_unless_the_terminal_cannot() -> None:
    assert "return 3.0 ▁█▄" in shown("utf-8")
    assert shown("latin-1").rstrip().endswith("return 3.0")
