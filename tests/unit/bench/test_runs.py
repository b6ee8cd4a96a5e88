"""Runs of a bench, in processes of their own, kept one by one."""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest

from bench.measure.result import Options
from bench.measure.runs import Runs, Work
from bench.measure.turn import TURN


@pytest.fixture(autouse=True)
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / "gaitway-bench-caches"


def say(word: str, name: str = "one", **more: Any) -> Work:
    return Work(name, "tests.unit.bench.echo", {"do": word}, **more)


def made(folder: Path, *works: Work, **options: Any) -> Runs:
    runs = Runs("echo", Options(out=folder, **options))
    runs.make(works)
    return runs


def test_a_run_that_is_there_is_not_made_again(tmp_path: Path) -> None:
    first = made(tmp_path, say("hello")).done["one"]
    assert first["said"] == "hello"
    assert made(tmp_path, say("hello"), resume=True).done["one"] == first
    assert made(tmp_path, say("hello")).done["one"]["began_at"] > first["began_at"]


def test_a_run_of_another_request_is_made_again(tmp_path: Path) -> None:
    made(tmp_path, say("hello"))
    assert made(tmp_path, say("goodbye"), resume=True).done["one"]["said"] == "goodbye"


def test_a_failure_is_kept_with_its_reason(tmp_path: Path) -> None:
    runs = made(tmp_path, say("fail"), say("hello", "two"))
    assert runs.failed == {"one": "ended with 1: ValueError: a sentence that says why"}
    assert "two" in runs.done
    assert made(tmp_path, say("fail"), resume=True).failed == runs.failed
    assert runs.notes() == ["Failed: one (ended with 1: ValueError: a sentence that says why)."]


def test_a_crash_is_told_by_its_signal(tmp_path: Path) -> None:
    assert made(tmp_path, say("crash")).failed["one"].startswith("killed by SIGSEGV")


def test_a_run_past_its_own_limit_has_failed(tmp_path: Path) -> None:
    assert "did not end within 1 s" in made(tmp_path, say("sleep", timeout_s=1)).failed["one"]


def test_a_run_that_the_calls_end_cuts_off_is_left_for_another(tmp_path: Path) -> None:
    runs = made(tmp_path, say("sleep", about_s=0), seconds=1)
    assert (runs.left, runs.failed) == (["one"], {})


def test_nothing_is_begun_that_there_is_no_time_for(tmp_path: Path) -> None:
    runs = made(tmp_path, say("hello", about_s=60), seconds=30)
    assert (runs.left, runs.done) == (["one"], {})
    assert made(tmp_path, say("hello", about_s=60), seconds=90, resume=True).left == []


def test_only_runs_of_such_names_are_made(tmp_path: Path) -> None:
    runs = made(tmp_path, say("a", "brax-0"), say("b", "ours-0"), only="ours-*")
    assert (list(runs.done), runs.left) == (["ours-0"], ["brax-0"])
    assert set(made(tmp_path, say("a", "brax-0"), say("b", "ours-0"), resume=True).done) == {
        "brax-0",
        "ours-0",
    }


def test_runs_side_by_side_are_timed_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TURN, str(tmp_path / "turn"))
    runs = Runs("echo", Options(out=tmp_path))
    runs.make_together([say("time", name) for name in "abc"], at_once=3, in_turns=True)
    (_, first), (second, second_ends), (third, _) = sorted(run["timed"] for run in runs.done.values())
    assert first <= second
    assert second_ends <= third


def test_a_warm_run_has_what_the_cold_one_left(tmp_path: Path, caches: Path) -> None:
    cold = say("a", "cold", cache="mine", cold=True)
    made(tmp_path, cold, say("a", "warm", cache="mine", after=cold))
    assert (caches / "echo" / "mine" / "compiled").exists()


def test_a_warm_run_on_another_machine_makes_the_cold_one_again(tmp_path: Path, caches: Path) -> None:
    cold = say("a", "cold", cache="mine", cold=True)
    warm = say("a", "warm", cache="mine", after=cold)
    first = made(tmp_path, cold).done["cold"]
    kept = made(tmp_path, cold, warm, only="cold", resume=True)
    assert kept.done["cold"] == first  # here the cache is, and nothing need be made anew
    shutil.rmtree(caches)

    runs = made(tmp_path, cold, warm, resume=True)

    assert runs.done["cold"]["began_at"] > first["began_at"]
    assert runs.done["warm"]["began_at"] > runs.done["cold"]["began_at"]


def test_a_cold_run_that_may_not_be_made_is_kept(tmp_path: Path, caches: Path) -> None:
    cold = say("a", "cold", cache="mine", cold=True)
    first = made(tmp_path, cold).done["cold"]
    shutil.rmtree(caches)

    runs = made(tmp_path, cold, say("a", "warm", cache="mine", after=cold), only="warm", resume=True)

    assert (runs.done, runs.left) == ({"cold": first}, ["warm"])


def test_runs_of_different_commits_are_told_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, commit in (("one", "abc"), ("two", "def")):
        monkeypatch.setenv("BENCH_COMMIT", commit)
        runs = made(tmp_path, say("a"), say("a", "two"), resume=True, only=name)
    assert runs.notes() == ['The runs differ in commit: "abc", "def".']
