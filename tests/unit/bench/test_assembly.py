"""Results from runs: every training bench over answers that are made up, and over children that fail."""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from bench.__main__ import MODULES
from bench.gpu import profile
from bench.measure import report, runs
from bench.measure.child import ChildFailed
from bench.measure.result import Options, Result

BENCHES = (
    *("training", "corridor", "gpu_ant", "gpu_humanoid", "gpu_bodies"),
    *("gpu_engines", "gpu_rodent", "gpu_corridor", "gpu_profile", "gpu_scaling"),
    *("layouts", "gpu_layouts", "gpu_cohort", "gpu_own_models"),
    *("q_learning", "gpu_q_learning", "exercises", "compiled", "own_models", "gate", "gpu_gate", "gpu_sac"),
)
SECONDS = {
    "epoch": [0.010],
    "update": [0.011],
    "update_twice": [0.014],
    "acting": [0.006],
    "stepping": [0.005],
    "engine": [0.004],
    "policy": [0.001],
}


def answered(module: str, request: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
    """100 steps in 1 s, evaluated for 0.5 s of 10; the return is the seed, and Brax's is 1 less."""
    ours = module != "bench.peers.train_brax"
    if module == "bench.peers.step_composed":
        return {"rates": [50.0, 40.0, 60.0], "contacts": 769, "rows": 2315, "began_at": 0.0, "process_s": 9.0}
    if module == "bench.ours.run_steps":
        rates = {
            "compiled": {"16": [60.0, 80.0], "1": [3.0, 3.0]},
            "native": {"16": [20.0, 20.0], "1": [1.0, 2.0]},
        }
        ready = {"compiled": 5.0, "native": 2.0}
        return {"rates": rates, "ready_s": ready, "began_at": 0.0, "process_s": 9.0}
    if module == "bench.ours.train_layouts":
        trial = {"speed": 2.0, "passed": 0.75, "way": 0.9, "fell": 0.25}
        own = {"training": [(50, 0.9), (100, 1.0)], "rewards": [], "curriculum": [], "wall_s": 10.0}
        return {**own, "tried": {"own": trial, "unseen": trial}, "began_at": 0.0, "process_s": 9.0}
    if module == "bench.ours.train_cohort":
        own = {"training": [(50, 0.9), (100, 1.0)], "rewards": [(100, 5.0)], "returns": [4.0, 6.0]}
        phases = {"trace": 1.0, "compile": 2.0}
        return {**own, "phases": phases, "wall_s": 10.0, "peak_bytes": None, "process_s": 13.0}
    if module == "bench.peers.notebook_star":
        return {"control_steps_per_second": 2.0, "compile_s": 90.0, "began_at": 0.0, "process_s": 9.0}
    if module == "bench.ours.post_job":
        seconds = {"cold": {"mark": 25.0, "video": 40.0}, "warm": {"mark": 12.0, "video": None}}
        return {**seconds, "began_at": 0.0, "process_s": 70.0}
    if module == "bench.ours.train_job":
        seconds = {
            "training_s": 20.0,
            "trained_s": 33.0,
            "learnt_s": 35.0,
            "ended_s": 40.0,
            "steps_per_s": 500.0,
        }
        shown = {"reached": 1.0, "arrived_s": 15.0, "mean_return": 2.8, "steps": 10_000, "phases": {}}
        return {**seconds, **shown, "began_at": 0.0, "process_s": 60.0}
    if module.endswith(".reach_mark"):
        theirs = {"curve": [(50, 1.0, 30.0), (100, 2.0, 60.0)], "reached_s": 60.0, "reached_at": 1062.0}
        own = {"curve": [(50, 2.0, 10.0)], "reached_s": 10.0 + request["seed"], "reached_at": 1012.0}
        parts = {"confirmed": 2.0, "phases": {}, "training_s": 7.0, "evaluation_s": 1.0}
        parts |= {"trained_s": [7.0], "lengths": [100.0]}
        own = theirs if module.startswith("bench.peers") else {**own, **parts}
        return {**own, "began_at": 1000.0, "process_s": 13.0}
    reward = request["seed"] if ours else request["seed"] - 1
    return {
        "training": [(50, 0.9), (100, 1.0)],
        "rewards": [(50, 0.0), (100, reward)],
        "evaluated_s": [5.0, 10.0],
        "phases": {"trace": 1.0, "compile": 2.0, "first_update": 0.5},
        "wall_s": 10.0,
        "evaluation_s": 0.5,
        "first_update_s": 3.0,
        "first_update_at": 1004.0,
        "overflow": 0.0,
        "peak_bytes": 10**9,
        "num_envs": 8,
        "physics": [2000.0, 1000.0, 3000.0],
        "began_at": 1000.0,
        "process_s": 12.0,
        "seconds": SECONDS,
        "need": {"flops": 1e9, "bytes": 1e6},
        "xla": {"flops": 2e9, "bytes": 3e6},
        "gradient_steps": 3,
        "learnt_at": 1007.0,
        "control_steps": 100,
        "episodes": 10,
        "reached": 0.9,
        "arrived_s": 15.0,
        "greedy": [0, 1],
    }


def refused(module: str, request: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
    raise ChildFailed("killed by SIGSEGV: it printed nothing")


def measured(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, run_child: Any = answered, **options: Any
) -> Result:
    monkeypatch.setattr(runs, "run_child", run_child)
    monkeypatch.setattr(runs.tempfile, "tempdir", str(folder))
    return import_module(MODULES[name]).measure(Options(quick=True, out=folder, **options))


def figures(result: Result) -> dict[str, float | None]:
    return {figure.name: figure.value for figure in result.figures}


@pytest.mark.parametrize("name", BENCHES)
def test_a_result_is_made_shown_and_read_again(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = measured(name, tmp_path, monkeypatch)
    assert result.figures or result.table
    assert result.rows
    assert not result.unfinished
    result.save(tmp_path)
    assert report.load(tmp_path) == [result]
    assert result.command in report.markdown(result)


@pytest.mark.parametrize("name", BENCHES)
def test_a_result_of_failures_says_why(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = measured(name, tmp_path, monkeypatch, refused)
    assert "killed by SIGSEGV" in report.markdown(result)
    assert all(figure.value is None for figure in result.figures)


@pytest.mark.parametrize("name", BENCHES)
def test_a_result_without_any_run_says_what_is_left(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = measured(name, tmp_path, monkeypatch, only="nothing")
    assert result.unfinished
    assert "Not made yet" in report.markdown(result)


def test_the_gate_compares_the_seconds_to_the_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = figures(measured("gate", tmp_path, monkeypatch))
    assert found["ant, warm, median of the seeds"] == pytest.approx(10.5)
    assert found["ant, the worst seed ÷ the median"] == pytest.approx(11 / 10.5)
    assert found["ant, cold: Brax ÷ ours"] == pytest.approx(6.0)
    assert found["ant, warm, from the process's start, worst seed"] == pytest.approx(12.0)
    assert found["ant, from the submission to the mark, warm"] == 12.0
    assert found["ant, from the submission to the video, cold"] == 40.0
    assert found["ant, from the submission to the video, warm"] is None


def test_a_seed_that_never_reached_the_mark_is_a_miss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one_fails(module: str, request: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
        run = answered(module, request, timeout_s=timeout_s)
        return run if request.get("seed", 0) == 0 else {**run, "reached_s": None, "reached_at": None}

    result = measured("gate", tmp_path, monkeypatch, one_fails)
    assert figures(result)["ant, warm, median of the seeds"] is None
    assert "1 of 2 runs did not reach the mark" in report.markdown(result)


def test_the_difference_of_returns_is_in_standard_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = measured("gpu_ant", tmp_path, monkeypatch, seeds=3)
    found = figures(result)
    # Ours 0, 1, 2: mean 1, deviation 1, error 1/√3; Brax's -1, 0, 1: the same error. The difference of 1
    # is in errors of √(2/3): 1.2247.
    assert found["our return − that of Brax"] == pytest.approx(1.2247, abs=1e-4)
    ours = next(figure for figure in result.figures if figure.name == "ours, return at the end")
    assert ours.error == pytest.approx(0.57735, abs=1e-5)


def test_a_crash_on_more_gpus_is_a_missed_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def crashing(module: str, request: Mapping[str, Any], *, timeout_s: float) -> dict[str, Any]:
        run = refused if request["devices"] > 1 else answered
        return run(module, request, timeout_s=timeout_s)

    monkeypatch.setattr("bench.gpu.scaling.visible_gpus", lambda: ["nvidia0", "nvidia1"])
    result = measured("gpu_scaling", tmp_path, monkeypatch, crashing)
    gain = next(figure for figure in result.figures if figure.name == "2 GPUs ÷ 1")
    assert (gain.value, gain.met) == (None, False)
    assert "| 2 GPUs ÷ 1 | not measured |  | at least 1.8 | **missed** |" in report.markdown(result)


def test_the_share_of_evaluations_by_default_follows_from_their_cost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Five evaluations took 0.5 s, the second half's 50 steps 0.1 s. The ant's default budget of 3 M steps
    # then trains 6000 s and evaluates ten times: 1 s.
    result = measured("training", tmp_path, monkeypatch)
    assert figures(result)["evaluations' share of the wall, by default"] == pytest.approx(100 / 6001)


def test_a_warm_start_is_told_from_the_call_and_from_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = figures(measured("training", tmp_path, monkeypatch))
    assert found["warm start, the trainer's call to its first update"] == 3.0
    assert found["warm start, the process's begin to its first update"] == 4.0  # 1004 - 1000


def test_a_table_is_compared_with_the_notebooks_loop_and_its_success_with_the_target(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The second half's 50 steps took 0.1 s, and the notebook makes 2 in a second.
    found = figures(measured("q_learning", tmp_path, monkeypatch))
    assert found["ours ÷ the notebook's loop"] == pytest.approx(250)
    assert found["100 episodes, the process's begin to the learnt table, warm"] == 7.0  # 1007 - 1000
    assert found["targets reached, decentralised"] == pytest.approx(90.0)


def test_compiled_physics_is_held_against_native_in_each_round_and_pair_of_trainings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = measured("compiled", tmp_path, monkeypatch)
    found = figures(result)
    # 60 ÷ 20 and 80 ÷ 20; for one environment 3 ÷ 1 and 3 ÷ 2.
    assert found["inverted_pendulum: `compiled` ÷ `native`"] == pytest.approx(3.5)
    assert result.table is not None
    assert result.table.rows[0] == ["inverted_pendulum", "1", "3", "2", "2.2"]
    # Both trainings made their second half's 50 steps in 0.1 s.
    assert found["inverted_pendulum, PPO: `compiled` ÷ `native`"] == pytest.approx(1)


def test_training_is_held_against_a_slower_engine_s_physics_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = figures(measured("gpu_rodent", tmp_path, monkeypatch))
    ours, mjx = found["ours, on Warp"], found["physics alone, MJX-JAX"]
    assert ours is not None
    assert mjx == 2000.0  # the median
    assert found["our training ÷ MJX-JAX's physics alone"] == pytest.approx(ours / mjx)


def test_the_parts_of_an_update_add_up_to_it() -> None:
    parts = profile.split({"seconds": SECONDS})
    assert parts == pytest.approx(
        {
            "physics": 0.004,
            "rest of the environments": 0.001,
            "policy, acting": 0.001,
            "learning": 0.003,  # an update with twice as many passes took 14 ms instead of 11
            "the rest": 0.001,
        }
    )
    assert sum(parts.values()) == pytest.approx(0.010)
