"""The decoder of another job's policy as the action of a task: which job, whether it fits, what it sees.

What a submission finds is stored in the action, so that all who read the job later know the task.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, cast

from core.algorithms.catalog import reported
from core.algorithms.distillation.spec import DistillationSpec
from core.algorithms.ppo.network_spec import IntentionNetwork
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.spec import BaseSpec
from core.documents import Strict
from core.environments.info import POLICY_GROUP, EnvironmentInfo
from core.environments.mjcf.edit_check import edited
from core.environments.mjcf.info import MjcfOptions
from core.environments.terms.actions import ActionTerm, DecoderAction
from core.environments.terms.inventory import Inventory, inventory_of
from core.environments.terms.observations import ObservationTerm
from core.environments.terms.page import task_of
from core.environments.terms.task import TaskOptions, observed, parts_of, placed_terms
from core.errors import Problem, Rejected
from core.jobs.job import Artifact, Job
from core.jobs.resolved import ResolvedJob, own_model, resolve_environment
from core.jobs.source import check_readable, find_succeeded
from core.jobs.spec import EnvironmentSpec, JobSpec, TrainSpec, decoder_job
from core.jobs.store import JobStore

_ACTION = "/environment/options/action"
_FILLED_IN = ("latent", "sees", "moves")
# What makes a body, besides its id and the seconds of a control step.
_OF_THE_BODY = ("model", "edits", "root", "feet")
_OF_THE_POSE = ("keyframe", "qpos")


def decoder_file(environment: EnvironmentSpec, source: Job) -> Artifact | None:
    """The exported policy of the job whose decoder acts: that of its end, or of its best evaluation."""
    action = cast("dict[str, Any]", environment.options["action"])
    name = "policy-best.npz" if action.get("which") == "best" else "policy.npz"
    return next((artifact for artifact in source.artifacts if artifact.name == name), None)


def with_decoder(spec: JobSpec, store: JobStore, readable: Collection[str] | None = None) -> JobSpec:
    """The specification, whose action says what the decoder is that it names.

    readable: the projects whose jobs it may use; None: all. Raises Rejected where the job does not exist,
    has no decoder, or is of another body, and where the task lacks what the decoder sees.
    """
    if decoder_job(spec.environment) is None:
        return spec
    info, options = resolve_environment(spec.environment)
    action = getattr(options, "action", None)
    if not isinstance(action, DecoderAction):
        return spec  # The check of the options has refused it, or will.
    check_readable_decoder(spec.environment, readable, store)
    source = find_succeeded(action.job, "a decoder", store, f"{_ACTION}/job")
    network, had = _network_of(source), _task_of(source)
    if decoder_file(spec.environment, source) is None:
        raise _refusal(f"Job {source.id} has no exported policy of this kind any more.", "which")
    check_same_body(info, options, source, had)
    if "reference" in had.action.needed and getattr(options, "reference", None) is None:
        raise _refusal(
            f'Job {source.id} was trained with `about`: "reference", so its action is about where a clip has '
            'the joints, and this task has no `reference`. With "pose" a training makes a decoder for other '
            "tasks.",
            "job",
        )
    model = model_of_task(source.spec.environment, had, store)
    sees = [term.model_dump(mode="json") for term in _seen_by_decoder(had, network, model)]
    if isinstance(options, TaskOptions):  # Others have what the decoder sees: see `terms.lent`.
        _check_sees(sees, options, action.job)
    found = {"latent": network.latent, "sees": sees, "moves": had.action.model_dump(mode="json")}
    said = action.model_dump(mode="json")
    for name in _FILLED_IN:
        if said[name] not in (None, found[name]):
            raise _refusal(f"`{name}` is not what job {action.job} has: leave it out.", name)
    sent = cast("dict[str, Any]", spec.environment.options["action"])
    changed = {**spec.environment.options, "action": {**sent, **found}}
    environment = spec.environment.model_copy(update={"options": changed})
    return spec.model_copy(update={"environment": environment})


def why_it_lends_to_few(job: ResolvedJob, settings: BaseSpec) -> str | None:
    """What a training should tell at once, as its decoder will be of no use to tasks without clips."""
    has_decoder = isinstance(settings, PPOSpec | DistillationSpec) and settings.network is not None
    if not has_decoder or "reference" not in getattr(getattr(job.options, "action", None), "needed", ()):
        return None
    return (
        "The decoder that this trains can move tasks with a `reference` alone, because its action is about "
        'where the clip has the joints; with `about`: "pose" it could move others, too.'
    )


def check_readable_decoder(
    environment: EnvironmentSpec, readable: Collection[str] | None, store: JobStore
) -> None:
    """Refuse the decoder of a job in another project, in the words for a job that does not exist."""
    if (job_id := decoder_job(environment)) is not None:
        check_readable(job_id, readable, store, f"{_ACTION}/job")


def _network_of(source: Job) -> IntentionNetwork:
    """The intention network of a job, as it was trained. Raises Rejected where it has none."""
    used = [a.details["hyperparameters"] for a in source.attempts if "hyperparameters" in a.details]
    settings = None
    if isinstance(source.spec, TrainSpec):
        settings = reported({"kind": source.spec.algorithm.algorithm(), **used[-1]}) if used else None
    if isinstance(settings, DistillationSpec):
        settings = settings.as_ppo
    if not isinstance(settings, PPOSpec) or settings.network is None or settings.network.places is None:
        raise _refusal(
            f"Job {source.id} has no decoder: it is no training with an intention `network`.", "job"
        )
    if source.seeds:
        raise _refusal(
            f"Job {source.id} has trained several seeds, and a decoder is that of a job with one.", "job"
        )
    if settings.action_repeat != 1:
        raise _refusal(
            f"Job {source.id} holds an action for {settings.action_repeat} steps; a decoder acts in each.",
            "job",
        )
    if settings.policy_obs_key != POLICY_GROUP:
        raise _refusal(
            f"The policy of job {source.id} saw {settings.policy_obs_key!r}, and a decoder sees "
            f"{POLICY_GROUP!r}, the observation that a policy has in every task.",
            "job",
        )
    return settings.network


def _task_of(source: Job) -> TaskOptions:
    """What the job's body did. Raises Rejected where no terms say so, or another decoder acted."""
    task = task_of(*resolve_environment(source.spec.environment))
    if task is None or isinstance(task.action, ActionTerm | DecoderAction):
        raise _refusal(
            f"The action of job {source.id} is not one that a decoder can give: take a job whose task is "
            "made of terms, and whose action is `control` or of joints.",
            "job",
        )
    return task


def check_same_body(info: EnvironmentInfo, options: Strict, source: Job, had: TaskOptions) -> None:
    """Refuse another body, another pose or another control step than that with which the job trained."""
    there = source.spec.environment
    if there.id != (info.decoders_of or info.id):
        raise _refusal(f"Job {source.id} trained {there.id!r}, and this task has {info.id!r}.", "job")
    task = task_of(info, options)
    here, before = (one.model_dump(mode="json") for one in (task or options, had))
    names = [name for name in ("n_frames", "timestep") if here[name] != before[name]]
    if task is not None:
        names += [name for name in _OF_THE_BODY if here.get(name) != before.get(name)]
        names += [f"reset.{name}" for name in _OF_THE_POSE if here["reset"][name] != before["reset"][name]]
    if names:
        raise _refusal(
            f"Job {source.id} was trained with another {', '.join(names)}: take the same.",
            "job",
        )


def model_of_task(environment: EnvironmentSpec, options: TaskOptions, store: JobStore) -> Inventory:
    """What the body has, as the task's options change it. Raises Rejected."""
    if isinstance(options, MjcfOptions):
        return edited(own_model(options, store).inventory, options.edits)
    return inventory_of(environment.id)


def _seen_by_decoder(
    had: TaskOptions, network: IntentionNetwork, model: Inventory
) -> Sequence[ObservationTerm]:
    """The terms of the observation that the encoder did not see. Raises Rejected where it saw part of one."""
    encoded = {place for start, size in network.places or () for place in range(start, start + size)}
    seen: list[ObservationTerm] = []
    for term, places in placed_terms(observed(had), parts_of(had, model)):
        number = len(encoded.intersection(places))
        if number == 0:
            seen.append(term)
        elif number < len(places):
            raise _refusal(
                f"The encoder of that job saw only a part of its term `{term.label}`: a decoder needs whole "
                "terms.",
                "job",
            )
    return seen


def _check_sees(sees: Sequence[Mapping[str, Any]], options: TaskOptions, job_id: str) -> None:
    has = [term.model_dump(mode="json") for term in observed(options)]
    if missing := [term for term in sees if term not in has]:
        named = ", ".join(str(without_nulls(term)) for term in missing)
        detail = (
            f"The decoder of job {job_id} sees what the observation of this task lacks; add it as it is "
            f"there: {named}."
        )
        raise Rejected(detail, [Problem("/environment/options/observation", detail)])


def without_nulls(term: Mapping[str, Any]) -> dict[str, Any]:
    """A term without what is empty."""
    return {name: value for name, value in term.items() if value is not None}


def _refusal(detail: str, field: str) -> Rejected:
    return Rejected(detail, [Problem(f"{_ACTION}/{field}", detail)])
