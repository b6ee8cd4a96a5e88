"""Which engines there are, and which one a run gets; imports no numerical code, so that the API may ask."""

from dataclasses import dataclass
from typing import Literal

from core.errors import Problem, Rejected

EngineName = Literal["native", "mjx", "warp"]
PhysicsChoice = Literal["auto", "native", "mjx", "warp"]

# Engines that a job may name and that this version cannot build yet.
_MISSING: dict[str, str] = {
    "warp": "The engine 'warp' is not part of this version; ask for 'auto', 'native' or 'mjx'."
}


@dataclass(frozen=True)
class EngineChoice:
    """An engine, and one sentence that says why it was taken."""

    name: EngineName
    reason: str


def check_physics(choice: PhysicsChoice) -> None:
    """Raises Rejected where this version has no such engine."""
    if choice in _MISSING:
        raise Rejected(_MISSING[choice], [Problem("/physics", _MISSING[choice])])


def choose(choice: PhysicsChoice, device: Literal["cpu", "gpu"]) -> EngineChoice:
    """The engine for a job's `physics` on this device. Raises Rejected where there is no such engine."""
    check_physics(choice)
    if choice != "auto":
        return EngineChoice(choice, f"The job asks for {choice}.")
    if device == "cpu":
        return EngineChoice(
            "native", "On a CPU, C MuJoCo is many times faster than MJX at the same solver accuracy."
        )
    return EngineChoice("mjx", "On a GPU, MJX steps thousands of worlds without leaving the device.")
