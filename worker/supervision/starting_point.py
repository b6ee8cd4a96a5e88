"""The files of a training process's start: its task, a verified checkpoint, and what users sent: the
model and clips."""

from pathlib import Path
from typing import get_args

from core.algorithms.catalog import reported
from core.algorithms.distillation.spec import DistillationSpec
from core.clips.record import ARCHIVE
from core.environments import catalog
from core.environments.mjcf.edit_check import edited
from core.environments.mjcf.info import INFO as MJCF
from core.environments.mjcf.info import MjcfOptions
from core.errors import (
    ClipsNotFound,
    JobFailed,
    JobNotFound,
    JobUnreadable,
    ModelNotFound,
    ObjectDamaged,
    ObjectNotFound,
)
from core.jobs.attempts import Claim
from core.jobs.decoders import decoder_file
from core.jobs.experts import expert_file
from core.jobs.job import Artifact, Attempt, Job
from core.jobs.resolved import engines_that_cannot, model_of
from core.jobs.source import has_other_clips, source_artifact
from core.jobs.spec import RolloutSpec, TrainSpec, decoder_job
from core.jobs.uploads import clip_files_of
from core.physics.availability import EngineName
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore, save_whole
from core.uploads import library
from worker.host.commit import commit_here
from worker.protocol import BestSoFar, Task

_FILE, _BEST = "start.msgpack", "policy-best-before"
_DECODER = "decoder.npz"


def write_task(job: Job, claim: Claim, device: str, spool: Path) -> list[str]:
    """Write what the training process needs to the spool; returns notes for users on what was wrong with it.

    Raises Rejected or NotFound if the checkpoint of another job has been deleted meanwhile, or if the job
    names what this worker does not have; JobFailed if the model or clips have been deleted ("bad_model",
    "bad_clips"), or if no checkpoint of another job is whole ("bad_checkpoint").
    """
    notes: list[str] = []
    task = Task(
        job_id=job.id,
        attempt=claim.number,
        spec=job.spec,
        device=device,
        gpu_part=claim.gpu_part,
        correlation_id=job.correlation_id,
        commit=commit_here(),
    )
    task = _as_begun(task, job.begun)
    checkpoint = _own_checkpoint(job, claim, spool, notes)
    if checkpoint is None:
        checkpoint = _source_checkpoint(job, claim, spool, notes)
        task = _with_source(task, claim)
    if checkpoint is not None:
        task = task.model_copy(update={"checkpoint": _FILE, "checkpoint_step": checkpoint.step or 0})
    best = (_best_so_far(job, seed, claim, spool, notes) for seed in job.seeds or (None,))
    task = task.model_copy(update={"best": tuple(filter(None, best))})
    task = _with_clips(_with_model(task, claim, spool), claim, spool)
    task = _with_experts(_with_decoder(task, claim, spool), claim, spool)
    (spool / "task.json").write_text(task.model_dump_json())
    return notes


def _own_checkpoint(job: Job, claim: Claim, spool: Path, notes: list[str]) -> Artifact | None:
    """The newest whole one of an earlier attempt. Damaged ones are struck from the record."""
    while (checkpoint := job.newest("checkpoint")) is not None:
        damage = _fetch(checkpoint, claim.objects, spool / _FILE)
        if damage is None:
            if notes:
                notes.append(f"The run resumes from step {checkpoint.step}.")
            return checkpoint
        notes.append(damage)
        job = claim.remove_artifact(checkpoint)
    if notes:
        notes.append("No checkpoint of this job is whole: the run starts again.")
    return None


def _source_checkpoint(job: Job, claim: Claim, spool: Path, notes: list[str]) -> Artifact | None:
    """The one that the specification names; or the newest whole one of the job that it names."""
    source = job.spec.source
    if source is None:
        return None
    get = claim.store.get
    checkpoint = source_artifact(job.spec, source, get)
    may_be_older = source.step is None and not source.is_best
    others = [a for a in get(source.job).artifacts if a.role == "checkpoint"] if may_be_older else []
    others.sort(key=lambda artifact: artifact.step or 0, reverse=True)
    damages: list[str] = []
    for candidate in [checkpoint, *(other for other in others if other != checkpoint)]:
        damage = _fetch(candidate, claim.objects, spool / _FILE)
        if damage is None:
            if damages:
                notes += [*damages, f"Step {candidate.step} of job {source.job} is taken instead."]
            return candidate
        damages.append(damage)
    raise JobFailed(Reason.BAD_CHECKPOINT, " ".join(damages))


def _best_so_far(job: Job, seed: int | None, claim: Claim, spool: Path, notes: list[str]) -> BestSoFar | None:
    """The policy of the best evaluation in earlier attempts. A damaged one is struck from the record."""
    kept = job.newest("best_policy", seed=seed)
    if kept is None:
        return None
    # A process that was taken over may have named anything.
    if not isinstance(found := kept.metadata.get("return"), int | float):
        return None
    path = _BEST if seed is None else f"{_BEST}-{seed}"
    if (damage := _fetch(kept, claim.objects, spool / path)) is None:
        return BestSoFar(seed=seed, path=path, step=kept.step or 0, episode_return=found)
    notes.append(f"{damage} The best evaluation from now on takes its place.")
    claim.remove_artifact(kept)
    return None


def _fetch(checkpoint: Artifact, objects: ObjectStore, path: Path) -> str | None:
    """Load the file; returns what is wrong with it, or None. Raises StorageUnavailable."""
    try:
        save_whole(checkpoint.key, checkpoint.sha256, objects, path, checkpoint.size)
    except ObjectDamaged as error:
        return f"{checkpoint.name} is damaged: {error.why}."
    except ObjectNotFound:
        return f"{checkpoint.name} has gone from the object store."
    return None


def _as_begun(task: Task, begun: Attempt | None) -> Task:
    """The task as the job began: tuned values and the choice of `auto` may have changed since then."""
    spec = task.spec
    if begun is None or not isinstance(spec, TrainSpec):
        return task
    if had := begun.details.get("hyperparameters"):
        spec = spec.model_copy(update={"algorithm": reported(had)})
    known = {"begun_on": _choice(begun.engine), "made_with": begun.details.get("versions", {})}
    return task.model_copy(update={"spec": spec, **known})


def _with_source(task: Task, claim: Claim) -> Task:
    """The task with what it must know of the job whose checkpoint or policy it takes, if it takes one.

    A training may go on in the checkpoint's environments; the file of a policy does not name its algorithm.
    """
    spec, source = task.spec, task.spec.source
    if source is None:
        return task
    source_job = claim.store.get(source.job)
    made = [attempt.details["versions"] for attempt in source_job.attempts if "versions" in attempt.details]
    task = task.model_copy(update={"made_with": made[-1] if made else {}})
    if source.is_best and isinstance(source_job.spec, TrainSpec):
        return task.model_copy(update={"policy_of": source_job.spec.algorithm.algorithm()})
    if isinstance(spec, RolloutSpec) and source_job.seeds:
        seed = source_job.seeds[0] if source.seed is None else source.seed
        return task.model_copy(update={"policy_seed": seed})
    if not isinstance(spec, TrainSpec):
        return task
    if has_other_clips(source_job.spec.environment, spec.environment):
        return task.model_copy(update={"new_clips": True})
    if spec.algorithm.checkpoint_holds_envs:
        return task.model_copy(update={"source_engine": _choice(source_job.engine)})
    return task


def _with_decoder(task: Task, claim: Claim, spool: Path) -> Task:
    """The task with the policy whose decoder acts, if one does."""
    job_id = decoder_job(task.spec.environment)
    if job_id is None:
        return task
    try:
        file = decoder_file(task.spec.environment, claim.store.get(job_id))
    except (JobNotFound, JobUnreadable) as error:
        detail = f"The decoder of this task is gone. {error.detail}"
        raise JobFailed(Reason.BAD_CHECKPOINT, detail) from None
    if file is None:
        detail = f"Job {job_id}, whose decoder is to act, has no exported policy."
        raise JobFailed(Reason.BAD_CHECKPOINT, detail)
    if (damage := _fetch(file, claim.objects, spool / _DECODER)) is not None:
        raise JobFailed(Reason.BAD_CHECKPOINT, f"The decoder of job {job_id}: {damage}")
    return task.model_copy(update={"decoder": _DECODER})


def _with_experts(task: Task, claim: Claim, spool: Path) -> Task:
    """The task with the policies that a distillation learns from."""
    algorithm = task.spec.algorithm if isinstance(task.spec, TrainSpec) else None
    experts = algorithm.experts if isinstance(algorithm, DistillationSpec) else ()
    found: list[tuple[str, str]] = []
    for number, expert in enumerate(experts):
        path = f"expert-{number}"
        try:
            source = claim.store.get(expert.job)
        except (JobNotFound, JobUnreadable) as error:
            raise JobFailed(Reason.BAD_CHECKPOINT, f"An expert is gone. {error.detail}") from None
        file = expert_file(expert, source)
        if file is None or not isinstance(source.spec, TrainSpec):
            raise JobFailed(Reason.BAD_CHECKPOINT, f"Job {expert.job}, an expert, has no policy.")
        if (damage := _fetch(file, claim.objects, spool / path)) is not None:
            raise JobFailed(Reason.BAD_CHECKPOINT, f"The expert of job {expert.job}: {damage}")
        found.append((path, source.spec.algorithm.algorithm()))
    return task.model_copy(update={"experts": tuple(found)})


def _choice(engine: str | None) -> EngineName | None:
    """Environments with physics of their own name that instead, and have no choice."""
    return next((name for name in get_args(EngineName) if name == engine), None)


def _with_model(task: Task, claim: Claim, spool: Path) -> Task:
    model_id = model_of(task.spec.environment)
    if model_id is None:
        return task
    try:
        record = library.find(model_id, claim.store.models)
        sha256 = model_id.removeprefix("sha256:")
        save_whole(keys.model_source(model_id), sha256, claim.objects, spool / "model")
    except ObjectDamaged as error:
        detail = f"The model {model_id} is damaged: {error.why}. Delete it, and send it again."
        raise JobFailed(Reason.BAD_MODEL, detail) from None
    except ObjectNotFound:
        detail = f"The model {model_id} has gone from the object store. Delete it, and send it again."
        raise JobFailed(Reason.BAD_MODEL, detail) from None
    except ModelNotFound:
        raise JobFailed(Reason.BAD_MODEL, f"The model {model_id} was deleted before the job began.") from None
    described = record.description
    options = catalog.parse_options(MJCF, task.spec.environment.options)
    assert isinstance(options, MjcfOptions)  # noqa: S101
    known = {"engines_that_cannot": dict(engines_that_cannot(described, options))}
    body = None if described is None else edited(described.inventory, options.edits).body_size
    return task.model_copy(update={"model": "model", "body": body, **known})


def _with_clips(task: Task, claim: Claim, spool: Path) -> Task:
    paths: dict[str, str] = {}
    for number, file_id in enumerate(clip_files_of(task.spec.environment)):
        paths[file_id] = f"clips-{number}.npz"
        try:
            record = library.find(file_id, claim.store.clips)
            archive = None if record.description is None else record.description.made.get(ARCHIVE)
            if archive is None:
                raise JobFailed(Reason.BAD_CLIPS, f"The clips {file_id} cannot be used: {record.message}")
            key = keys.made_of_clips(file_id, ARCHIVE)
            save_whole(key, archive.sha256, claim.objects, spool / paths[file_id], archive.size)
        except ObjectDamaged as error:
            detail = f"The clips {file_id} are damaged: {error.why}. Delete them, and send them again."
            raise JobFailed(Reason.BAD_CLIPS, detail) from None
        except ObjectNotFound:
            detail = f"The clips {file_id} have gone from the object store. Delete them, and send them again."
            raise JobFailed(Reason.BAD_CLIPS, detail) from None
        except ClipsNotFound:
            detail = f"The clips {file_id} were deleted before the job began."
            raise JobFailed(Reason.BAD_CLIPS, detail) from None
    return task.model_copy(update={"clips": paths})
