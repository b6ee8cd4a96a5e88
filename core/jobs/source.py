"""Another job that a job needs: whether its project may use it, whether it has what is needed, and whether
that fits."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from typing import Any, cast

from core.environments import catalog
from core.errors import JobNotFound, JobUnreadable, Problem, Rejected
from core.jobs.job import Artifact, Job
from core.jobs.resolved import resolve_environment
from core.jobs.retention import removed_by_rule
from core.jobs.spec import EnvironmentSpec, JobSpec, RolloutSpec, Source
from core.jobs.status import JobStatus
from core.jobs.store import JobStore

# Numbers below these parts of the options change what an environment pays, how an episode begins and when it
# ends. A checkpoint's arrays have the same shapes under any of them.
_PAYING = ("reward", "weight", "cost")
_OF_EPISODES = ("reset", "termination")
# A rollout, or a training that resumes, takes a policy of another job, and may change these fields of that
# job's `reference`: with other clips, an observation still means the same.
_OF_CLIPS = ("clips", "sampling", "random_phase")
_MOST_SHOWN = 100

_Place = tuple[str | int, ...]


def check_readable(job_id: str, readable: Collection[str] | None, store: JobStore, pointer: str) -> None:
    """Refuse a job of another project, in the words for a job that does not exist. Raises Rejected.

    readable: the projects whose jobs may be used; None: all. pointer: where the id stands in the document.
    A job that does not exist passes: what looks for it refuses it.
    """
    if readable is None:
        return
    with suppress(JobNotFound):
        if store.owner_of(job_id).project not in readable:
            raise _refusal(JobNotFound(job_id).detail, pointer)


def find(job_id: str, get: Callable[[str], Job], pointer: str) -> Job:
    """The job of this id. pointer: where the id stands in the document. Raises Rejected."""
    try:
        return get(job_id)
    except (JobNotFound, JobUnreadable) as error:
        raise _refusal(error.detail, pointer) from None


def find_succeeded(job_id: str, what: str, store: JobStore, pointer: str) -> Job:
    """The job of this id, which has succeeded. Raises Rejected.

    what: what is wanted of it, for the sentence: "a decoder". pointer: where the id stands in the document.
    """
    job = find(job_id, store.get, pointer)
    if job.status != JobStatus.SUCCEEDED:
        detail = f"Job {job_id} is {job.status}; {what} is that of a job that has succeeded."
        raise _refusal(detail, pointer)
    return job


def source_artifact(spec: JobSpec, wanted: Source, get: Callable[[str], Job]) -> Artifact:
    """The checkpoint, or the best policy, of another job that this one needs.

    Raises Rejected if it is missing or does not fit.
    """
    job_id, pointer = wanted.job, wanted.pointer
    source = find(job_id, get, f"{pointer}/job")
    free = _free_options(spec)
    if found := difference(source.spec.environment, spec.environment, free):
        place, values = found
        excepted = f" except in {', '.join(free)}" if free else ""
        detail = (
            f"The environments of job {job_id} and of this one differ at {place}: {values}. They must be the "
            f"same{excepted}. Numbers of the reward, the reset and the termination may differ, and so "
            "may the clips of a reference."
        )
        if isinstance(spec, RolloutSpec):
            detail += " Leave `environment` out to take that of the job."
        raise Rejected(detail, [Problem(place, detail), Problem(f"{pointer}/job", detail)])
    if detail := no_such_seed(source, wanted.seed):
        raise _refusal(detail, f"{pointer}/seed")
    return _best_policy(source, wanted) if wanted.is_best else _checkpoint(source, wanted.step, pointer)


def no_such_seed(job: Job, seed: int | None) -> str | None:
    """A sentence where the job has no such seed."""
    has = job.seeds or (job.spec.seed,)
    if seed is None or seed in has:
        return None
    return f"Job {job.id} has no seed {seed}; it has {', '.join(map(str, has))}."


def _best_policy(source: Job, wanted: Source) -> Artifact:
    pointer, best = wanted.pointer, source.newest("best_policy", seed=wanted.seed)
    if best is None:
        of_seed = f" of seed {wanted.seed}" if source.seeds and wanted.seed is not None else ""
        detail = (
            f"Job {source.id} ({source.status}) has no best policy{of_seed}: either it has not been "
            "evaluated yet, or a version that kept none has trained it."
        )
        raise _refusal(detail, f"{pointer}/which")
    return best


def _checkpoint(source: Job, step: int | None, pointer: str) -> Artifact:
    checkpoint = source.newest("checkpoint", step)
    if checkpoint is None:
        steps = [str(a.step) for a in source.artifacts if a.role == "checkpoint"]
        wanted = "no checkpoint" if step is None else f"no checkpoint of step {step}"
        known = f"; it has {', '.join(steps)}" if steps else ""
        detail = (
            f"Job {source.id} ({source.status}) has {wanted}{known}.{removed_by_rule(source, 'checkpoint')}"
        )
        raise _refusal(detail, pointer if step is None else f"{pointer}/step")
    return checkpoint


def _free_options(spec: JobSpec) -> tuple[str, ...]:
    """The environment's options that need not be those of the job whose checkpoint it takes."""
    info = catalog.ENVIRONMENTS.get(spec.environment.id) if isinstance(spec, RolloutSpec) else None
    return info.free_in_rollouts if info else ()


def difference(had: EnvironmentSpec, has: EnvironmentSpec, free: Sequence[str]) -> tuple[str, str] | None:
    """The first difference that matters: its JSON pointer and the sentence's end; None if there is none.

    had: of the checkpoint's job. free: options that may differ.
    """
    if had.id != has.id:
        return "/environment/id", f"{had.id!r} there and {has.id!r} here"
    there, here = (
        {name: value for name, value in _options(one).items() if name not in free} for one in (had, has)
    )
    for place, one, other in _differing(there, here, ()):
        if place[0] == "reference" and place[1:2] and place[1] in _OF_CLIPS:
            continue
        if not (_is_number(one) and _is_number(other) and _is_harmless(place)):
            pointer = "".join(f"/{str(part)[:_MOST_SHOWN]}" for part in place)
            return f"/environment/options{pointer}", f"{_shown(one)} there and {_shown(other)} here"
    return None


def has_other_clips(had: EnvironmentSpec, has: EnvironmentSpec) -> bool:
    """Whether two environments without a `difference` follow other clips, or begin elsewhere in them.

    had: of the checkpoint's job.
    """
    there, here = (cast("dict[str, Any]", _options(one).get("reference") or {}) for one in (had, has))
    return any(there.get(name) != here.get(name) for name in _OF_CLIPS)


def _options(environment: EnvironmentSpec) -> dict[str, Any]:
    """The options with their defaults."""
    # An option that this version refuses may be of a job of another version.
    with suppress(Rejected):
        return resolve_environment(environment)[1].model_dump(mode="json")
    return environment.options


def _differing(one: Any, other: Any, place: _Place) -> Iterator[tuple[_Place, Any, Any]]:
    if isinstance(one, dict) and isinstance(other, dict):
        one, other = cast("dict[str, Any]", one), cast("dict[str, Any]", other)
        # The kind comes first: where it differs, options that only one kind has explain less.
        for name in sorted({**one, **other}, key=lambda name: name != "kind"):
            yield from _differing(one.get(name), other.get(name), (*place, name))
    elif isinstance(one, list) and isinstance(other, list):
        these, those = cast("list[Any]", one), cast("list[Any]", other)
        if len(these) != len(those):
            yield place, these, those
            return
        for number, pair in enumerate(zip(these, those, strict=True)):
            yield from _differing(*pair, (*place, number))
    elif one != other:
        yield place, one, other


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_harmless(place: _Place) -> bool:
    pays = any(word in part for part in place if isinstance(part, str) for word in _PAYING)
    return pays or place[0] in _OF_EPISODES


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}…"


def _refusal(detail: str, pointer: str) -> Rejected:
    return Rejected(detail, [Problem(pointer, detail)])
