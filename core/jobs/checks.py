"""Checks before a job is stored: each refusal names the place and the remedy."""

from collections.abc import Collection, Iterator
from itertools import islice

from core.algorithms.battery.spec import can_be_tested
from core.algorithms.catalog import reported
from core.algorithms.memory import shown
from core.algorithms.spec import BaseSpec, check_resumption
from core.bounds import LARGEST_JOB_BYTES, MOST_PROBLEMS, json_bytes
from core.environments.info import Device, EnvironmentInfo
from core.environments.randomization import FIELDS
from core.environments.terms.page import task_of
from core.environments.terms.randomized import Randomized
from core.environments.terms.task import TaskOptions
from core.environments.terms.terrain import BOX, MOST_BOXES
from core.environments.terms.unmatched import unmatched
from core.errors import Problem, Rejected
from core.jobs.job import Artifact, Job
from core.jobs.recording import check_recording
from core.jobs.resolved import ResolvedJob, resolve_job
from core.jobs.source import has_other_clips, source_artifact
from core.jobs.spec import (
    MOST_GPUS,
    CheckpointPolicy,
    ConstantPolicy,
    JobSpec,
    RandomPolicy,
    RolloutSpec,
    TrainSpec,
    ZeroPolicy,
    decoder_job,
)
from core.jobs.store import JobStore
from core.jobs.workers import kind_of
from core.physics.availability import check_physics, share_states
from core.rendering.layout import check_cameras, model_camera

# Every worker has this much memory.
_HARMLESS_BYTES = 2**29

# A humanoid's trajectory of this length takes 2 GB.
_MAX_ROLLOUT_STEPS = 1_000_000


def check(spec: JobSpec, store: JobStore) -> None:
    """Raises Rejected with all problems of the first check that finds any."""
    _check_size(spec)
    job = resolve_job(spec, store)
    info = job.info
    if spec.physics != "auto" or not info.own_physics:
        check_physics(spec.physics, info.cannot_run)
    _check_randomization(spec, job)
    _check_video(spec, info)
    _check_devices(spec)
    _check_share(spec, job, store)
    _check_battery(spec, job)
    match spec:
        case TrainSpec():
            _check_training(spec, job, store)
        case RolloutSpec():
            _check_rollout(spec, info, store)


def _check_size(spec: JobSpec) -> None:
    """Refuse a job whose names and numbers would make every listing long."""
    if (size := json_bytes(spec.model_dump(mode="json", exclude_unset=True))) > LARGEST_JOB_BYTES:
        detail = f"The job has {size:,} bytes as JSON; at most {LARGEST_JOB_BYTES:,} are allowed."
        raise Rejected(detail, [Problem("", detail)])


def _check_video(spec: JobSpec, info: EnvironmentInfo) -> None:
    video = spec.video
    if video is None:
        return
    if video.cameras is None:
        model_camera(video.camera, info.cameras)
    else:
        check_cameras(video.cameras, info.cameras)
    video.layout.check()
    if isinstance(spec, RolloutSpec) and video.episodes > spec.num_episodes:
        detail = (
            f"The video shows {video.episodes} episodes, but the rollout makes {spec.num_episodes}: raise "
            "num_episodes, or show fewer."
        )
        raise Rejected(detail, [Problem("/video/episodes", detail), Problem("/num_episodes", detail)])


def _check_randomization(spec: JobSpec, job: ResolvedJob) -> None:
    info = job.info
    if spec.randomization and info.own_physics:
        detail = f"{info.id} runs on Brax's own physics, which has no domain randomization."
        raise Rejected(detail, [Problem("/randomization", detail)])
    if unknown := list(islice(_unknown_names(spec, job), MOST_PROBLEMS)):
        raise Rejected(" ".join(problem.detail for problem in unknown[:5]), unknown)
    if not isinstance(spec, TrainSpec) or not isinstance(job.options, TaskOptions):
        return
    fields = {name for rule in spec.randomization for name in rule.fields}
    for number, term in enumerate(job.options.critic or ()):
        if isinstance(term, Randomized) and term.field not in fields:
            detail = f"No rule of `randomization` changes {term.field}, so the critic would always see 0."
            raise Rejected(detail, [Problem(f"/environment/options/critic/{number}/field", detail)])


def _unknown_names(spec: JobSpec, job: ResolvedJob) -> Iterator[Problem]:
    """Names and patterns of rules that the model lacks, where its parts are known."""
    terrain = job.options.terrain if isinstance(job.options, TaskOptions) else None
    for number, rule in enumerate(spec.randomization):
        kind = FIELDS[rule.field].kind
        if kind is None or not (known := job.info.names.get(kind)):
            continue
        boxes = [f"{BOX}{box}" for box in range(MOST_BOXES)] if terrain and kind == "geom" else []
        yield from unmatched(rule.names or (), [*known, *boxes], kind, f"/randomization/{number}/names")


def _check_devices(spec: JobSpec) -> None:
    """Refuse GPUs and hosts that contradict each other, or that a rollout would share."""
    resources, places = spec.resources, tuple[str, ...]()
    gpus, hosts, detail = resources.gpus, resources.hosts, ""
    if gpus > 1 and resources.accelerator == "cpu":
        detail = f"The job asks for {gpus} GPUs, but its accelerator is `cpu`."
        places = ("/resources/accelerator", "/resources/gpus")
    elif hosts > 1 and isinstance(spec, RolloutSpec):
        detail, places = f"A rollout runs on one host, but the job asks for {hosts}.", ("/resources/hosts",)
    elif gpus > 1 and isinstance(spec, RolloutSpec):
        detail, places = f"A rollout runs on one GPU, but the job asks for {gpus}.", ("/resources/gpus",)
    elif hosts > 1 and resources.kind == "any":
        detail = (
            f"A job on {hosts} hosts must say what it needs there: `gpus`, the number on all hosts together, "
            "or `accelerator` = `cpu`."
        )
        places = ("/resources/hosts",)
    elif resources.kind == "gpu" and gpus % hosts:
        detail = f"gpus = {gpus} is the number on all hosts together, and no multiple of hosts = {hosts}."
        places = ("/resources/gpus", "/resources/hosts")
    elif gpus > MOST_GPUS * hosts:
        detail = f"{gpus} GPUs are more than {MOST_GPUS} on each host."
        places = ("/resources/gpus",)
    if places:
        raise Rejected(detail, [Problem(place, detail) for place in places])


def _check_share(spec: JobSpec, job: ResolvedJob, store: JobStore) -> None:
    """Refuse a part of a GPU that contradicts other wishes, that no GPU has, or that is too small."""
    resources, detail = spec.resources, None
    others = [name for name, number in (("gpus", resources.gpus), ("hosts", resources.hosts)) if number > 1]
    places = ["gpu_memory_gib"]
    if not resources.share_gpu:
        if resources.gpu_memory_gib is not None:
            detail = "`gpu_memory_gib` is for a job that shares a GPU: set `share_gpu`, or leave it out."
    elif resources.kind == "cpu":
        detail, places = "The job shares a GPU, but its accelerator is `cpu`.", ["accelerator", "share_gpu"]
    elif others:
        detail = f"Only a job on one GPU can share it, and this one asks for several {' and '.join(others)}."
        places = ["share_gpu", *others]
    elif resources.gpu_bytes is not None:
        detail = _part_is_wrong(resources.gpu_bytes, spec, job, store)
    if detail is not None:
        raise Rejected(detail, [Problem(f"/resources/{place}", detail) for place in places])


def _part_is_wrong(asked: int, spec: JobSpec, job: ResolvedJob, store: JobStore) -> str | None:
    """A sentence if no GPU has as many bytes, or the run needs more."""
    sizes = [worker.memory_bytes for worker in store.workers() if kind_of(worker.device) == "gpu"]
    known = [size for size in sizes if size is not None]
    if known and len(known) == len(sizes) and asked > max(known):
        largest = shown(max(known))
        return f"The job asks for {shown(asked)} of a GPU, and the largest of a worker has {largest}."
    if isinstance(spec, TrainSpec) and (need := job.memory_on("gpu", 1)).bytes > asked:
        return need.does_not_fit(asked, "the part of a GPU that it asks for")
    return None


def _check_battery(spec: JobSpec, job: ResolvedJob) -> None:
    if spec.battery is None:
        return
    detail = None
    task = task_of(job.info, job.options)
    if task is None or not can_be_tested(task):
        detail = (
            "A battery tests how well a policy follows velocity commands or clips, and this task of "
            f"{job.info.id} has neither: leave `battery` out{_what_could_be_tested(job.info)}."
        )
    elif spec.kind == "rollout" and not isinstance(spec.policy, CheckpointPolicy):
        detail = "A battery tests a trained policy: take that of a job's checkpoint, or leave `battery` out."
    elif decoder_job(spec.environment) is not None:
        detail = "A battery tests policies that move a body themselves, and here a decoder does."
    elif (why := job.info.cannot_run.get("native")) is not None:
        detail = f"A battery runs in C MuJoCo. {why}"
    if detail is not None:
        raise Rejected(detail, [Problem("/battery", detail)])


def _what_could_be_tested(info: EnvironmentInfo) -> str:
    """The end of a sentence: what makes a task of the environment one that a battery tests, if anything."""
    options = info.options.model_fields
    if "command" in options:
        return ", or give it a `command` or a `reference`"
    return ', or take `task`: "imitate" and a `reference`' if "reference" in options else ""


def _check_training(spec: TrainSpec, job: ResolvedJob, store: JobStore) -> None:
    for settings in job.settings.values():
        settings.check_sharing(spec.resources.num_devices, spec.resources.hosts)
    _check_seeds(spec)
    _check_memory(spec, job, store)
    if spec.source is not None:
        checkpoint, source = source_artifact(spec, spec.source, store.get), store.get(spec.source.job)
        _check_same_seeds(spec, source)
        _check_budget(job.settings.values(), checkpoint)
        _check_fields(spec, source)
        _check_engine(spec, source)
        _check_fit(job, source)


def _check_memory(spec: TrainSpec, job: ResolvedJob, store: JobStore) -> None:
    """Refuse a job that fits on no worker's device; one that does not report its memory may have enough."""
    needs = job.memory
    if max(need.bytes for need in needs.values()) < _HARMLESS_BYTES:
        return
    sizes: list[tuple[Device, int]] = []
    for worker in store.workers():
        device = kind_of(worker.device)
        if device in needs and worker.memory_bytes is None:
            return
        if device in needs and worker.memory_bytes is not None:
            sizes.append((device, worker.memory_bytes))
    if not sizes or any(needs[device].bytes <= size for device, size in sizes):
        return
    device, size = max(sizes, key=lambda found: found[1])
    detail = needs[device].does_not_fit(size, f"the largest {device.upper()} of a worker")
    places = [name.replace(".", "/") for name in needs[device].lower if " " not in name]
    problems = [Problem(f"/algorithm/{place}", detail) for place in places]
    raise Rejected(detail, [*problems, *([Problem("/seeds", detail)] if spec.seeds else [])])


def _check_seeds(spec: TrainSpec) -> None:
    if spec.seeds is None:
        return
    spec.algorithm.check_seeds()
    if (hosts := spec.resources.hosts) > 1:
        detail = f"Several seeds are trained on one device, but the job asks for {hosts} hosts."
        raise Rejected(detail, [Problem("/seeds", detail), Problem("/resources/hosts", detail)])
    if (gpus := spec.resources.gpus) > 1:
        detail = f"Several seeds are trained on one device, but the job asks for {gpus} GPUs."
        raise Rejected(detail, [Problem("/seeds", detail), Problem("/resources/gpus", detail)])


def _check_same_seeds(spec: TrainSpec, source: Job) -> None:
    """A checkpoint holds all of a job's seeds, and nothing else can continue from it."""
    if source.seeds != tuple(spec.seeds or ()):
        had = f"the seeds {list(source.seeds)}" if source.seeds else "a single seed"
        asked = f"the seeds {spec.seeds}" if spec.seeds else "a single seed"
        detail = f"The checkpoint is of {had}, and this job trains {asked}: they must be the same."
        raise Rejected(detail, [Problem("/seeds", detail), Problem("/resume_from", detail)])


def _check_budget(by_device: Collection[BaseSpec], checkpoint: Artifact) -> None:
    """Refuse a job that would end at once, without a step, on every device that it may get."""
    step, budget = checkpoint.step or 0, max(settings.budget for settings in by_device)
    if step >= budget:
        detail = (
            f"The checkpoint is of step {step:,}, and the job's budget of {budget:,} steps counts those "
            "before it: nothing is left to train. Ask for more."
        )
        raise Rejected(detail, [Problem("/algorithm", detail), Problem("/resume_from", detail)])


def _check_engine(spec: TrainSpec, source: Job) -> None:
    """`auto` takes an engine that can go on from the checkpoint. With other clips any can: episodes begin."""
    had = source.engine
    if had is None or spec.physics == "auto" or not spec.algorithm.checkpoint_holds_envs:
        return
    if has_other_clips(source.spec.environment, spec.environment):
        return
    if not share_states(had, spec.physics):
        detail = (
            f"The checkpoint holds states of the engine {had}, and a run on {spec.physics} cannot resume "
            f"from them: ask for {had}."
        )
        raise Rejected(detail, [Problem("/physics", detail)])


def _check_fields(spec: TrainSpec, source: Job) -> None:
    """A checkpoint holds the randomized fields, and a clock where they change within episodes; their ranges
    and intervals may change."""
    had, has = (
        sorted({name for rule in one.randomization for name in rule.fields}) for one in (source.spec, spec)
    )
    if had != has:
        detail = (
            f"The checkpoint's job randomizes {', '.join(had) or 'nothing'}, this one "
            f"{', '.join(has) or 'nothing'}; the fields must be the same, only their ranges may change."
        )
        raise Rejected(detail, [Problem("/randomization", detail)])
    had_clock, has_clock = (
        any(rule.every_s is not None for rule in one.randomization) for one in (source.spec, spec)
    )
    if had_clock != has_clock:
        detail = (
            "Only one of this job and the checkpoint's has a rule with `every_s`: give one to both or to "
            "neither, since the checkpoint holds the time since an episode's start only where it counts."
        )
        raise Rejected(detail, [Problem("/randomization", detail)])


def _check_fit(job: ResolvedJob, source: Job) -> None:
    """Refuse a job that cannot load the source's checkpoints on any device that it may get."""
    used = [a.details["hyperparameters"] for a in source.attempts if "hyperparameters" in a.details]
    if not used:
        return
    made_with = reported(used[-1])
    refusals: list[Rejected] = []
    for settings in job.settings.values():
        try:
            check_resumption(settings, made_with)
        except Rejected as refusal:
            refusals.append(refusal)
        else:
            return
    raise refusals[0]


def _check_rollout(spec: RolloutSpec, info: EnvironmentInfo, store: JobStore) -> None:
    if (steps := spec.num_steps * spec.num_episodes) > _MAX_ROLLOUT_STEPS:
        detail = (
            f"num_steps × num_episodes = {steps:,}, but a rollout may have {_MAX_ROLLOUT_STEPS:,} steps: "
            f"its trajectory is held in memory. Submit several rollouts with different seeds."
        )
        raise Rejected(detail, [Problem("/num_steps", detail), Problem("/num_episodes", detail)])
    if spec.source is not None:
        source_artifact(spec, spec.source, store.get)
    check_recording(spec, info, store.get)
    match spec.policy:
        case ConstantPolicy(action=action) if len(action) != info.action_size:
            detail = f"{info.id} takes {info.action_size} action components; {len(action)} were given."
            raise Rejected(detail, [Problem("/policy/action", detail)])
        case CheckpointPolicy() | ConstantPolicy() | RandomPolicy() | ZeroPolicy():
            pass
