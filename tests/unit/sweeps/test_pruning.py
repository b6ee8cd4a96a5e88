"""Which trials are not worth their steps."""

import optuna
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.sweeps.pruning import is_to_prune, value_at
from core.sweeps.spec import HyperbandPruning, MedianPruning

MEDIAN = MedianPruning(startup_trials=1)


def test_a_trial_below_the_median_at_its_step_is_pruned() -> None:
    curves = {0: {10: 1.0, 20: 9.0}, 1: {10: 2.0, 20: 8.0}, 2: {10: 3.0, 20: 7.0}, 3: {10: 1.9}}
    assert is_to_prune(MEDIAN, 3, curves, {0, 1, 2})  # 1.9 is below 2, the median of 1, 2 and 3.
    curves[3] = {10: 1.9, 20: 8.5}
    assert not is_to_prune(MEDIAN, 3, curves, {0, 1, 2})  # 8.5 is above 8.


def test_nothing_is_pruned_before_enough_has_been_seen() -> None:
    curves = {0: {10: 5.0}, 1: {10: 1.0}, 2: {}}
    assert is_to_prune(MEDIAN, 1, curves, {0})
    assert not is_to_prune(MedianPruning(startup_trials=2), 1, curves, {0})
    assert not is_to_prune(MedianPruning(startup_trials=1, warmup_steps=11), 1, curves, {0})
    assert not is_to_prune(MEDIAN, 2, curves, {0})  # It has reported nothing.
    assert not is_to_prune(MEDIAN, 1, {0: {5: 5.0}, 1: {10: 1.0}}, {0})  # Nobody else came that far.


def test_a_value_is_the_last_one_up_to_a_step() -> None:
    assert [value_at({10: 1.0, 20: 2.0}, step) for step in (9, 10, 19, 20, 21)] == [None, 1.0, 1.0, 2.0, None]


@given(
    st.lists(st.lists(st.integers(0, 9), min_size=1, max_size=4), min_size=1, max_size=6),
    st.lists(st.integers(0, 9), min_size=1, max_size=4),
)
def test_the_median_rule_is_optunas(others: list[list[int]], own: list[int]) -> None:
    """Where all curves have their values at the same steps."""
    study = optuna.create_study(direction="maximize", pruner=optuna.pruners.MedianPruner(n_startup_trials=1))
    curves = {number: dict(enumerate(map(float, values), 1)) for number, values in enumerate([*others, own])}
    for number in range(len(others)):
        values = curves[number]
        done = optuna.trial.create_trial(value=values[max(values)], intermediate_values=values)
        study.add_trial(done)
    trial = study.ask()
    for step, value in curves[len(others)].items():
        trial.report(value, step)
    ours = is_to_prune(MEDIAN, len(others), curves, range(len(others)))
    assert ours == trial.should_prune()


@pytest.mark.parametrize(("value", "is_out"), [(1.0, True), (5.5, True), (6.0, False), (9.0, False)])
def test_a_third_of_a_bracket_passes_each_rung(value: float, is_out: bool) -> None:
    # Rungs at 100, 300, 900. At 300 there are six values with one's own: the best two stay.
    pruning = HyperbandPruning(min_steps=100, reduction_factor=3)
    curves = {number: {100: 0.0, 310: float(number + 3)} for number in range(5)}  # 3, 4, 5, 6, 7
    curves[5] = {100: 9.0, 320: value}
    assert is_to_prune(pruning, 5, curves, set()) == is_out


def test_a_bracket_begins_later_and_is_judged_alone() -> None:
    # Bracket 1, the odd numbers, has its first rung at 200.
    pruning = HyperbandPruning(min_steps=100, reduction_factor=2, brackets=2)
    curves = {0: {100: 9.0}, 1: {100: 1.0}, 2: {100: 1.0}, 3: {200: 5.0}}
    assert is_to_prune(pruning, 2, curves, set())
    assert not is_to_prune(pruning, 1, curves, set())
    curves[1][200] = 4.0
    assert is_to_prune(pruning, 1, curves, set())
