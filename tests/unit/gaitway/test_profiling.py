"""`gaitway profile`: where the time of a training goes."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from core.algorithms.events import Evaluated, Phase, TrainingProgress
from core.algorithms.profiling import UpdateTimes
from gaitway.cli.main import app
from gaitway.service.profiling import Times, table
from tests.unit.gaitway.test_foreground import job, trained

__all__ = ["job"]  # a fixture

STEPS_PER_UPDATE = 100


def seen() -> Times:
    """A training of 2 s of compilation, a first update of 4 s, and three more in 6 s."""
    times = Times()
    for event in (
        Phase("trace", 0.5),
        Phase("compile", 1.5),
        Evaluated(0, {"eval/epoch_eval_time": 9.0}),
        Phase("first_update", 4.0),
        TrainingProgress(100, 1000, {"training/walltime": 4.0}),
        TrainingProgress(300, 1000, {"training/walltime": 8.5}),
        TrainingProgress(400, 1000, {"training/walltime": 10.0}),
    ):
        times.see(event, STEPS_PER_UPDATE)
    times.evaluation, times.total = 3.0, 20.0
    return times


def rows(parts: UpdateTimes | None) -> dict[str, tuple[float, str]]:
    """The table's seconds and shares, by the names of its rows."""
    found = (re.fullmatch(r" *(.+?) +([\d.]+) +(\d+%)", line) for line in table(seen(), parts))
    return {match[1]: (float(match[2]), match[3]) for match in found if match}


def test_the_parts_of_a_training_add_up() -> None:
    told = rows(UpdateTimes(experience=1.5, physics=1.0))
    assert told == {
        "compile": (2.0, "10%"),
        "first update": (4.0, "20%"),
        "3 updates": (6.0, "30%"),
        "experience": (4.5, "75%"),  # of the updates, as the three below
        "physics": (3.0, "50%"),
        "policy, resets": (1.5, "25%"),
        "learning": (1.5, "25%"),
        "one evaluation": (3.0, "15%"),
        "other": (5.0, "25%"),
        "total": (20.0, "100%"),
    }
    assert [*table(seen(), None)][-1] == "50 steps/s"


def test_parts_are_no_longer_than_the_whole() -> None:
    told = rows(UpdateTimes(experience=2.5, physics=3.0))
    assert [told[name][0] for name in ("experience", "physics", "policy, resets", "learning")] == [6, 6, 0, 0]


def test_an_algorithm_without_such_parts_has_no_rows_of_them() -> None:
    assert [*rows(None)] == ["compile", "first update", "3 updates", "one evaluation", "other", "total"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_training_is_profiled_and_traced(job: Path, tmp_path: Path) -> None:
    endless = ("--set", "algorithm.num_timesteps=1000000000", "--epochs", "1", "--trace", str(tmp_path / "t"))
    status, printed = trained(tmp_path, str(job), *endless, command="profile")
    assert status == 0, printed
    for name in ("compile", "physics", "policy, resets", "learning", "one evaluation", "total"):
        assert re.search(rf"^ *{name} +[\d.]+ +\d+%$", printed, re.MULTILINE), printed
    assert re.search(r"^[\d,]+ steps/s$", printed, re.MULTILINE)
    assert {path.suffix for path in (tmp_path / "t").rglob("*.*")} >= {".pb", ".gz"}


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [("seeds=[0,1]", "write `seed` instead of `seeds`"), ("seed=zero", "seed")],
)
def test_what_cannot_be_profiled_is_refused(assignment: str, sentence: str, job: Path) -> None:
    result = CliRunner().invoke(app, ["profile", str(job), "--set", assignment])
    assert (result.exit_code, sentence in result.output) == (2, True), result.output
