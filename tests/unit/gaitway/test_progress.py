import io

from rich.console import Console

from gaitway.cli.progress import JobProgress, duration
from gaitway.views import Event


def progress(step: int) -> Event:
    data = {"step": step, "total": 1000, "steps_per_second": 1234.5, "eta_s": 65.0}
    return Event(kind="progress", data=data)


def measured(**values: float | None) -> Event:
    return Event(kind="metrics", data={"step": 500, "values": values})


def shown(*events: Event, every_s: float = 0.0) -> list[str]:
    text = io.StringIO()
    with JobProgress(Console(file=text, width=40), every_s=every_s) as shows:
        for event in events:
            shows.update(event)
    return text.getvalue().splitlines()


def test_without_a_terminal_each_piece_of_news_is_one_plain_line() -> None:
    lines = shown(
        Event(kind="status", data={"status": "running"}),
        progress(500),
        measured(**{"training/episode_reward": 12.34, "training/forward_speed": 0.5}),
        measured(**{"eval/episode_reward": 99.0, "eval/x": None}),
    )
    # Not wrapped at the console's 40 columns; an evaluation goes before the training's own numbers.
    assert lines == [
        "running",
        "running · 500/1,000 steps · 1,234 steps/s · ETA 1:05",
        "running · 500/1,000 steps · 1,234 steps/s · return 12.3 · 0.50 m/s · ETA 1:05",
        "running · 500/1,000 steps · 1,234 steps/s · return 99.0 · 0.50 m/s · ETA 1:05",
    ]


def test_a_budget_of_episodes_is_told_in_episodes() -> None:
    episodes = {"training/episodes": 50.0, "training/num_episodes": 100.0}
    *_, line = shown(progress(500), measured(**episodes))
    assert line.startswith("queued · 50/100 episodes · 500/1,000 steps")


def test_plain_lines_keep_their_distance_except_for_a_change_of_status_and_the_end() -> None:
    lines = shown(
        progress(1), progress(2), progress(3), Event(kind="status", data={"status": "succeeded"}), every_s=1e6
    )
    assert [line.partition(" steps")[0] for line in lines] == ["queued · 1/1,000", "succeeded · 3/1,000"]


def test_a_phase_is_told_at_once_but_not_each_evaluation() -> None:
    def during(phase: str) -> Event:
        event = progress(500)
        return Event(kind="progress", data={**event.data, "phase": phase})

    running = Event(kind="status", data={"status": "running"})
    ended = Event(kind="status", data={"status": "succeeded"})
    phases = ("compiling", "training", "evaluating", "training", "drawing")
    lines = shown(running, *map(during, phases), ended, every_s=1e6)
    assert [line.partition(" · 500")[0] for line in lines] == [
        "running",
        "running · compiling",
        "running · training",
        "running · drawing the video",
        "succeeded",
    ]


def test_what_lasts_minutes_only_once_says_so() -> None:
    compiling = Event(kind="progress", data={"step": 0, "total": 1000, "phase": "compiling"})
    ended = {"step": 1000, "total": 1000, "steps_per_second": 1234.5, "phase": "testing"}
    testing = Event(kind="progress", data=ended)
    assert shown(Event(kind="status", data={"status": "running"}), compiling, testing)[1:] == [
        "running · compiling · 0/1,000 steps · "
        "the first time may take minutes, a later start of the same job is shorter",
        "running · testing in C MuJoCo · 1,000/1,000 steps",
    ]


def test_80_columns_have_room_for_the_bar_the_status_and_the_time_left() -> None:
    text = io.StringIO()
    numbers = {"eval/episode_reward": 1234.5, "eval/forward_speed": 1.0}
    big = {"step": 1_500_000_000, "total": 3_000_000_000, "steps_per_second": 123456.0, "eta_s": 9000.0}
    news = Event(kind="progress", data={**big, "phase": "evaluating"})
    with JobProgress(Console(file=text, width=80, force_terminal=True, color_system=None)) as shows:
        shows.update(Event(kind="status", data={"status": "running"}))
        shows.update(measured(**numbers))
        shows.update(news)
    lines = text.getvalue().splitlines()
    bars = [line for line in lines if "running · evaluating" in line]
    assert bars
    assert all(part in bars[-1] for part in ("50%", "ETA 2:30:00", "━" * 10))
    assert any("1,500,000,000/3,000,000,000 steps" in line and "return 1,234.5" in line for line in lines)


def test_durations_are_written_as_people_say_them() -> None:
    assert [duration(s) for s in (0.4, 59, 60, 125, 3609)] == ["0 s", "59 s", "1:00", "2:05", "1:00:09"]
