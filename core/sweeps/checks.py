"""Checks before a sweep is stored: each refusal names the place in the sweep's document and the remedy."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice

from pydantic import JsonValue, ValidationError

from core.bounds import json_bytes
from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected
from core.jobs import checks as job_checks
from core.jobs.decoders import with_decoder
from core.jobs.experts import with_experts
from core.jobs.resolved import resolve_job
from core.jobs.spec import JOB_SPEC, RolloutSpec, TrainSpec
from core.jobs.store import JobStore
from core.jobs.submission import completed as completed_job
from core.jobs.submission import with_environment
from core.nearest import nearest
from core.sweeps.advance import committed_steps, num_trials, why_no_more
from core.sweeps.axes import (
    Values,
    axis_place,
    combinations,
    corners,
    fields_of,
    grid_values,
    has_one_value,
    job_of,
    num_combinations,
    random_values,
    takes_fractions,
    with_values,
    with_whole_parts,
)
from core.sweeps.pbt import problems_of_population, steps_until
from core.sweeps.results import SEED, refusal_of_metric
from core.sweeps.spec import MAX_TRIALS, MOST_SWEEP_LABELS, Axis, Range, SweepSpec
from core.sweeps.sweep import Trial

_MAX_LABELS = 62
# Axes along which some jobs may train several seeds and others not.
_DECIDE_ON_SEEDS = ("resources", "seeds", "resume_from")
_ALGORITHMS = ("algorithm", "algorithm.kind")
# Each takes a millisecond or two.
_MAX_TRIED = 64
_MAX_HINTS = 5
# JSON of the settings of all trials.
_LARGEST_TRIALS_BYTES = 2**21


def checked(spec: SweepSpec, store: JobStore) -> SweepSpec:
    """The sweep as it is stored: bounds of fields that take fractions are fractions, and a grid's seeds are
    trained side by side where `_with_seeds_together` says so. Raises Rejected."""
    try:
        spec = spec.model_copy(update={"job": with_environment(spec.job, store)})
        resolved = resolve_job(spec.job, store)
    except Rejected as error:
        raise in_the_job(error) from None
    check_labels(spec)
    _check_axes(spec, resolved.info)
    update = {
        "job": with_whole_parts(spec.job, resolved.info, spec.parameters),
        "parameters": _with_fractions(spec, resolved.info),
    }
    spec = spec.model_copy(update=update)
    _check_number(spec)
    _raise([*problems_of_population(spec, resolved), *problems_of_sampler(spec)])
    _check_method(spec)
    _check_objectives(spec)
    _check_values(spec, store)
    spec = _with_seeds_together(spec, store)
    check_budget(spec, (), store)
    return spec


def in_the_job(refusal: Rejected) -> Rejected:
    """A job's refusal, with its pointers in the sweep's document."""
    return Rejected(refusal.detail, [Problem(f"/job{one.pointer}", one.detail) for one in refusal.problems])


def _with_seeds_together(spec: SweepSpec, store: JobStore) -> SweepSpec:
    """A grid over `seed` of trainings on one GPU, as one over its other axes whose jobs train these `seeds`.

    The sweep as it is where such jobs are not allowed, and where a CPU may train them: it takes as long for
    seeds side by side as one after the other.
    """
    job = spec.job
    if spec.method != "grid" or SEED not in spec.parameters or not isinstance(job, TrainSpec):
        return spec
    if job.resources.kind != "gpu" or job.resume_from is not None or job.algorithm.why_no_seeds is not None:
        return spec
    if any(name.partition(".")[0] in _DECIDE_ON_SEEDS or name in _ALGORITHMS for name in spec.parameters):
        return spec
    others = {name: axis for name, axis in spec.parameters.items() if name != SEED}
    document = with_values(job, {"seeds": grid_values(spec.parameters[SEED])})
    document.pop(SEED, None)
    try:
        together = spec.model_copy(update={"job": JOB_SPEC.validate_python(document), "parameters": others})
        _check_values(together, store)
    except (ValidationError, Rejected):  # Too many, or not enough memory for all of them.
        return spec
    return together


def steps_of(spec: SweepSpec, values: Mapping[str, JsonValue], store: JobStore) -> int:
    """The most environment steps that a trial with these values takes; 0 if these values do not fit."""
    try:
        job = completed_job(job_of(spec.job, values))
        if isinstance(job, RolloutSpec):
            return job.num_steps * job.num_episodes
        budgets = (settings.budget for settings in resolve_job(job, store).settings.values())
        return max(budgets) * len(job.seeds or [job.seed])
    except (ValidationError, Rejected):
        return 0


def check_budget(spec: SweepSpec, trials: Sequence[Trial], store: JobStore) -> None:
    """Raises Rejected where the budget allows no further trial, or trials that are too long together."""
    budget = spec.budget
    _check_length(spec, trials)
    if (why := why_no_more(spec, trials)) is not None:
        of_the_budget = why.startswith("Its budget")
        remedy = "raise the budget" if of_the_budget else "no budget changes that: start another sweep"
        detail = f"{why}, so no further trial would start; {remedy}."
        raise Rejected(detail, [Problem("/budget", detail)])
    if budget.steps is None:
        return
    values = (
        next(combinations(spec.parameters)) if spec.method == "grid" else random_values(spec, len(trials))
    )
    taken, needed = committed_steps(trials), steps_of(spec, values, store)
    if spec.population is not None:
        needed = steps_until(spec, spec.population, 0)
    if taken + needed > budget.steps:
        detail = (
            f"The budget of {budget.steps:,} steps allows no {'further ' if trials else ''}trial: one takes "
            f"{needed:,} steps{f', and {taken:,} are used' if taken else ''}."
        )
        raise Rejected(detail, [Problem("/budget/steps", detail)])


def _check_length(spec: SweepSpec, trials: Sequence[Trial]) -> None:
    """Every look at a sweep reads the settings of all its trials."""
    longest = json_bytes(
        {
            name: axis.high if isinstance(axis, Range) else max(axis, key=json_bytes)
            for name, axis in spec.parameters.items()
        }
    )
    number = num_trials(spec, trials)
    if number * longest > _LARGEST_TRIALS_BYTES:
        _refuse(
            f"A trial's settings have up to {longest:,} bytes as JSON. With {number:,} trials at most "
            f"{_LARGEST_TRIALS_BYTES // number:,} are allowed: vary shorter values, or set fewer trials as "
            "`jobs` in the budget.",
            "/parameters",
        )


def check_labels(spec: SweepSpec) -> None:
    """A job has 64 labels at most, and a trial gets `sweep` and `trial` besides.

    With more of its own than its specification takes, a changed sweep could never be read again.
    """
    if (number := len(spec.labels)) > MOST_SWEEP_LABELS:
        detail = f"The sweep would have {number} labels; at most {MOST_SWEEP_LABELS} are allowed."
        _refuse(detail, "/labels")
    if len({*spec.job.labels, *spec.labels}) > _MAX_LABELS:
        _refuse(f"The job and the sweep have more than {_MAX_LABELS} labels together.", "/labels")


def _check_axes(spec: SweepSpec, info: EnvironmentInfo) -> None:
    if not spec.parameters:
        _refuse('A sweep needs an axis, for example `"seed": [1, 2, 3]`.', "/parameters")
    known = fields_of(spec.job, info)
    wrong = [name for name in spec.parameters if name not in known]
    hints = (_hint(name, known) if number < _MAX_HINTS else "." for number, name in enumerate(wrong))
    problems = [
        Problem(axis_place(name), f"`{name}` is not a field of this job{hint}")
        for name, hint in zip(wrong, hints, strict=True)
    ]
    problems += [
        Problem(axis_place(name), f"`{name}` is a part of the axis `{above}`; leave one out.")
        for name in spec.parameters
        for above in spec.parameters
        if name.startswith(f"{above}.")
    ]
    if "project" in spec.parameters:
        problems.append(Problem(axis_place("project"), "All trials of a sweep are in its one project."))
    problems += chain.from_iterable(_wrong(name, axis, spec) for name, axis in spec.parameters.items())
    _raise(problems)


def _wrong(name: str, axis: Axis, spec: SweepSpec) -> Iterator[Problem]:
    if not isinstance(axis, Range):
        if (twice := _repeated(axis)) is not None:
            yield Problem(axis_place(name), f"`{name}` has the value {twice:.200} twice.")
    elif spec.method != "grid" and axis.points is not None:
        detail = f"`points` is for grids; {spec.method} draws from the range."
        yield Problem(f"{axis_place(name)}/points", detail)


def _repeated(values: Sequence[JsonValue]) -> str | None:
    """The first value that is there twice, in JSON, where 1, 1.0 and true differ as they do for a sweep."""
    seen = set[str]()
    for value in values:
        text = json.dumps(value, sort_keys=True, ensure_ascii=False)
        if text in seen:
            return text
        seen.add(text)
    return None


def _with_fractions(spec: SweepSpec, info: EnvironmentInfo) -> dict[str, Axis]:
    """The axes; whole bounds of a field that takes fractions mean fractions: 0 to 1 is not 0 or 1."""
    known = fields_of(spec.job, info)
    return {
        name: axis.model_copy(update={"low": float(axis.low), "high": float(axis.high)})
        if isinstance(axis, Range) and axis.step is None and takes_fractions(known[name])
        else axis
        for name, axis in spec.parameters.items()
    }


def _check_number(spec: SweepSpec) -> None:
    if spec.method == "grid" and (number := num_combinations(spec.parameters)) > MAX_TRIALS:
        _refuse(
            f"The grid has {number:,} combinations, but a sweep has {MAX_TRIALS:,} trials at most: take "
            "fewer values, or the method `random` or `tpe` with a budget.",
            "/parameters",
        )


def _check_method(spec: SweepSpec) -> None:
    if not spec.has_own_end and not spec.budget.has_limit:
        _refuse(
            f"The method `{spec.method}` has no end of its own: give `jobs`, `steps` or `gpu_hours`.",
            "/budget",
        )
    if spec.pruning is not None and isinstance(spec.job, RolloutSpec):
        _refuse("A rollout reports its metrics once, at its end, so nothing can be pruned.", "/pruning")
    if spec.pruning is not None and len(spec.objectives) > 1:
        _refuse("Pruning compares trials by one objective, and this sweep has several.", "/pruning")


def _check_objectives(spec: SweepSpec) -> None:
    problems = list[Problem]()
    for at, objective in enumerate(spec.objectives):
        here = f"/objective/{at}/metric" if isinstance(spec.objective, list) else "/objective/metric"
        if (detail := refusal_of_metric(spec.job, objective.metric)) is not None:
            problems.append(Problem(here, detail))
        elif any(objective.metric == other.metric for other in spec.objectives[:at]):
            problems.append(Problem(here, f"`{objective.metric}` is an objective already."))
    _raise(problems)


def _check_values(spec: SweepSpec, store: JobStore) -> None:
    """Try the ends of the axes, and some values between them, in the job's own checks."""
    for values in islice(_to_try(spec), _MAX_TRIED):
        try:
            job = with_decoder(completed_job(job_of(spec.job, values)), store)
            job_checks.check(with_experts(job, store), store)
        except ValidationError as error:
            found = [_named(one["loc"], str(one["msg"])) for one in error.errors()]
            _raise([_translated(place, detail, spec, values) for place, detail in found])
        except Rejected as error:
            problems = error.problems or (Problem("", error.detail),)
            _raise([_translated(one.pointer, one.detail, spec, values) for one in problems])


def _to_try(spec: SweepSpec) -> Iterable[Values]:
    if spec.method == "grid" and num_combinations(spec.parameters) <= _MAX_TRIED:
        return combinations(spec.parameters)
    return chain(corners(spec.parameters), (random_values(spec, number) for number in range(16)))


def _named(location: tuple[int | str, ...], message: str) -> tuple[str, str]:
    """A pointer, which may hold pydantic's words between the fields, and a sentence."""
    words = message.removeprefix("Value error, ").replace("Input should be", "must be")
    return "/" + "/".join(map(str, location)), f"{words[0].lower()}{words[1:]}"


def _translated(place: str, detail: str, spec: SweepSpec, values: Values) -> Problem:
    """The job's problem as one of the sweep: at the axis that set the value, or else in `job`."""
    parts = place.strip("/").split("/")
    for name, value in values.items():
        if _is_part(name.split("."), parts):
            text = detail if detail.endswith((".", "?")) else f"`{name}` = {value!r}: {detail}."
            return Problem(axis_place(name), text)
    told = ", ".join(f"{name} = {value!r}" for name, value in values.items())
    return Problem(f"/job{place}", f"With {told}: {detail.rstrip('.')}.")


def _is_part(wanted: Sequence[str], parts: Sequence[str]) -> bool:
    """Whether the parts name this field, perhaps with other words between them."""
    left = iter(parts)
    return all(any(part == one for one in left) for part in wanted)


def _hint(name: str, known: Iterable[str]) -> str:
    near = nearest(name, known)
    last = name.rpartition(".")[2]
    near = [one for one in known if one.rpartition(".")[2] == last] or near
    return f"; did you mean {' or '.join(f'`{one}`' for one in near)}?" if near else "."


def _refuse(detail: str, pointer: str) -> None:
    raise Rejected(detail, [Problem(pointer, detail)])


def _raise(problems: Sequence[Problem]) -> None:
    if problems:
        raise Rejected(" ".join(dict.fromkeys(problem.detail for problem in problems[:5])), problems)


def problems_of_sampler(spec: SweepSpec) -> Iterator[Problem]:
    """Problems of a sweep by `cma_es`; the other samplers take every axis and any number of objectives."""
    if spec.method != "cma_es":
        return
    if len(spec.objectives) > 1:
        yield Problem("/objective", "`cma_es` follows one objective; give one, or take `tpe` or `nsga2`.")
    lists = [name for name, axis in spec.parameters.items() if not isinstance(axis, Range)]
    for name in lists:
        detail = f"`cma_es` takes ranges alone, and `{name}` is a list; give a range, or take `tpe`."
        yield Problem(axis_place(name), detail)
    varied = [
        axis for axis in spec.parameters.values() if isinstance(axis, Range) and not has_one_value(axis)
    ]
    if not lists and len(varied) < 2:
        detail = "`cma_es` learns how axes depend on each other; give two ranges, or take `tpe`."
        yield Problem("/parameters", detail)
