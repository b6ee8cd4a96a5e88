"""The engines, and which one a run gets; imports no numerical code, so that the API can use it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, get_args

from core.errors import JobFailed, Problem, Rejected
from core.installation import to_install
from core.reasons import Reason

EngineName = Literal["native", "mjx", "warp", "compiled"]
PhysicsChoice = Literal["auto", "native", "mjx", "warp", "compiled"]

NO_REFUSALS: Mapping[EngineName, str] = {}
# The package that an engine needs and a worker may lack, by its import name; the extra has the engine's name.
PACKAGES: Mapping[EngineName, str] = {"compiled": "llvmlite", "warp": "warp"}


@dataclass(frozen=True)
class BodySize:
    """The size of a user's own model: its degrees of freedom, and pairs of geoms that may touch."""

    num_dofs: int
    num_pairs: int


@dataclass(frozen=True)
class Rule:
    """A choice of `auto`: an engine, for at least `least_num_envs` environments. reason: a sentence.
    most: the largest body; None: any.

    An environment's row lists its rules for each kind of device (`EnvironmentInfo.rules_on`); the figures in
    their reasons are training steps per second under the tuned settings (docs/performance.md).
    """

    engine: EngineName
    least_num_envs: int
    reason: str
    most: BodySize | None = None

    def fits(self, num_envs: int, body: BodySize | None) -> bool:
        """body: None if it is not known, which fits no limit."""
        return num_envs >= self.least_num_envs and (self.most is None or _is_within(body, self.most))


def _is_within(body: BodySize | None, most: BodySize) -> bool:
    return body is not None and body.num_dofs <= most.num_dofs and body.num_pairs <= most.num_pairs


@dataclass(frozen=True)
class EngineChoice:
    """An engine, and one sentence on why it was chosen."""

    name: EngineName
    reason: str


def is_installed(engine: EngineName) -> bool:
    """Whether what the engine needs is installed here; loads nothing."""
    package = PACKAGES.get(engine)
    return package is None or find_spec(package) is not None


def check_installed(engine: EngineName) -> None:
    """Raises JobFailed("no_device") if this worker lacks the package that the engine needs."""
    if not is_installed(engine):
        raise JobFailed(
            Reason.NO_DEVICE,
            f"The job asks for the engine {engine!r}, which this worker does not have. Install it "
            f"there with `{to_install(engine)}`, or ask for 'auto', 'native' or 'mjx'.",
        )


def share_states(one: str, other: str) -> bool:
    """Whether environments that one engine moved can go on under the other. Warp's have a field more."""
    return (one == "warp") == (other == "warp")


CHOOSE_ANOTHER = "Choose another engine, or omit `physics`."


def beyond(engine: EngineName, reason: str) -> str:
    """The sentence that refuses an engine. reason: such as "its geom 'hills' is a height field"."""
    return f"The engine '{engine}' cannot run the model: {reason}. {CHOOSE_ANOTHER}"


def beyond_compiled(reason: str) -> str:
    """The sentence that refuses the engine `compiled`. reason: that of `compiled.coverage.uncovered`."""
    return beyond("compiled", reason)


NEWTON_ALONE = "its job asks for the solver 'cg', and 'compiled' has Newton's alone"
"""Why the engine `compiled` cannot run a job that asks for conjugate gradients."""


def check_physics(choice: PhysicsChoice, cannot_run: Mapping[EngineName, str] = NO_REFUSALS) -> None:
    """Raises Rejected if the engine that the job names cannot run the environment, or none can.

    cannot_run: engines that cannot run it under its options or with its model, and why.
    """
    if choice != "auto" and (why := cannot_run.get(choice)):
        raise Rejected(why, [Problem("/physics", why)])
    if choice == "auto" and set(get_args(EngineName)) <= set(cannot_run):
        why = "No engine can run it. " + cannot_run["native"].removesuffix(CHOOSE_ANOTHER).strip()
        raise Rejected(why, [Problem("/physics", why)])


def choose(
    choice: PhysicsChoice,
    device: Literal["cpu", "gpu"],
    num_envs: int = 1,
    rules: Sequence[Rule] = (),
    cannot_run: Mapping[EngineName, str] = NO_REFUSALS,
    body: BodySize | None = None,
) -> EngineChoice:
    """The engine for a job's `physics` on this device. Raises Rejected if it cannot run the environment.

    rules: the environment's on this device; the first that fits decides. If none does, `native` is taken on
    a CPU and MJX on a GPU. cannot_run: as for `check_physics`. body: its size, where a rule
    asks for it.
    """
    check_physics(choice, cannot_run)
    if choice != "auto":
        return EngineChoice(choice, f"The job asks for {choice}.")
    here = [rule for rule in rules if is_installed(rule.engine)]
    return choose_by_rules(device, num_envs, here, cannot_run, body)


def choose_by_rules(
    device: Literal["cpu", "gpu"],
    num_envs: int,
    rules: Sequence[Rule],
    cannot_run: Mapping[EngineName, str],
    body: BodySize | None,
) -> EngineChoice:
    """The engine that `auto` takes where the engines of all these rules are installed; as `choose`."""
    for rule in rules:
        if rule.engine not in cannot_run and rule.fits(num_envs, body):
            return EngineChoice(rule.engine, rule.reason)
    if device == "cpu" and "native" in cannot_run and "mjx" not in cannot_run:
        return EngineChoice("mjx", f"Native physics cannot run it: {cannot_run['native']}")
    if device == "cpu":
        return EngineChoice(
            "native", "On a CPU, C MuJoCo is many times faster than MJX at the same solver accuracy."
        )
    if "mjx" in cannot_run:
        return EngineChoice("native", f"MJX cannot run the model: {cannot_run['mjx']}")
    return EngineChoice("mjx", "On a GPU, MJX steps thousands of environments without leaving the device.")
