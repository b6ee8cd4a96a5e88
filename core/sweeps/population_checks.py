"""The requirements of population-based training on a sweep's job and axes, besides those of every sweep."""

from collections.abc import Iterator

from pydantic import ValidationError

from core.algorithms.catalog import ALGORITHMS, resolve
from core.algorithms.spec import BaseSpec, check_resumption
from core.environments.info import Device, EnvironmentInfo
from core.errors import Problem, Rejected
from core.jobs.needs import DEVICES
from core.jobs.spec import TrainSpec
from core.sweeps.axes import Values, ends
from core.sweeps.fields import axis_place, job_of
from core.sweeps.pbt import LENGTH, steps_until
from core.sweeps.spec import Population, SweepSpec

_OF_THE_ALGORITHM = "algorithm."
# Most values tried of one axis; resolving settings takes a fraction of a millisecond.
_MAX_TRIED = 16


def problems_of_population(spec: SweepSpec, info: EnvironmentInfo) -> list[Problem]:
    """The problems of a sweep by `pbt`, and of a `population` beside another method."""
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
        or [*_of_settings(spec, info)]
        or [*_of_length(spec, population, info)]
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


def _of_settings(spec: SweepSpec, info: EnvironmentInfo) -> Iterator[Problem]:
    """Axes along which a run that resumes cannot move, or moves without effect."""
    first = {name: ends(axis)[0] for name, axis in spec.parameters.items()}
    for name, axis in spec.parameters.items():
        found = [{**first, name: value} for value in ends(axis)[:_MAX_TRIED]]
        for device in DEVICES[spec.job.resources.kind]:
            settings = [one for values in found if (one := _resolved(spec, values, info, device)) is not None]
            if detail := _why_fixed(name, settings):
                yield Problem(axis_place(name), detail)
                break


def _why_fixed(name: str, settings: list[BaseSpec]) -> str | None:
    field = name.removeprefix(_OF_THE_ALGORITHM)
    for one in settings:
        if field in one.read_at_start:
            return f"`{name}` is read only at a run's beginning, so `pbt` would change nothing with it."
        try:
            check_resumption(one, settings[0])
        except Rejected as error:
            fixed = error.problems[0].pointer.rpartition("/")[2]
            because = "" if fixed == field else f", because `{fixed}` follows from it"
            return f"`{name}` cannot change in a run that resumes from a checkpoint{because}."
    return None


def _of_length(spec: SweepSpec, population: Population, info: EnvironmentInfo) -> Iterator[Problem]:
    """A generation without an update would end without a value."""
    first = {name: ends(axis)[0] for name, axis in spec.parameters.items()}
    steps = steps_until(spec, population, 0)
    for device in DEVICES[spec.job.resources.kind]:
        settings = _resolved(spec, first, info, device)
        update: int = getattr(settings, "env_steps_per_update", 0)
        if steps < update:
            detail = (
                f"A generation has {steps:,} steps, and an update on a {device.upper()} takes {update:,}: "
                "raise num_timesteps, take fewer generations, or ask for another "
                "`job.resources.accelerator`."
            )
            yield Problem("/population/generations", detail)
            return


def _resolved(spec: SweepSpec, values: Values, info: EnvironmentInfo, device: Device) -> BaseSpec | None:
    """The algorithm's settings under these values; None where they do not fit, which other checks say."""
    try:
        job = job_of(spec.job, values)
        return resolve(job.algorithm, info, device) if isinstance(job, TrainSpec) else None
    except (ValidationError, Rejected):
        return None
