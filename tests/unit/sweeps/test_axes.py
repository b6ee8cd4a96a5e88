"""Values along the axes of a sweep."""

import pytest
from pydantic import ValidationError

from core.environments import catalog
from core.jobs.spec import JOB_SPEC
from core.sweeps.axes import (
    combinations,
    fields_of,
    grid_values,
    job_of,
    num_combinations,
    random_values,
    with_whole_parts,
)
from core.sweeps.spec import Range
from tests.unit.environments.test_imitating_bodies import BODIES, FOLLOWS
from tests.unit.sweeps.making import spec_of


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        (Range(low=0, high=10, step=5), [0, 5, 10]),
        (Range(low=0, high=9, step=5), [0, 5]),
        (Range(low=0.1, high=0.3, step=0.1), [0.1, 0.2, 0.3]),
        (Range(low=0.0, high=1.0, points=3), [0.0, 0.5, 1.0]),
        (Range(low=1e-4, high=1e-2, log=True, points=3), [1e-4, pytest.approx(1e-3), 1e-2]),
        (Range(low=1, high=3, points=9), [1, 2, 3]),
        # Without `points` and `step`: five, or every whole number where they are fewer.
        (Range(low=0.0, high=1.0), [0.0, 0.25, 0.5, 0.75, 1.0]),
        (Range(low=1e-4, high=1.0, log=True), pytest.approx([1e-4, 1e-3, 1e-2, 1e-1, 1.0])),
        (Range(low=0, high=100), [0, 25, 50, 75, 100]),
        (Range(low=7, high=8), [7, 8]),
        (Range(low=2, high=5), [2, 3, 4, 5]),
        (Range(low=1, high=4, log=True), [1, 2, 3, 4]),
    ],
)
def test_a_grid_has_both_ends_and_even_steps(axis: Range, expected: list[float]) -> None:
    assert grid_values(axis) == expected


def test_combinations_are_counted_without_making_them() -> None:
    many = {str(number): Range(low=0, high=9_999_999, step=1) for number in range(2)}
    assert num_combinations(many) == 10**14
    few = spec_of(parameters={"seed": [1, 2], "algorithm.num_envs": [64, 128, 256]}).parameters
    assert num_combinations(few) == len(list(combinations(few))) == 6


def test_draws_stay_in_their_range_and_depend_on_the_seed_and_the_number_alone() -> None:
    parameters = {
        "algorithm.learning_rate": {"low": 1e-5, "high": 1e-3, "log": True},
        "algorithm.num_envs": {"low": 64, "high": 256, "step": 64},
        "algorithm.unroll_length": {"low": 1, "high": 3},
        "seed": [7, 9],
    }
    spec = spec_of(method="random", parameters=parameters)
    drawn = [random_values(spec, number) for number in range(400)]
    assert drawn == [random_values(spec, number) for number in range(400)]
    assert drawn != [random_values(spec.model_copy(update={"seed": 1}), number) for number in range(400)]
    rates = [float(values["algorithm.learning_rate"]) for values in drawn]  # pyright: ignore
    assert min(rates) >= 1e-5
    assert max(rates) <= 1e-3
    # Half of the logarithmic range lies below 1e-4: 200 expected, with a standard deviation of 10.
    assert 160 < sum(rate < 1e-4 for rate in rates) < 240
    assert {values["algorithm.num_envs"] for values in drawn} == {64, 128, 192, 256}
    assert {values["algorithm.unroll_length"] for values in drawn} == {1, 2, 3}
    assert {values["seed"] for values in drawn} == {7, 9}


@pytest.mark.parametrize(
    "wrong",
    [
        {"low": 2, "high": 2},
        {"low": 0, "high": 1, "log": True},
        {"low": 1, "high": 9, "log": True, "step": 2},
        {"low": 1, "high": 9, "points": 3, "step": 2},
        {"low": 1, "high": 9, "step": 0},
        {"low": 1},
        {"low": 1, "high": float("inf")},
    ],
)
def test_what_is_no_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError):
        Range.model_validate(wrong)


@pytest.mark.parametrize("body", BODIES)
def test_a_field_of_an_object_in_the_options_changes_alone(body: str) -> None:
    job = JOB_SPEC.validate_python({"kind": "train", "environment": {"id": body, "options": FOLLOWS}})
    info, options = catalog.resolve(body, FOLLOWS)
    path = "environment.options.reference.sampling.part_s"
    assert path in fields_of(job, info)
    whole = with_whole_parts(job, info, [path, "seed"])
    assert catalog.resolve(body, whole.environment.options)[1] == options
    reference = catalog.resolve(body, job_of(whole, {path: 0.5}).environment.options)[1].reference  # pyright: ignore
    assert reference.sampling.model_dump() == {**options.reference.sampling.model_dump(), "part_s": 0.5}  # pyright: ignore


def test_what_the_environment_has_by_default_stays_beside_a_changed_field() -> None:
    job = JOB_SPEC.validate_python({"kind": "train", "environment": {"id": "g1", "options": FOLLOWS}})
    info, options = catalog.resolve("g1", FOLLOWS)
    whole = with_whole_parts(job, info, ["environment.options.action.scale"])
    changed = job_of(whole, {"environment.options.action.scale": 0.3}).environment.options
    action = catalog.resolve("g1", changed)[1].action  # pyright: ignore
    assert action == options.action.model_copy(update={"scale": 0.3})  # pyright: ignore
    assert action.about == "reference"  # pyright: ignore
    assert with_whole_parts(job, info, ["seed"]) is job


def test_another_kind_of_an_object_has_none_of_the_fields_of_the_one_before() -> None:
    job = JOB_SPEC.validate_python({"kind": "train", "environment": {"id": "rodent", "options": FOLLOWS}})
    info, _ = catalog.resolve("rodent", FOLLOWS)
    path = "environment.options.reference.sampling.kind"
    whole = with_whole_parts(job, info, [path])
    for kind in ("uniform", "adaptive"):
        options = job_of(whole, {path: kind}).environment.options
        assert catalog.resolve("rodent", options)[1].reference.sampling.kind == kind  # pyright: ignore
