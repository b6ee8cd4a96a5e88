"""Population-based training: which trial each one resumes from, and with which settings.

Trial `generation × size + member` trains a member for one generation. Source: Jaderberg et al., Population
Based Training of Neural Networks (2017), algorithm 1 and section 4.1. A generation of which a cancel left no
run to continue begins again under the numbers that follow, so that a cancelled sweep can be resumed.

Generations are synchronous, unlike the paper's: one begins when all trials of the one before have ended. What
a trial begins with is then a function of records that no longer change, so every process decides alike, and
no rule is needed for a member that is far behind the others.

The checks at the end are the requirements of the method on a sweep's job and axes.
"""

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pydantic import JsonValue, ValidationError

from core.algorithms.catalog import ALGORITHMS
from core.algorithms.spec import BaseSpec, changed_beside_checkpoint
from core.environments.info import Device
from core.errors import Problem, Rejected
from core.jobs.resolved import DEVICES, ResolvedJob
from core.jobs.spec import TrainSpec
from core.sweeps.axes import Values, axis_place, ends, job_of, neighbours, random_values, scaled, value_at
from core.sweeps.spec import Axis, Population, Range, SweepSpec
from core.sweeps.sweep import Trial

LENGTH = "algorithm.num_timesteps"
_LARGEST_SEED = 2**31 - 1
_OF_THE_ALGORITHM = "algorithm."
# Most values tried of one axis; resolving settings takes a fraction of a millisecond.
_MAX_TRIED = 16


@dataclass(frozen=True)
class TrialBeginning:
    """A trial's starting point.

    settings: of its job, besides `parameters`. parent, inherited_steps: as in `Trial`.
    """

    parameters: Values
    settings: Values
    parent: int | None = None
    inherited_steps: int = 0


class DiedOut(Exception):
    """No run of a generation can be continued: the beginning of a sentence."""


def beginning(spec: SweepSpec, population: Population, trials: Sequence[Trial]) -> TrialBeginning:
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
        return TrialBeginning(random_values(spec, number), settings)
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
    return TrialBeginning(parameters, settings, parent.number, parent.inherited_steps + parent.steps)


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


def problems_of_population(spec: SweepSpec, resolved: ResolvedJob) -> list[Problem]:
    """The problems of a sweep by `pbt`, and of a `population` beside another method. resolved: its job."""
    population = spec.population
    if spec.method != "pbt":
        detail = f"`population` is for the method `pbt`, and this sweep has `{spec.method}`; leave it out."
        return [] if population is None else [Problem("/population", detail)]
    if population is None:
        detail = 'The method `pbt` needs a population, for example `{"size": 8, "generations": 10}`.'
        return [Problem("/population", detail)]
    return (
        [*_of_sweep(spec)]
        or [*_of_axes(spec)]
        or [*_of_settings(spec, resolved)]
        or [*_of_length(spec, population, resolved)]
    )


def _of_sweep(spec: SweepSpec) -> Iterator[Problem]:
    if len(spec.objectives) > 1:
        yield Problem("/objective", "The method `pbt` compares trials by one objective; give one.")
    if spec.pruning is not None:
        yield Problem("/pruning", "The method `pbt` replaces the worst trials itself; leave `pruning` out.")
    job = spec.job
    if not isinstance(job, TrainSpec):
        yield Problem("/job/kind", "The method `pbt` trains, and a rollout does not; give a job that does.")
        return
    if job.resume_from is not None:
        detail = "With `pbt`, a trial resumes from its parent; leave `resume_from` out."
        yield Problem("/job/resume_from", detail)
    if job.seeds is not None:
        yield Problem("/job/seeds", "With `pbt`, each member has a seed of its own; leave `seeds` out.")
    if not job.algorithm.trains_in_parts:
        able = " or ".join(f"`{name}`" for name, row in ALGORITHMS.items() if row.spec.trains_in_parts)
        detail = (
            f"The method `pbt` trains in parts, and what `{job.algorithm.algorithm()}` does depends on the "
            f"length of its run; take {able}."
        )
        yield Problem("/job/algorithm/kind", detail)
    elif "num_timesteps" not in job.algorithm.model_fields_set:
        detail = "The method `pbt` divides the job's `num_timesteps` into generations; give it."
        yield Problem("/job/algorithm/num_timesteps", detail)


def _of_axes(spec: SweepSpec) -> Iterator[Problem]:
    for name in spec.parameters:
        if name == LENGTH:
            detail = "With `pbt`, every trial trains for one generation: leave this axis out."
        elif name == "seed":
            detail = (
                "With `pbt`, each member begins with the job's seed plus its number, and a run that resumes "
                "has its parent's random state: leave `seed` out."
            )
        elif not name.startswith(_OF_THE_ALGORITHM):
            detail = (
                f"`{name}` cannot change in a run that resumes, or changes nothing in its training: `pbt` "
                "varies settings of the algorithm alone."
            )
        else:
            continue
        yield Problem(axis_place(name), detail)


def _of_settings(spec: SweepSpec, resolved: ResolvedJob) -> Iterator[Problem]:
    """Axes along which a run that resumes cannot move, or moves without effect."""
    first = {name: ends(axis)[0] for name, axis in spec.parameters.items()}
    for name, axis in spec.parameters.items():
        found = [{**first, name: value} for value in ends(axis)[:_MAX_TRIED]]
        for device in DEVICES[spec.job.resources.kind]:
            settings = [one for values in found if (one := _settings(resolved, values, device)) is not None]
            if detail := _why_fixed(name, settings):
                yield Problem(axis_place(name), detail)
                break


def _why_fixed(name: str, settings: list[BaseSpec]) -> str | None:
    field = name.removeprefix(_OF_THE_ALGORITHM)
    for one in settings:
        if field in one.read_at_start:
            return f"`{name}` is read only at a run's beginning, so `pbt` would change nothing with it."
        if fixed := changed_beside_checkpoint(one, settings[0]):
            because = "" if fixed[0] == field else f", because `{fixed[0]}` follows from it"
            return f"`{name}` cannot change in a run that resumes from a checkpoint{because}."
    return None


def _of_length(spec: SweepSpec, population: Population, resolved: ResolvedJob) -> Iterator[Problem]:
    """A generation without an update would end without a value."""
    first = {name: ends(axis)[0] for name, axis in spec.parameters.items()}
    steps = steps_until(spec, population, 0)
    for device in DEVICES[spec.job.resources.kind]:
        settings = _settings(resolved, first, device)
        update: int = getattr(settings, "env_steps_per_update", 0)
        if steps < update:
            detail = (
                f"A generation has {steps:,} steps, and an update on a {device.upper()} takes {update:,}: "
                "raise num_timesteps, take fewer generations, or ask for another "
                "`job.resources.accelerator`."
            )
            yield Problem("/population/generations", detail)
            return


def _settings(resolved: ResolvedJob, values: Values, device: Device) -> BaseSpec | None:
    """The algorithm's settings under these values; None where they do not fit, which other checks say."""
    try:
        job = job_of(resolved.spec, values)
        return replace(resolved, spec=job).settings_on(device) if isinstance(job, TrainSpec) else None
    except (ValidationError, Rejected):
        return None
