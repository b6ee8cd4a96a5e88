"""Population-based training: which trial each one resumes from, and with which settings.

Trial `generation × size + member` trains a member for one generation. Source: Jaderberg et al., Population
Based Training of Neural Networks (2017), algorithm 1 and section 4.1. A generation of which a cancel left no
run to continue begins again under the numbers that follow, so that a cancelled sweep can be resumed.

Generations are synchronous, unlike the paper's: one begins when all trials of the one before have ended. What
a trial begins with is then a function of records that no longer change, so every process decides alike, and
no rule is needed for a member that is far behind the others.
"""

import random
from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import JsonValue

from core.jobs.spec import TrainSpec
from core.sweeps.axes import Values, neighbours, random_values, scaled, value_at
from core.sweeps.spec import Axis, Population, Range, SweepSpec
from core.sweeps.sweep import Trial

LENGTH = "algorithm.num_timesteps"
_LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True)
class Beginning:
    """A trial's starting point.

    settings: of its job, besides `parameters`. parent, inherited_steps: as in `Trial`.
    """

    parameters: Values
    settings: Values
    parent: int | None = None
    inherited_steps: int = 0


class DiedOut(Exception):
    """No run of a generation can be continued: the beginning of a sentence."""


def beginning(spec: SweepSpec, population: Population, trials: Sequence[Trial]) -> Beginning:
    """The beginning of the next trial; trials of earlier generations have ended. Raises DiedOut.

    A member continues, unless it is among the worst or has no value: then it takes the checkpoint of one of
    the best, and changes its settings.
    """
    number = len(trials)
    member = number % population.size
    trained = [one for one in _rounds(population, trials[: number - member]) if not _is_to_repeat(one)]
    generation = len(trained)
    # Each begins with a seed of its own; a run that resumes has its parent's random state.
    seed = (spec.job.seed + member) % (_LARGEST_SEED + 1)
    settings = Values({LENGTH: steps_until(spec, population, generation), "seed": seed})
    if generation == 0:
        return Beginning(random_values(spec, number), settings)
    before = trained[-1]
    ranked = _ranked(before, spec.objectives[0].sign)
    if not ranked:
        raise DiedOut(f"No trial of generation {generation - 1} has a value and a job to resume from")
    parent = before[member]
    parameters = parent.parameters
    # Those without a value are the worst.
    if parent not in ranked[: population.size - population.num_replaced]:
        generator = random.Random(f"{spec.seed}/{number}/parent")  # noqa: S311 # Not for secrets.
        parent = generator.choice(ranked[: population.num_replaced])
        parameters = _explored(spec, population, number, parent.parameters)
    settings["resume_from"] = {"job": parent.job}
    return Beginning(parameters, settings, parent.number, parent.inherited_steps + parent.steps)


def is_to_wait(population: Population, trials: Sequence[Trial]) -> bool:
    """Whether the next trial is of a generation that begins after those that still run."""
    earlier = len(trials) // population.size * population.size
    return any(trial.outcome is None for trial in trials[:earlier])


def generations(population: Population, trials: Sequence[Trial]) -> list[int]:
    """The generation of each of the trials, the first is 0."""
    found, generation = list[int](), 0
    for one in _rounds(population, trials):
        found += [generation] * len(one)
        generation += not _is_to_repeat(one)
    return found


def num_trials(population: Population, trials: Sequence[Trial]) -> int:
    """How many trials train all generations, with those of these trials that count for none."""
    whole = len(trials) // population.size * population.size
    repeated = sum(map(_is_to_repeat, _rounds(population, trials[:whole])))
    return population.num_trials + repeated * population.size


def steps_until(spec: SweepSpec, population: Population, generation: int) -> int:
    """Environment steps of a run from its beginning to the end of this generation."""
    total = spec.job.algorithm.budget if isinstance(spec.job, TrainSpec) else 0
    return round(total * (generation + 1) / population.generations)


def _rounds(population: Population, trials: Sequence[Trial]) -> list[Sequence[Trial]]:
    """The trials by `size`; the last may be incomplete."""
    return [trials[first : first + population.size] for first in range(0, len(trials), population.size)]


def _is_to_repeat(trials: Sequence[Trial]) -> bool:
    """Whether a cancel ended these trials of one generation before any could be continued.

    A generation that failed by itself would fail again, and is none of these.
    """
    has_ended = all(one.outcome is not None for one in trials)
    return has_ended and not any(map(_is_able, trials)) and any(one.outcome == "cancelled" for one in trials)


def _is_able(trial: Trial) -> bool:
    """Whether it has a value and a job to resume from."""
    return trial.outcome == "succeeded" and trial.has_values and trial.job is not None


def _ranked(trials: Sequence[Trial], sign: int) -> list[Trial]:
    """Those that can be continued, the best first; of equal ones the first."""
    return sorted(filter(_is_able, trials), key=lambda one: (-sign * (one.values[0] or 0.0), one.number))


def _explored(spec: SweepSpec, population: Population, number: int, values: Values) -> Values:
    """Other values near these, which depend on the trial's number and the sweep's seed besides."""
    return {
        name: _changed(axis, values[name], population, random.Random(f"{spec.seed}/{number}/{name}"))  # noqa: S311
        for name, axis in spec.parameters.items()
    }


def _changed(axis: Axis, value: JsonValue, population: Population, generator: random.Random) -> JsonValue:
    if generator.random() < population.resample_probability:
        return value_at(axis, generator.random())
    if not isinstance(axis, Range):
        return generator.choice(neighbours(axis, value))
    factor = generator.choice(population.perturbation_factors)
    return scaled(axis, value, factor) if isinstance(value, int | float) else value
