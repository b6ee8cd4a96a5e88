"""The sentences by which quotas refuse: who, the number, the limit, and when there is room."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from core.errors import QuotaExceeded
from core.jobs.quotas import QuotaUse, Use, first_hour, over_bytes, over_gpu_hours, over_queue
from core.jobs.turns import Quota

NOON = datetime(2026, 11, 28, 12, tzinfo=UTC)
HOUR = timedelta(hours=1)


def found(quota: Quota, **use: Any) -> QuotaUse:
    return QuotaUse("project", "gaits", quota, Use(**use))


def sentence(error: QuotaExceeded | None) -> str:
    assert error is not None
    return error.detail


def test_below_a_quota_and_without_one_nothing_is_refused() -> None:
    for one in (found(Quota(), queued=9, bytes=9), found(Quota(queued=10, bytes=10), queued=9, bytes=9)):
        assert over_queue(one) is over_bytes(one) is over_gpu_hours(one) is None
    assert over_bytes(found(Quota(bytes=10), bytes=9), adding=1) is None


def test_gpu_hours_say_how_many_were_used_and_when_how_many_are_free() -> None:
    """Of 41.2 h the first 0.5 are not enough; an hour later 40 - (41.2 - 0.5 - 3.8) = 3.1 are free."""
    week_ago = NOON - timedelta(days=7)
    hours = {week_ago + HOUR: 0.5, week_ago + 2 * HOUR: 3.8, NOON: 36.9}
    error = over_gpu_hours(found(Quota(gpu_hours=40), gpu_hours=hours))
    assert sentence(error).startswith(
        "The project gaits has used 41.2 of 40 GPU-hours in the last seven days; 3.1 h free at "
        "2026-11-28 14:00 UTC, if nothing of it runs until then."
    )
    assert error is not None
    assert error.facts == {
        "quota": "gpu_hours",
        "limit": 40,
        "used": 41.2,
        "frees_at": NOON + 2 * HOUR,
    }


def test_an_hour_counts_for_seven_days_from_its_beginning() -> None:
    assert first_hour(NOON + timedelta(minutes=59)) == NOON - timedelta(days=7) + HOUR


def test_room_of_less_than_a_twentieth_of_an_hour_is_not_told() -> None:
    """A hundredth is free after the first hour, a whole one after the second."""
    hours = {NOON: 0.01, NOON + HOUR: 1.0}
    error = over_gpu_hours(found(Quota(gpu_hours=1.01), gpu_hours=hours))
    assert "1.0 h free at 2026-12-05 13:00 UTC" in sentence(error)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (over_queue(found(Quota(queued=0))), "may queue nothing: its quota of queued jobs is 0."),
        (over_gpu_hours(found(Quota(gpu_hours=0))), "may use no GPU: its quota of GPU-hours is 0."),
        (over_bytes(found(Quota(bytes=0))), "may store nothing: its quota of bytes is 0."),
        (over_queue(found(Quota(queued=1), queued=1)), "has 1 job in the queue, and its quota is 1: one has"),
        (over_queue(found(Quota(queued=5), queued=1200)), "has 1,200 jobs in the queue, and its quota is 5"),
        (over_bytes(found(Quota(bytes=40 * 10**9), bytes=41 * 10**9)), "stores 41.0 GB of its 40.0 GB: del"),
        (
            over_bytes(found(Quota(bytes=40_000), bytes=39_500), adding=501),
            "stores 39.5 KB of its 40.0 KB, and this is 501 B more: delete jobs, models or clips first",
        ),
    ],
)
def test_a_quota_that_is_used_up_is_said_with_its_numbers(error: QuotaExceeded | None, words: str) -> None:
    assert sentence(error).startswith("The project gaits ")
    assert words in sentence(error)
