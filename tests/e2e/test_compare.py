"""Jobs side by side in the terminal."""

import csv
import io
import json

import pytest
from typer.testing import CliRunner, Result

from core.jobs.job import Progress
from gaitway.cli.main import app
from tests.api.conftest import Attempt, Stack, job, quiet, server, stack

__all__ = ["quiet", "server", "stack"]  # fixtures

IDS = ["019aa3c2f0b1-5be0c1d2e3", "019aa3c2f0b2-5be0c1d2e4", "019aa3c2f0b3-5be0c1d2e5"]


def gaitway(stack: Stack, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["--url", f"http://127.0.0.1:{stack.port}", *arguments])


@pytest.fixture
def compared(stack: Stack) -> Stack:
    """Two trainings that differ in one sent setting; the second measured nothing."""
    first = Attempt(stack, job(IDS[0], name="slow", algorithm={"kind": "ppo", "learning_rate": 1e-4}))
    for step, value in ((0, 1.0), (10, 9.0), (20, 4.0)):
        first.say("metrics", step=step, values={"eval/episode_reward": value, "training/loss": 1.0})
    progress = Progress(step=20, total=20, steps_per_second=1234.5)
    stack.store.record(first.id, first.claim.token, "events", [], progress, write_id="p")
    first.end()
    stack.store.add(job(IDS[1], algorithm={"kind": "ppo", "learning_rate": 2e-4}))
    return stack


def test_only_settings_that_differ_are_told_and_what_each_came_to(compared: Stack) -> None:
    done = gaitway(compared, "compare", IDS[0], IDS[1], "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["settings"] == {"name": ["slow", None], "algorithm.learning_rate": [1e-4, 2e-4]}
    assert found["facts"]["status"] == ["succeeded", "queued"]
    assert found["facts"]["last return"] == [4.0, None]
    assert found["facts"]["best return"] == [9.0, None]
    assert found["facts"]["steps/s"] == [1234.5, None]
    assert found["facts"]["seconds"][1] is None


def test_the_table_and_the_csv_say_the_same(compared: Stack) -> None:
    table = gaitway(compared, "compare", IDS[0], IDS[1]).stdout
    [line] = [line for line in table.splitlines() if "learning_rate" in line]
    assert line.split() == ["algorithm.learning_rate", "0.0001", "0.0002"]
    assert "speed" not in table  # Neither measured it.
    assert "num_envs" not in table
    rows = list(csv.reader(io.StringIO(gaitway(compared, "compare", IDS[0], IDS[1], "--csv").stdout)))
    assert rows[0] == ["", IDS[0], IDS[1]]
    assert ["algorithm.learning_rate", "0.0001", "0.0002"] in rows
    assert ["best return", "9.0", ""] in rows


def test_a_narrow_terminal_cuts_no_name_of_a_setting(
    compared: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "50")
    table = gaitway(compared, "compare", IDS[0], IDS[1]).stdout
    assert "…" not in table
    first = "".join(line[:16].strip() for line in table.splitlines())
    assert "algorithm.learning_rate" in first


def test_a_name_is_no_formula_in_a_spreadsheet(stack: Stack) -> None:
    for one, name in zip(IDS, ("=1+1", "two"), strict=False):
        stack.store.add(job(one, name=name))
    assert "name,'=1+1,two" in gaitway(stack, "compare", *IDS[:2], "--csv").stdout


def test_jobs_with_the_same_settings_are_said_to_be_so(stack: Stack) -> None:
    for one in IDS[:2]:
        stack.store.add(job(one))
    assert "All settings are the same." in gaitway(stack, "compare", *IDS[:2]).stdout


def test_a_job_that_does_not_exist_or_one_alone_is_a_sentence(compared: Stack) -> None:
    done = gaitway(compared, "compare", IDS[0], IDS[2])
    assert (done.exit_code, "Traceback" in done.output) == (1, False)
    assert f"There is no job '{IDS[2]}'" in done.stderr
    for arguments in ([IDS[0]], [IDS[0], IDS[0]], [IDS[0], "nonsense"]):
        done = gaitway(compared, "compare", *arguments)
        assert (done.exit_code, done.stdout) == (2, "")
        assert done.stderr
