from hypothesis import given
from hypothesis import strategies as st

from core.algorithms.run import Schedule

schedules = st.builds(
    Schedule,
    num_updates=st.integers(1, 60),
    steps_per_update=st.integers(1, 50),
    num_evals=st.integers(0, 70),
    checkpoint_every_steps=st.none() | st.integers(1, 4000),
)


def test_evaluations_are_spread_evenly_and_the_last_is_at_the_end() -> None:
    schedule = Schedule(10, 100, num_evals=4, checkpoint_every_steps=None)
    # 10/4 = 2.5 updates apart, each at the first whole update: 2.5, 5, 7.5, 10.
    assert [u for u in range(1, 11) if schedule.evaluation_due(u)] == [3, 5, 8, 10]


def test_checkpoints_come_with_the_update_that_reaches_their_step_and_at_the_end() -> None:
    schedule = Schedule(10, 100, num_evals=0, checkpoint_every_steps=250)
    # 250, 500, 750 and 1000 steps, of 100 in an update.
    assert [u for u in range(1, 11) if schedule.checkpoint_due(u)] == [3, 5, 8, 10]
    assert [u for u in range(1, 11) if Schedule(10, 100, 0, None).checkpoint_due(u)] == [10]


def test_what_is_due_more_often_than_updates_come_is_due_at_each() -> None:
    schedule = Schedule(3, 100, num_evals=50, checkpoint_every_steps=7)
    assert [u for u in range(1, 4) if schedule.evaluation_due(u) and schedule.checkpoint_due(u)] == [1, 2, 3]


@given(schedules)
def test_no_stop_is_jumped_over_and_none_is_for_nothing(schedule: Schedule) -> None:
    due = [
        u
        for u in range(1, schedule.num_updates + 1)
        if schedule.evaluation_due(u) or schedule.checkpoint_due(u)
    ]
    stops, update = list[int](), 0
    while update < schedule.num_updates:
        update = schedule.next_stop(update)
        stops.append(update)
    assert stops == due


@given(schedules)
def test_the_evaluations_asked_for_are_made_where_there_are_updates_enough(schedule: Schedule) -> None:
    made = sum(schedule.evaluation_due(u) for u in range(1, schedule.num_updates + 1))
    assert made == min(schedule.num_evals, schedule.num_updates)
