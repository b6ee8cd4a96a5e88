"""The search for settings, on runs that are made up."""

import json
import sys
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.trial import FixedTrial

from bench.measure import requests
from bench.measure.marks import Mark
from bench.tune import __main__ as search
from bench.tune.space import first_trial, settings_of
from bench.tune.task import Task
from core.environments.info import Device

TASK = Task(
    "inverted_pendulum",
    "cpu",
    Mark("eval/episode_reward", 10.0, ""),
    20.0,
    100,
    "tests.unit.bench.tune_probe",
)


def params(**changes: Any) -> dict[str, Any]:
    return {**first_trial("inverted_pendulum", "cpu"), **changes}


@pytest.mark.parametrize("device", ["cpu", "gpu"])
@pytest.mark.parametrize("body", ["ant", "humanoid", "hopper", "rodent", "brittle_star"])
def test_the_first_trial_is_near_the_present_settings(body: str, device: Device) -> None:
    settings = settings_of(FixedTrial(first_trial(body, device)))
    resolved = requests.resolved(device, body, settings)
    present = requests.resolved(device, body, {})
    assert resolved.discounting == pytest.approx(present.discounting)
    assert resolved.bootstrap_on_timeout == present.bootstrap_on_timeout


@pytest.mark.parametrize(("body", "device"), [("ant", "cpu"), ("ant", "gpu"), ("humanoid", "gpu")])
def test_the_first_trial_has_the_present_networks_where_the_space_has_them(body: str, device: Device) -> None:
    resolved = requests.resolved(device, body, settings_of(FixedTrial(first_trial(body, device))))
    present = requests.resolved(device, body, {})
    assert list(resolved.policy_hidden_layer_sizes) == list(present.policy_hidden_layer_sizes)
    assert list(resolved.value_hidden_layer_sizes) == list(present.value_hidden_layer_sizes)


@pytest.mark.parametrize("envs", [5, 11])
@pytest.mark.parametrize("unrolls", [0, 3])
@pytest.mark.parametrize("minibatches", [1, 5])
def test_settings_at_the_ends_of_the_space_go_together(envs: int, unrolls: int, minibatches: int) -> None:
    sizes = {"log2_num_envs": envs, "log2_unrolls_per_env": unrolls, "log2_num_minibatches": minibatches}
    settings = settings_of(FixedTrial(params(**sizes)))
    assert (
        requests.resolved("cpu", "ant", settings).actions_per_update == 2**unrolls * settings["unroll_length"]
    )


def test_a_trial_counts_the_seconds_to_the_mark() -> None:
    # At 1 a second, 10 is reached after 10 s.
    assert TASK.worst_seconds(FixedTrial(params(learning_rate=1e-3))) == 10.0


def test_a_run_that_does_not_reach_the_mark_counts_as_longer_than_it_had() -> None:
    # 0.1 a second: 2.1 of 10 when its 20 s are over.
    assert TASK.worst_seconds(FixedTrial(params(learning_rate=1e-4))) == pytest.approx(20 * (2 - 0.21))


def test_a_run_that_diverges_counts_as_one_that_went_nowhere() -> None:
    assert TASK.worst_seconds(FixedTrial(params(learning_rate=2.5e-3, activation="tanh"))) == 40.0


def test_a_run_that_breaks_ends_the_search_with_what_it_said() -> None:
    with pytest.raises(RuntimeError, match="It broke"):
        TASK.worst_seconds(FixedTrial(params(learning_rate=2.5e-3, activation="elu")))


def test_a_trial_that_is_behind_is_stopped() -> None:
    study = optuna.create_study(pruner=optuna.pruners.ThresholdPruner(upper=-0.5))
    study.enqueue_trial(params(learning_rate=1e-4))
    study.optimize(TASK.worst_seconds, n_trials=1)
    # 0.2 after the first tenth of its 20 s, where 0.5 was wanted.
    assert study.trials[0].state == optuna.trial.TrialState.PRUNED
    assert study.trials[0].intermediate_values == {1: pytest.approx(-0.2)}


def test_a_search_ends_with_what_other_seeds_confirm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))
    monkeypatch.setattr(search, "Task", lambda *given: Task(*given, module=TASK.module))
    arguments = [
        "inverted_pendulum",
        "--mark",
        "eval/episode_reward=10",
        "--trials",
        "15",
        "--seconds",
        "20",
    ]
    monkeypatch.setattr(sys, "argv", ["tune", *arguments])
    assert search.main() == 0
    told = capsys.readouterr().out
    assert "over 5 seeds" in told
    assert "trial 0 again" in told  # the present settings
    found = json.loads((tmp_path / "tuned-inverted_pendulum-cpu.json").read_text())
    assert found["mark"]["least"] == 10
    assert found["command"] == " ".join(["./run tune", *arguments])
    rate = found["settings"]["learning_rate"]
    # Those seeds are half as fast.
    assert all(second == pytest.approx(10 / (500 * rate), abs=1) for second in found["seconds"])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nobody"], "There is no environment 'nobody'"),
        (["reacher"], "Nobody has set a mark for 'reacher' on a CPU"),
        (["ant", "--mark", "eval/forward_speed"], "invalid _mark value"),
        (["mjcf"], "For such a body a sweep searches"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    arguments: list[str], sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["tune", *arguments])
    with pytest.raises(SystemExit) as refused:
        search.main()
    assert sentence in f"{refused.value}{capsys.readouterr().err}"
