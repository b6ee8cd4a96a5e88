import io

from rich.console import Console

from gaitway.cli.progress import JobProgress, duration
from gaitway.views import Event


def progress(step: int, **metrics: float) -> Event:
    data = {"step": step, "total": 1000, "steps_per_second": 1234.5, "eta_s": 65.0, "metrics": metrics}
    return Event(kind="progress", data=data)


def shown(*events: Event, every_s: float = 0.0) -> list[str]:
    text = io.StringIO()
    with JobProgress(Console(file=text, width=40), every_s=every_s) as shows:
        for event in events:
            shows.update(event)
    return text.getvalue().splitlines()


def test_without_a_terminal_each_piece_of_news_is_one_plain_line() -> None:
    lines = shown(
        Event(kind="status", data={"status": "running"}),
        progress(500, **{"training/episode_reward": 12.34, "training/forward_speed": 0.5}),
        Event(kind="metrics", data={"step": 500, "values": {"eval/episode_reward": 99.0, "eval/x": None}}),
    )
    # Not wrapped at the console's 40 columns; an evaluation goes before the training's own numbers.
    assert lines == [
        "running",
        "running · 500/1,000 steps · 1,234 steps/s · return 12.3 · 0.50 m/s · ETA 1:05",
        "running · 500/1,000 steps · 1,234 steps/s · return 99.0 · 0.50 m/s · ETA 1:05",
    ]


def test_a_budget_of_episodes_is_told_in_episodes() -> None:
    [line] = shown(progress(500, **{"training/episodes": 50.0, "training/num_episodes": 100.0}))
    assert line.startswith("queued · 50/100 episodes · 500/1,000 steps")


def test_plain_lines_keep_their_distance_except_for_a_change_of_status_and_the_end() -> None:
    lines = shown(
        progress(1), progress(2), progress(3), Event(kind="status", data={"status": "succeeded"}), every_s=1e6
    )
    assert [line.partition(" steps")[0] for line in lines] == ["queued · 1/1,000", "succeeded · 3/1,000"]


def test_durations_are_written_as_people_say_them() -> None:
    assert [duration(s) for s in (0.4, 59, 60, 125, 3609)] == ["0 s", "59 s", "1:00", "2:05", "1:00:09"]
