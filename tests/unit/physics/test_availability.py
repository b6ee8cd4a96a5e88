"""Which engine a job gets."""

from importlib.util import find_spec

import pytest

from core.errors import Rejected
from core.physics import availability
from core.physics.availability import EngineName, PhysicsChoice, Rule, check_physics, choose

RULES = (
    Rule("ant", 8192, "native", "Many ants."),
    Rule("ant", 1024, "warp", "Ants."),
    Rule("humanoid", 1, "warp", "Humanoids."),
)


@pytest.mark.parametrize(
    ("choice", "device", "engine"),
    [
        ("auto", "cpu", "native"),
        ("auto", "gpu", "mjx"),
        ("native", "gpu", "native"),
        ("mjx", "cpu", "mjx"),
        ("warp", "gpu", "warp"),
        ("warp", "cpu", "warp"),
    ],
)
def test_auto_goes_by_the_device_and_a_name_is_obeyed(
    choice: PhysicsChoice, device: str, engine: EngineName
) -> None:
    chosen = choose(choice, "gpu" if device == "gpu" else "cpu")
    assert chosen.name == engine
    assert chosen.reason.endswith(".")


@pytest.mark.parametrize(
    ("environment", "num_worlds", "with_warp", "without"),
    [
        ("ant", 1023, "mjx", "mjx"),
        ("ant", 1024, "warp", "mjx"),
        ("ant", 8192, "native", "native"),
        ("humanoid", 1, "warp", "mjx"),
        ("hopper", 8192, "mjx", "mjx"),
    ],
)
def test_auto_takes_the_first_rule_that_fits_and_that_the_worker_can_follow(
    environment: str, num_worlds: int, with_warp: str, without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(availability, "ON_A_GPU", RULES)
    for is_there, engine in ((True, with_warp), (False, without)):
        monkeypatch.setattr(availability, "find_spec", lambda name, found=is_there: found or None)
        assert choose("auto", "gpu", environment, num_worlds).name == engine
        assert choose("auto", "cpu", environment, num_worlds).name == "native"
        assert choose("mjx", "gpu", environment, num_worlds).name == "mjx"


def test_a_rules_reason_is_the_choices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(availability, "ON_A_GPU", RULES)
    assert choose("auto", "gpu", "ant", 8192).reason == "Many ants."


def test_an_engine_that_cannot_run_an_environment_is_refused_with_its_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(availability, "CANNOT_RUN", {("mjx", "ant"): "MJX cannot run the ant."})
    with pytest.raises(Rejected, match="cannot run the ant") as refusal:
        check_physics("mjx", "ant")
    assert [problem.pointer for problem in refusal.value.problems] == ["/physics"]
    with pytest.raises(Rejected, match="cannot run the ant"):
        choose("mjx", "gpu", "ant")
    check_physics("mjx", "hopper")
    check_physics("auto", "ant")


def test_whether_warp_is_there_is_told_without_loading_it() -> None:
    assert availability.has_warp() == (find_spec("warp") is not None)
