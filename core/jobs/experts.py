"""The policies of other jobs from which a distillation learns: whether each fits, what it sees, its clips.

A submission stores what it finds in the specification's experts, so that a worker reads their policies and
not their jobs.
"""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from core.algorithms.catalog import ALGORITHMS, reported
from core.algorithms.distillation.spec import EXPERTS, DistillationSpec, Expert
from core.clips.options import ClipChoice, called, distinct
from core.documents import Strict
from core.environments.info import CRITIC_GROUP, POLICY_GROUP, EnvironmentInfo
from core.environments.terms.inventory import Inventory
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.page import task_of
from core.environments.terms.task import TaskOptions, observed, parts_of, placed_terms
from core.errors import ClipsNotFound, Problem, Rejected
from core.jobs.decoders import check_same_body, model_of_task, without_nulls
from core.jobs.job import Artifact, Job
from core.jobs.resolved import resolve_environment
from core.jobs.source import check_readable, difference, find_succeeded
from core.jobs.spec import JobSpec, TrainSpec
from core.jobs.store import JobStore
from core.patterns import matching
from core.uploads import library

_FILLED_IN = ("clip_names", "sees", "places")
# The fields of a reference that change what the numbers of an observation of it mean.
_SHOWN_OF_A_REFERENCE = ("ahead", "bodies", "anchor", "end_effectors")
# The fields of a term that a critic's observation ignores: it sees exact values.
_NOISE = {"noise", "bias", "delay"}


class _Origin(NamedTuple):
    """A clip's name in its file; the file, and what is changed in the clip."""

    name: str
    choice: ClipChoice


def expert_file(expert: Expert, source: Job) -> Artifact | None:
    """The policy of an expert's job: that of its end, or of its best evaluation."""
    return source.newest("best_policy" if expert.which == "best" else "policy")


def with_experts(spec: JobSpec, store: JobStore, readable: Collection[str] | None = None) -> JobSpec:
    """The specification with what its experts see and the clips for which they answer.

    readable: the projects whose jobs it may use; None: all. Raises Rejected where an expert's job does not
    exist, has no policy to learn from, or trained another body, where the task lacks what the expert sees,
    and where a clip has no expert or several.
    """
    if not isinstance(spec, TrainSpec) or not isinstance(spec.algorithm, DistillationSpec):
        return spec
    check_readable_experts(spec, readable, store)
    info, options = resolve_environment(spec.environment, store)
    experts: list[Expert] = []
    for number, expert in enumerate(spec.algorithm.experts):
        try:
            experts.append(_filled_in(expert, spec, info, options, store))
        except Rejected as refused:
            places = [one.pointer for one in refused.problems if one.pointer.endswith("/observation")]
            places.append(f"{EXPERTS}/{number}/{refused.problems[0].pointer.rpartition('/')[2] or 'job'}")
            raise Rejected(refused.detail, [Problem(place, refused.detail) for place in places]) from None
    algorithm = spec.algorithm.model_copy(update={"experts": experts})
    if experts:
        algorithm.num_of_expert(list(_clips(options, store)))
    return spec.model_copy(update={"algorithm": algorithm})


def check_readable_experts(spec: JobSpec, readable: Collection[str] | None, store: JobStore) -> None:
    """Refuse an expert in another project, in the words for a job that does not exist."""
    algorithm = spec.algorithm if isinstance(spec, TrainSpec) else None
    experts = algorithm.experts if isinstance(algorithm, DistillationSpec) else ()
    for number, expert in enumerate(experts):
        check_readable(expert.job, readable, store, f"{EXPERTS}/{number}/job")


def _filled_in(
    expert: Expert, spec: TrainSpec, info: EnvironmentInfo, options: Strict, store: JobStore
) -> Expert:
    """The expert with all its fields. Raises Rejected, whose pointer ends in a field of the expert, or in
    `observation`."""
    source = _source(expert.job, store)
    if expert_file(expert, source) is None:
        raise _refusal(f"Job {source.id} has no policy of this kind.", "which")
    key, (row, had) = _seen_by(source), resolve_environment(source.spec.environment)
    here, before = task_of(info, options), task_of(row, had)
    found: dict[str, Any] = {"sees": key, "places": None, "clip_names": None}
    # Where the environments are the same but for their clips, an expert sees all that it saw.
    if differs := difference(source.spec.environment, spec.environment, info.free_in_rollouts):
        if here is None or before is None:
            detail = f"The environment of job {source.id} is another one at {differs[0]}: {differs[1]}."
            raise _refusal(detail, "job")
        check_same_body(info, options, source, before)
        _check_shown_alike(here, source.id, before)
        if here.action != before.action:
            raise _refusal(f"Job {source.id} was trained with another action: take the same.", "job")
        model = model_of_task(spec.environment, here, store)
        terms = (before.critic or ()) if key == CRITIC_GROUP else observed(before)
        found["sees"], found["places"] = _places(source.id, terms, before, here, model)
    if _choices(options) and expert.clips is None:
        found["clip_names"] = _own_clips(source.id, had, options, store)
    elif not _choices(options) and expert.clips is not None:
        raise _refusal("`clips` are those of a task with a `reference`: leave them out.", "clips")
    for name in _FILLED_IN:
        said = getattr(expert, name)
        said = [list(place) for place in said] if name == "places" and said else said
        if name in expert.model_fields_set and said not in (None, found[name]):
            raise _refusal(f"`{name}` is not what job {source.id} has: leave it out.", name)
    return Expert.model_validate({**expert.model_dump(exclude_unset=True), **found})


def _source(job_id: str, store: JobStore) -> Job:
    """The job of an expert, which has succeeded and trained one policy that a network gives."""
    source = find_succeeded(job_id, "an expert", store, f"{EXPERTS}/job")
    detail = None
    if not isinstance(source.spec, TrainSpec):
        detail = f"Job {job_id} is a {source.spec.kind}, and an expert is a trained policy."
    elif why := ALGORITHMS[source.spec.algorithm.algorithm()].no_export:
        detail = f"The policy of job {job_id} is no expert: {why}."
    elif source.seeds:
        detail = f"Job {job_id} has trained several seeds, and an expert is that of a job with one."
    if detail is not None:
        raise _refusal(detail, "job")
    return source


def _seen_by(source: Job) -> str:
    """The name of the observation that the job's policy sees.

    Raises Rejected where the policy holds an action for several steps.
    """
    used = [a.details["hyperparameters"] for a in source.attempts if "hyperparameters" in a.details]
    settings: Any = getattr(source.spec, "algorithm", None)
    if used:
        settings = reported({"kind": settings.algorithm(), **used[-1]})
    if (held := getattr(settings, "action_repeat", 1)) != 1:
        detail = f"Job {source.id} holds an action for {held} steps; an expert acts in each."
        raise _refusal(detail, "job")
    return getattr(settings, "policy_obs_key", POLICY_GROUP)


def _check_shown_alike(options: TaskOptions, job_id: str, had: TaskOptions) -> None:
    """Refuse a reference that the observation shows in another way than the one of the expert's job."""
    here, there = options.reference, had.reference
    if here is None or there is None:
        return
    names = [name for name in _SHOWN_OF_A_REFERENCE if getattr(here, name) != getattr(there, name)]
    if names:
        shown = ", ".join(f"reference.{name}" for name in names)
        raise _refusal(f"Job {job_id} was trained with another {shown}: take the same.", "job")


def _places(
    job_id: str, terms: Sequence[ObservationTerm], had: TaskOptions, options: TaskOptions, model: Inventory
) -> tuple[str, list[list[int]]]:
    """The observation of this task that has all of an expert's terms, and [start, size] of each in it.

    terms: the expert's. had: the task of the expert's job; options: this task. Raises Rejected.
    """
    there, here = parts_of(had, model), parts_of(options, model)
    missing: list[ObservationTerm] = []
    for group, has, ignored in (
        (POLICY_GROUP, observed(options), set[str]()),
        (CRITIC_GROUP, options.critic or (), _NOISE),
    ):
        found = [(term.model_dump(exclude=ignored), at) for term, at in placed_terms(has, here)]
        lacks: list[ObservationTerm] = []
        places: list[range] = []
        for term, at in placed_terms(terms, there):
            wanted = (term.model_dump(exclude=ignored), len(at))
            place = next((place for one, place in found if (one, len(place)) == wanted), None)
            if place is None:
                lacks.append(term)
            elif place:
                places.append(place)
        if not lacks:
            return group, [[place.start, len(place)] for place in places]
        missing = missing or lacks
    named = ", ".join(str(without_nulls(term.model_dump(mode="json"))) for term in missing)
    detail = (
        f"The expert of job {job_id} sees what the observation of this task lacks; add it as it is there to "
        f"`observation`, or for the expert alone to `critic`: {named}."
    )
    raise Rejected(detail, [Problem("/environment/options/observation", detail)])


def _own_clips(job_id: str, had: Strict, options: Strict, store: JobStore) -> list[str]:
    """The clips of this task on which an expert's job was trained, by their names here.

    had: the task of the expert's job; options: this task.
    """
    try:
        theirs = set(_clips(had, store).values())
    except ClipsNotFound:
        theirs = set[_Origin]()
    if not theirs:
        detail = f"Job {job_id} has no clips of its own, or they were deleted: say by `clips` which it knows."
        raise _refusal(detail, "clips")
    names = [name for name, origin in _clips(options, store).items() if origin in theirs]
    if not names:
        detail = (
            f"Job {job_id} was trained on no clip of this job: of the same file, and cut, mirrored and "
            "sped up as here. Say by `clips` which it knows."
        )
        raise _refusal(detail, "clips")
    return names


def _choices(options: Strict) -> Sequence[ClipChoice]:
    reference: object = getattr(options, "reference", None)
    return getattr(reference, "clips", ())


def _clips(options: Strict, store: JobStore) -> dict[str, _Origin]:
    """Where the clips of a task come from, by the names that they have in its job. Raises ClipsNotFound."""
    names: list[str] = []
    origins: list[_Origin] = []
    for choice in _choices(options):
        description = library.find(choice.file, store.clips).description
        of_file = [clip.name for clip in description.clips] if description else []
        wanted = of_file if choice.names is None else matching(choice.names, of_file)
        unnamed = choice.model_copy(update={"names": None, "weight": 1.0})
        names += [called(name, choice) for name in wanted]
        origins += [_Origin(name, unnamed) for name in wanted]
    return dict(zip(distinct(names), origins, strict=True))


def _refusal(detail: str, field: str) -> Rejected:
    return Rejected(detail, [Problem(f"{EXPERTS}/{field}", detail)])
