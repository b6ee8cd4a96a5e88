"""Which engine a job gets."""

import pytest

from core.errors import Rejected
from core.physics.availability import EngineName, PhysicsChoice, check_physics, choose


@pytest.mark.parametrize(
    ("choice", "device", "engine"),
    [
        ("auto", "cpu", "native"),
        ("auto", "gpu", "mjx"),
        ("native", "gpu", "native"),
        ("mjx", "cpu", "mjx"),
    ],
)
def test_auto_goes_by_the_device_and_a_name_is_obeyed(
    choice: PhysicsChoice, device: str, engine: EngineName
) -> None:
    chosen = choose(choice, "gpu" if device == "gpu" else "cpu")
    assert chosen.name == engine
    assert chosen.reason.endswith(".")


def test_an_engine_that_is_not_there_is_refused_with_its_place() -> None:
    with pytest.raises(Rejected, match="'warp' is not part of this version") as refusal:
        check_physics("warp")
    assert [problem.pointer for problem in refusal.value.problems] == ["/physics"]
    with pytest.raises(Rejected, match="warp"):
        choose("warp", "gpu")
