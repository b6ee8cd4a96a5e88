"""Which engines there are, and which one a run gets; imports no numerical code, so that the API may ask."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal

from core.errors import Problem, Rejected

EngineName = Literal["native", "mjx", "warp"]
PhysicsChoice = Literal["auto", "native", "mjx", "warp"]

# (engine, environment) that cannot be together, and why; a job that asks for it is refused when it is
# submitted. What depends on an environment's options is in its row (`EnvironmentInfo.cannot_run`).
CANNOT_RUN: dict[tuple[EngineName, str], str] = {}
NO_REFUSALS: Mapping[EngineName, str] = {}


@dataclass(frozen=True)
class Rule:
    """On a GPU, this engine for this environment from so many worlds on; the reason ends in a full stop."""

    environment: str
    least_worlds: int
    engine: EngineName
    reason: str


_BRITTLE_STARS = ("brittle_star", "brittle_star_light_escape", "brittle_star_undirected")

# What measurements say `auto` should do on a GPU; the first rule that fits is taken, and MJX without one.
# Training steps a second on one H200, under the tuned settings (docs/performance.md).
ON_A_GPU: tuple[Rule, ...] = (
    Rule("ant", 1024, "warp", "Measured on an H200: 1.23 M training steps/s, 0.99 M by mjx."),
    *(
        Rule(star, 1, "warp", "Measured on an H200: 243 k actions/s in training, 21 k by native on 16 cores.")
        for star in _BRITTLE_STARS
    ),
    *(
        Rule(star, 1, "native", "MJX steps 7.7 k a second on an H200, C MuJoCo 20 k on one core.")
        for star in _BRITTLE_STARS
    ),
    Rule("corridor", 1, "warp", "Platforms make many pairs of shapes, of which MJX looks at all."),
    Rule("corridor", 1, "native", "Platforms make many pairs of shapes, of which MJX looks at all."),
    Rule("half_cheetah", 1024, "warp", "Measured on an H200: 597 k training steps/s, 87 k by mjx."),
    Rule("hopper", 1024, "warp", "Measured on an H200: 1.04 M training steps/s, 141 k by mjx."),
    Rule("humanoid", 1024, "warp", "Measured on an H200: 571 k training steps/s, 415 k by mjx."),
    Rule("inverted_pendulum", 1024, "warp", "Measured on an H200: 1.54 M training steps/s, 635 k by mjx."),
    Rule("mjcf", 1, "warp", "On an H200 it was the fastest for every body that was measured."),
    Rule("reacher", 1024, "warp", "Measured on an H200: 921 k training steps/s, 306 k by mjx."),
    Rule("rodent", 1, "warp", "Measured on an H200: 133 k control steps/s of physics, 21 k by mjx."),
    Rule("rodent", 1, "native", "MJX compiles its training for many minutes, for 21 k steps/s on an H200."),
    Rule("walker2d", 1024, "warp", "Measured on an H200: 905 k training steps/s, 114 k by mjx."),
)


@dataclass(frozen=True)
class EngineChoice:
    """An engine, and one sentence that says why it was taken."""

    name: EngineName
    reason: str


def has_warp() -> bool:
    """Whether the extra `warp` is installed here; loads nothing."""
    return find_spec("warp") is not None


def check_physics(
    choice: PhysicsChoice, environment: str = "", cannot_run: Mapping[EngineName, str] = NO_REFUSALS
) -> None:
    """Raises Rejected where the engine that is asked for cannot run this environment.

    cannot_run: engines that cannot because of its options or its model, and why.
    """
    if choice != "auto" and (why := CANNOT_RUN.get((choice, environment)) or cannot_run.get(choice)):
        raise Rejected(why, [Problem("/physics", why)])


def choose(
    choice: PhysicsChoice,
    device: Literal["cpu", "gpu"],
    environment: str = "",
    num_worlds: int = 1,
    cannot_run: Mapping[EngineName, str] = NO_REFUSALS,
) -> EngineChoice:
    """The engine for a job's `physics` on this device. Raises Rejected where it cannot run it.

    cannot_run: as for `check_physics`.
    """
    check_physics(choice, environment, cannot_run)
    if choice != "auto":
        return EngineChoice(choice, f"The job asks for {choice}.")
    if device == "cpu" and "native" in cannot_run and "mjx" not in cannot_run:
        return EngineChoice("mjx", f"Native physics cannot run it: {cannot_run['native']}")
    if device == "cpu":
        return EngineChoice(
            "native", "On a CPU, C MuJoCo is many times faster than MJX at the same solver accuracy."
        )
    for rule in ON_A_GPU:
        fits = rule.environment == environment and num_worlds >= rule.least_worlds
        fits = fits and rule.engine not in cannot_run
        if fits and (rule.engine != "warp" or has_warp()):
            return EngineChoice(rule.engine, rule.reason)
    if "mjx" in cannot_run:
        return EngineChoice("native", f"MJX cannot run the model: {cannot_run['mjx']}")
    return EngineChoice("mjx", "On a GPU, MJX steps thousands of worlds without leaving the device.")
