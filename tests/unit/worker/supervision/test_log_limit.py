"""What a process may write into its job's log."""

import pytest

from worker.supervision.watching import LogLimit

# A line of one kB with its end; the burst has room for 4096 of them, and a second brings 64.
LINE = "x" * 1023


class Clock:
    def __init__(self) -> None:
        self.s = 0.0

    def __call__(self) -> float:
        return self.s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def limit(clock: Clock) -> LogLimit:
    return LogLimit(clock)


def passed(limit: LogLimit, count: int, num_waiting: int = 0) -> list[str]:
    return [told for _ in range(count) for told in limit.pass_on(LINE, num_waiting)]


def test_what_a_trainer_prints_passes_unchanged(limit: LogLimit, clock: Clock) -> None:
    for _ in range(10_000):
        assert passed(limit, 1) == [LINE]
        clock.s += 1 / 64
    assert list(limit.end()) == []


def test_a_flood_is_cut_and_its_end_says_how_much_is_missing(limit: LogLimit) -> None:
    assert passed(limit, 5000) == [LINE] * 4096
    assert list(limit.end()) == ["[904 lines left out: the process printed more than 64 kB/s]"]
    assert list(limit.end()) == []


def test_after_a_flood_the_log_goes_on_with_more_than_one_line(limit: LogLimit, clock: Clock) -> None:
    passed(limit, 4097)
    clock.s += 1
    # There is room for 64 lines now, and 65 are wanted before it goes on.
    assert passed(limit, 1) == []
    clock.s += 1 / 64
    assert passed(limit, 2) == ["[2 lines left out: the process printed more than 64 kB/s]", LINE, LINE]


def test_lines_that_too_many_others_wait_before_are_left_out_and_the_log_says_why(limit: LogLimit) -> None:
    assert passed(limit, 2, num_waiting=20_000) == [LINE, LINE]
    assert passed(limit, 3, num_waiting=20_001) == []
    assert passed(limit, 1) == ["[3 lines left out: 20000 waited for PostgreSQL or the object store]", LINE]


def test_a_line_longer_than_the_burst_is_left_out(limit: LogLimit) -> None:
    assert list(limit.pass_on("x" * (4 * 2**20))) == []
    assert passed(limit, 1)[1:] == [LINE]
