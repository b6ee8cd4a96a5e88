"""Decides the next steps of a sweep: a pure function of its record and of its trials."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice

from core.errors import Misconfigured
from core.sweeps import pbt
from core.sweeps.axes import Values, combinations, num_combinations, random_values
from core.sweeps.pruning import is_to_prune
from core.sweeps.spec import MAX_TRIALS, SweepSpec
from core.sweeps.sweep import Curve, SeenTrial, Sweep, SweepStatus, Trial


@dataclass(frozen=True)
class StartTrial:
    """Begin a trial with these values.

    settings: what its job has besides them. parent, inherited_steps: as in `Trial`.
    """

    number: int
    parameters: Values
    planned_steps: int
    settings: Values = field(default_factory=Values)
    parent: int | None = None
    inherited_steps: int = 0


@dataclass(frozen=True)
class PruneTrial:
    """End the trial early and keep its work."""

    trial: Trial


@dataclass(frozen=True)
class CancelTrial:
    """Cancel the trial's job, because it is pruned or the sweep is cancelled; again, if that was done."""

    trial: Trial


@dataclass(frozen=True)
class EndSweep:
    """The sweep is over."""

    status: SweepStatus
    message: str


Decision = StartTrial | PruneTrial | CancelTrial | EndSweep


def advance(sweep: Sweep, seen: Sequence[SeenTrial], steps_of: Callable[[Values], int]) -> Sequence[Decision]:
    """The next decisions; the same records give the same ones.

    seen: all trials by their number. steps_of: the environment steps that a trial with these values may take.
    """
    going = [one.trial for one in seen if not one.is_over]
    if sweep.status == SweepStatus.CANCELLING:
        return [*map(CancelTrial, going)] or [
            EndSweep(SweepStatus.CANCELLED, _summary("It was cancelled", seen))
        ]
    ending: list[Decision] = [CancelTrial(trial) for trial in going if trial.is_pruned]
    ending += [PruneTrial(trial) for trial in _worth_ending(sweep.spec, seen)]
    try:
        starts, why = _starts(sweep, seen, steps_of)
    except Misconfigured as error:
        return ending if going else [EndSweep(SweepStatus.FAILED, error.detail)]
    except pbt.DiedOut as error:
        return ending if going else [EndSweep(SweepStatus.FAILED, _summary(str(error), seen))]
    if why is not None and not going and not starts:
        return [EndSweep(SweepStatus.SUCCEEDED, _summary(why, seen))]
    return [*ending, *starts]


def why_no_more(spec: SweepSpec, trials: Sequence[Trial]) -> str | None:
    """Why no further trial may start, whatever its values: the beginning of a sentence. None if one may."""
    budget = spec.budget
    if spec.method == "grid" and len(trials) >= num_combinations(spec.parameters):
        return "Every combination was tried"
    if spec.population is not None and len(trials) >= pbt.num_trials(spec.population, trials):
        return "Every generation was trained"
    if len(trials) >= num_trials(spec, trials):
        return "Its budget of jobs is used"
    if budget.gpu_hours is not None and sum(trial.gpu_hours for trial in trials) >= budget.gpu_hours:
        return "Its budget of GPU hours is used"
    return None


def committed_steps(trials: Sequence[Trial]) -> int:
    """The environment steps that trials took, or may still take."""
    return sum(trial.planned_steps if trial.outcome is None else trial.steps for trial in trials)


def num_trials(spec: SweepSpec, trials: Sequence[Trial]) -> int:
    """The most trials that it may have, after these."""
    most = spec.budget.jobs or MAX_TRIALS
    if spec.population is not None:
        return min(most, pbt.num_trials(spec.population, trials))
    return min(most, num_combinations(spec.parameters)) if spec.method == "grid" else most


def _starts(
    sweep: Sweep, seen: Sequence[SeenTrial], steps_of: Callable[[Values], int]
) -> tuple[Sequence[StartTrial], str | None]:
    """As many as may run side by side, each drawn with those before it; and why no more may start, if so.

    Raises Misconfigured, pbt.DiedOut.
    """
    spec, found, known = sweep.spec, list[StartTrial](), list(seen)
    while True:
        trials = [one.trial for one in known]
        if (why := why_no_more(spec, trials)) is not None:
            return found, why
        if sum(not one.is_over for one in known) >= spec.budget.parallel:
            return found, None
        if spec.population is not None and pbt.is_to_wait(spec.population, trials):
            return found, None
        start = _start(spec, known, steps_of)
        needed = committed_steps(trials) + start.planned_steps
        if spec.budget.steps is not None and needed > spec.budget.steps:
            return found, "Its budget of steps is used"
        found.append(start)
        trial = Trial(
            number=start.number,
            job=None,
            parameters=start.parameters,
            planned_steps=start.planned_steps,
            created_at=sweep.created_at,
        )
        known.append(SeenTrial(trial))


def _start(spec: SweepSpec, seen: Sequence[SeenTrial], steps_of: Callable[[Values], int]) -> StartTrial:
    """The start of the next trial. Raises pbt.DiedOut; Misconfigured where the method lacks a package."""
    number = len(seen)
    if spec.population is not None:
        begun = pbt.beginning(spec, spec.population, [one.trial for one in seen])
        steps = max(0, steps_of({**begun.parameters, **begun.settings}) - begun.inherited_steps)
        return StartTrial(
            number, begun.parameters, steps, begun.settings, begun.parent, begun.inherited_steps
        )
    values = _drawn(spec, number, seen)
    return StartTrial(number, values, steps_of(values))


def _drawn(spec: SweepSpec, number: int, seen: Sequence[SeenTrial]) -> Values:
    match spec.method:
        case "grid":
            return next(islice(combinations(spec.parameters), number, None))
        case "random" | "pbt":
            return random_values(spec, number)
        case "qmc" | "tpe" | "cma_es" | "nsga2":
            from core.sweeps.samplers import ask  # Loads Optuna.

            return ask(spec, number, seen)


def _worth_ending(spec: SweepSpec, seen: Sequence[SeenTrial]) -> Iterator[Trial]:
    if spec.pruning is None:
        return
    sign = spec.objectives[0].sign
    curves: Mapping[int, Curve] = {
        one.trial.number: {step: sign * value for step, value in one.curve.items()} for one in seen
    }
    ended = {one.trial.number for one in seen if one.is_over}
    for one in seen:
        trial = one.trial
        if (
            trial.outcome is None
            and not trial.is_pruned
            and is_to_prune(spec.pruning, trial.number, curves, ended)
        ):
            yield trial


def _summary(why: str, seen: Sequence[SeenTrial]) -> str:
    counted: dict[str, int] = {}
    for one in seen:
        outcome = one.trial.outcome or "running"
        counted[outcome] = counted.get(outcome, 0) + 1
    told = ", ".join(f"{number} {outcome}" for outcome, number in counted.items())
    return f"{why}: {told or 'no trial began'}."
