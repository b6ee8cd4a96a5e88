"""What the training benches ask for."""

import pytest

from bench.measure import requests
from bench.measure.result import Options
from bench.peers.published import PUBLISHED
from core.errors import Rejected
from core.physics import availability

SMALL = {"num_envs": 8, "batch_size": 4, "num_minibatches": 4, "unroll_length": 5}  # 80 steps an update


def test_an_equal_budget_is_whole_updates_in_each_of_the_peers_epochs() -> None:
    # 3 epochs of 80 steps are 240; 1000 steps need five times as many.
    given = requests.equal_budget("cpu", "ant", {**SMALL, "num_timesteps": 1000}, epochs=3)
    assert given["num_timesteps"] == 1200


def test_the_ants_published_budget_is_93_updates_of_both() -> None:
    # 2048 × 32 × 5 = 327,680 steps; 30 M are 91.6 updates, and the next number that 3 divides is 93.
    given = requests.equal_budget("gpu", "ant", {**PUBLISHED["ant"], "num_timesteps": 30_000_000}, epochs=3)
    assert given["num_timesteps"] == 93 * 327_680


def test_brax_keeps_the_rate_that_ours_lowers_along_a_line_and_no_other_schedule_is_replaced() -> None:
    asked = requests.brax("gpu", "hopper", "native", {}, epochs=1)["settings"]
    assert asked == {"learning_rate_schedule": "NONE"}
    adaptive = {"learning_rate_schedule": "ADAPTIVE_KL"}
    assert requests.brax("gpu", "hopper", "native", adaptive, epochs=1)["settings"] == adaptive
    assert requests.brax("gpu", "ant", "native", {}, epochs=1)["settings"] == {}


def test_settings_that_do_not_go_together_are_refused_before_anything_runs() -> None:
    with pytest.raises(Rejected, match="num_envs"):
        requests.settings("gpu", "ant", Options(), num_envs=3000)


def test_a_gpu_bench_is_not_made_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "visible_gpus", list)
    with pytest.raises(SystemExit, match="gpu_ant needs a GPU"):
        requests.gpu("gpu_ant", Options())
    assert requests.gpu("gpu_ant", Options(quick=True)) == "cpu"


def test_a_gpu_bench_is_not_made_on_another_engine_than_that_of_its_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(availability.PACKAGES, "warp", "no_such_package")
    with pytest.raises(SystemExit, match="'warp', which is not installed here"):
        requests.engine("gpu", "rodent", {})
    assert requests.engine("gpu", "rodent", {}, quick=True) != "warp"
    monkeypatch.setitem(availability.PACKAGES, "warp", "json")  # Any that is there.
    assert requests.engine("gpu", "rodent", {}) == "warp"
