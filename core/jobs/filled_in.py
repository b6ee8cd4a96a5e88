"""A job's specification with all that defaults fill in: a job that trains the same elsewhere."""

from typing import Any

from core.errors import Rejected
from core.jobs.job import Job
from core.jobs.resolved import DEVICES, ResolvedJob, resolve_job
from core.jobs.spec import TrainSpec
from core.user_models.store import ModelStore


def filled_in(job: Job, store: ModelStore) -> dict[str, Any]:
    """The specification as JSON, with every field. It may be submitted again.

    The hyperparameters are those of the newest attempt; before there is one, those that a CPU would get, or
    a GPU where the job asks for one. Of an environment that the service no longer has, or whose model was
    deleted, the options that were not sent are left out.
    """
    spec = job.spec
    document: dict[str, Any] = {"kind": spec.kind, **spec.model_dump(mode="json")}
    if "gpus" not in spec.resources.model_fields_set:
        del document["resources"]["gpus"]  # A job that says 1 gets a GPU.
    resolved = None
    try:
        resolved = resolve_job(spec, store)
        document["environment"]["options"] = resolved.options.model_dump(mode="json")
    except Rejected:
        document["environment"]["options"] = dict(spec.environment.options)
    if isinstance(spec, TrainSpec):
        document["algorithm"] = _hyperparameters(job, spec, resolved)
        del document["seeds" if spec.seeds is None else "seed"]  # The two exclude each other.
    if spec.video is not None and spec.video.cameras is not None:
        del document["video"]["camera"]  # The two exclude each other.
    return document


def _hyperparameters(job: Job, spec: TrainSpec, resolved: ResolvedJob | None) -> dict[str, Any]:
    for attempt in reversed(job.attempts):
        if used := attempt.details.get("hyperparameters"):
            return {"kind": spec.algorithm.algorithm(), **used}
    if resolved is None:
        return {
            "kind": spec.algorithm.algorithm(),
            **spec.algorithm.model_dump(mode="json", exclude_unset=True),
        }
    return resolved.settings_on(DEVICES[spec.resources.kind][0]).model_dump(mode="json")
