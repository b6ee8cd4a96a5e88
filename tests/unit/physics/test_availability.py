"""Which engine a job gets."""

import pytest

from core.errors import Rejected
from core.physics import availability
from core.physics.availability import (
    BodySize,
    EngineChoice,
    EngineName,
    PhysicsChoice,
    Rule,
    check_physics,
    choose,
)

RULES = (
    Rule("native", 8192, "Many ants."),
    Rule("warp", 1024, "Ants."),
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
        ("compiled", "cpu", "compiled"),
        ("compiled", "gpu", "compiled"),
    ],
)
def test_auto_goes_by_the_device_and_a_name_is_obeyed(
    choice: PhysicsChoice, device: str, engine: EngineName
) -> None:
    chosen = choose(choice, "gpu" if device == "gpu" else "cpu")
    assert chosen.name == engine
    assert chosen.reason.endswith(".")


@pytest.mark.parametrize(
    ("num_envs", "with_warp", "without"),
    [(1, "mjx", "mjx"), (1023, "mjx", "mjx"), (1024, "warp", "mjx"), (8192, "native", "native")],
)
def test_auto_takes_the_first_rule_that_fits_and_that_the_worker_can_follow(
    num_envs: int, with_warp: str, without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for is_there, engine in ((True, with_warp), (False, without)):
        monkeypatch.setattr(availability, "find_spec", lambda name, found=is_there: found or None)
        assert choose("auto", "gpu", num_envs, RULES).name == engine
        assert choose("auto", "cpu", num_envs).name == "native"
        assert choose("mjx", "gpu", num_envs, RULES).name == "mjx"


def test_a_rule_is_passed_over_whose_engine_cannot_run_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(availability, "find_spec", lambda name: True)
    assert choose("auto", "gpu", 8192, RULES, {"native": "It cannot."}).name == "warp"


def test_a_rule_for_compiled_is_followed_where_its_compiler_is_and_it_can_run_the_body(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rules = (Rule("compiled", 64, "Small bodies."), Rule("warp", 64, "Ants."))
    monkeypatch.setattr(availability, "find_spec", lambda name: True)
    assert choose("auto", "gpu", 64, rules).reason == "Small bodies."
    assert choose("auto", "gpu", 63, rules).name == "mjx"
    assert choose("auto", "gpu", 64, rules, {"compiled": "It cannot."}).name == "warp"
    monkeypatch.setattr(availability, "find_spec", lambda name: None if name == "llvmlite" else True)
    assert choose("auto", "gpu", 64, rules).name == "warp"


def test_a_cpu_has_rules_of_its_own_and_native_where_none_can_be_followed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rules = (Rule("compiled", 16, "Small bodies."),)
    monkeypatch.setattr(availability, "find_spec", lambda name: True)
    assert choose("auto", "cpu", 16, rules) == EngineChoice("compiled", "Small bodies.")
    assert choose("auto", "cpu", 15, rules).name == "native"
    assert choose("native", "cpu", 16, rules).name == "native"
    assert choose("auto", "cpu", 16, rules, {"compiled": "It cannot."}).name == "native"
    # Where native cannot run it either, what can is taken.
    assert choose("auto", "cpu", 16, rules, {"native": "It cannot."}).name == "compiled"
    monkeypatch.setattr(availability, "find_spec", lambda name: None)
    assert choose("auto", "cpu", 16, rules).name == "native"


def test_a_rule_for_small_bodies_is_followed_where_the_body_is_known_to_be_small(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    most = BodySize(num_dofs=30, num_pairs=50)
    rules = (Rule("compiled", 1, "Small bodies.", most=most), Rule("warp", 1, "Larger ones."))
    monkeypatch.setattr(availability, "find_spec", lambda name: True)
    bodies = (BodySize(14, 4), most, BodySize(31, 4), BodySize(14, 51), None)
    taken = [choose("auto", "gpu", 1, rules, body=body).name for body in bodies]
    assert taken == ["compiled", "compiled", "warp", "warp", "warp"]


def test_a_rules_reason_is_the_choices() -> None:
    assert choose("auto", "gpu", 8192, RULES).reason == "Many ants."


def test_an_engine_that_cannot_run_an_environment_is_refused_with_its_place() -> None:
    cannot_run: dict[EngineName, str] = {"mjx": "MJX cannot run the ant."}
    with pytest.raises(Rejected, match="cannot run the ant") as refusal:
        check_physics("mjx", cannot_run)
    assert [problem.pointer for problem in refusal.value.problems] == ["/physics"]
    with pytest.raises(Rejected, match="cannot run the ant"):
        choose("mjx", "gpu", cannot_run=cannot_run)
    check_physics("native", cannot_run)
    check_physics("auto", cannot_run)
