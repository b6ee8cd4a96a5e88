"""A job's files: videos, checkpoints, everything else."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, cast

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import Field

from api.dependencies import JobId, QueryParameters, ServiceDep
from api.files import file_response, responses
from api.problems import refusals
from api.views import Listing, answer, artifact_view
from core.algorithms.catalog import ALGORITHMS
from core.bounds import LONGEST_NAME
from core.errors import (
    ArtifactNotFound,
    ArtifactNotReady,
    JobNotFound,
    JobUnreadable,
    NotFound,
    Problem,
    RecordsUnavailable,
    Rejected,
)
from core.jobs.job import Artifact, ArtifactRole, Job
from core.jobs.retention import removed_by_rule
from core.jobs.source import no_such_seed
from core.jobs.spec import TrainSpec
from gaitway.schema import ArtifactView

router = APIRouter(tags=["files"])


OfSeed = Annotated[
    int | None,
    Field(ge=0, le=2**31 - 1, description="Whose, if the job trains several seeds; by default the first."),
]


class Picture(QueryParameters):
    """Selects a video or poster; by default the newest."""

    step: int | None = Field(None, ge=0, le=10**18, description="The one of the checkpoint with this step.")
    camera: str | None = Field(None, max_length=200, description="The one from this camera.")
    seed: OfSeed = None

    def shows(self, artifact: Artifact) -> bool:
        facts = artifact.metadata
        named: object = facts.get("cameras", [facts.get("camera", "")])  # Older records name one.
        # An imported job's metadata may hold anything here.
        cameras = [str(one) for one in cast("list[object]", named)] if isinstance(named, list) else []
        return self.step in (None, artifact.step) and (self.camera is None or self.camera in cameras)


Asked = Annotated[Picture, Query()]


class PolicyQuery(QueryParameters):
    """Selects a policy and its form."""

    which: Literal["last", "best"] = Field(
        "last",
        description="`best`: the policy whose evaluation had the highest return. In a form for programs "
        "elsewhere it is there when the training has ended.",
    )
    format: Literal["numpy", "onnx", "robot"] | None = Field(
        None,
        description="For programs elsewhere: `numpy` needs NumPy alone, `onnx` any ONNX runtime, and so does "
        "`robot`, which goes from what a robot measures to its joints' targets. Without it, "
        "the algorithm's own file, which `client.load_policy` reads, and for PPO and SAC Brax.",
    )
    seed: OfSeed = None


def _file_route(path: str, media_type: str) -> Callable[[Callable[..., Response]], Callable[..., Response]]:
    """Registers a documented GET and an undocumented HEAD."""

    def register(endpoint: Callable[..., Response]) -> Callable[..., Response]:
        router.head(path, include_in_schema=False, response_class=Response)(endpoint)
        return router.get(path, response_class=Response, responses=responses(media_type))(endpoint)

    return register


@router.get(
    "/jobs/{job_id}/artifacts",
    response_model=Listing[ArtifactView],
    responses=refusals(JobNotFound, JobUnreadable, RecordsUnavailable),
)
def list_artifacts(job_id: JobId, service: ServiceDep) -> Response:
    """All files of a job."""
    artifacts = service.store.get(job_id).artifacts
    return answer(Listing[ArtifactView](items=[artifact_view(job_id, one) for one in artifacts]))


@router.get(
    "/jobs/{job_id}/checkpoints",
    response_model=Listing[ArtifactView],
    responses=refusals(JobNotFound, JobUnreadable, RecordsUnavailable),
)
def list_checkpoints(job_id: JobId, service: ServiceDep) -> Response:
    """The kept checkpoints, ordered by step."""
    found = [artifact for artifact in service.store.get(job_id).artifacts if artifact.role == "checkpoint"]
    found.sort(key=lambda artifact: artifact.step or 0)
    return answer(Listing[ArtifactView](items=[artifact_view(job_id, one) for one in found]))


@_file_route("/jobs/{job_id}/video", "video/mp4")
def read_video(
    job_id: JobId, asked: Annotated[Picture, Query()], service: ServiceDep, request: Request
) -> Response:
    """The newest video as MP4, or the one of a given step or camera."""
    return file_response(request, _picture(service.store.get(job_id), "video", asked), service)


@_file_route("/jobs/{job_id}/poster", "image/png")
def read_poster(
    job_id: JobId, asked: Annotated[Picture, Query()], service: ServiceDep, request: Request
) -> Response:
    """A still of the video as PNG."""
    return file_response(request, _picture(service.store.get(job_id), "poster", asked), service)


@_file_route("/jobs/{job_id}/policy", "application/octet-stream")
def read_policy(
    job_id: JobId, asked: Annotated[PolicyQuery, Query()], service: ServiceDep, request: Request
) -> Response:
    """The trained policy: in its algorithm's own file, or for programs without this project."""
    return file_response(request, _policy(service.store.get(job_id), asked), service)


@_file_route("/jobs/{job_id}/checkpoints/{step}", "application/octet-stream")
def read_checkpoint(
    job_id: JobId,
    step: Annotated[int, Path(ge=0, le=10**18, examples=[500_000])],
    service: ServiceDep,
    request: Request,
) -> Response:
    """The whole state of the run at this step, as one file."""
    job = service.store.get(job_id)
    found = job.newest("checkpoint", step)
    if found is None:
        raise absence(job, f"checkpoint of step {step}", "checkpoint")
    return file_response(request, found, service)


@_file_route("/jobs/{job_id}/artifacts/{name}", "*/*")
def read_artifact(
    job_id: JobId,
    name: Annotated[str, Path(max_length=LONGEST_NAME, examples=["video.mp4"])],
    service: ServiceDep,
    request: Request,
) -> Response:
    """A file by its name."""
    job = service.store.get(job_id)
    found = next((artifact for artifact in job.artifacts if artifact.name == name), None)
    if found is None:
        raise absence(job, f"file {name[:100]!r}")
    return file_response(request, found, service)


def _picture(job: Job, role: ArtifactRole, asked: Picture) -> Artifact:
    check_seed(job, asked.seed)
    found = [one for one in job.files_of(asked.seed) if one.role == role and asked.shows(one)]
    if not found and job.spec.video is None:
        detail = f"Job {job.id} asks for no video: its `video` is null."
        raise ArtifactNotFound(detail, job=job.id, job_status=job.status, artifacts=[], reason=job.reason)
    if not found:
        step = "" if asked.step is None else f" of step {asked.step}"
        camera = "" if asked.camera is None else f" by camera {asked.camera!r}"
        raise absence(job, f"{role}{step}{camera}{of_seed(job, asked.seed)}", role)
    return last_made(found)


# By the format that a client asks for.
_ENDINGS = {"numpy": "npz", "onnx": "onnx", "robot": "robot.onnx"}
# The name and the role of a policy's own file.
_POLICIES: dict[str, tuple[str, ArtifactRole]] = {
    "last": ("policy", "policy"),
    "best": ("policy-best", "best_policy"),
}


def _policy(job: Job, asked: PolicyQuery) -> Artifact:
    if not isinstance(job.spec, TrainSpec):
        detail = f"Job {job.id} is a rollout, which trains no policy."
        raise ArtifactNotFound(detail, job=job.id, job_status=job.status, artifacts=[], reason=job.reason)
    check_seed(job, asked.seed)
    stem, role = _POLICIES[asked.which]
    own, form = job.newest(role, seed=asked.seed), asked.format
    if job.seeds:
        stem = f"{stem}-seed-{job.seeds[0] if asked.seed is None else asked.seed}"
    if form is None:
        if own is None:
            raise absence(job, stem, role)
        return own
    _check_exportable(job.spec, form)
    name = f"{stem}.{_ENDINGS[form]}"
    found = next((artifact for artifact in job.artifacts if artifact.name == name), None)
    if found is not None and own is not None and found.step != own.step:
        found = None  # It belongs to an earlier attempt, whose best policy was another.
    if found is None and own is not None and job.status.is_final:
        if form == "robot":
            detail = (
                f"Job {job.id} has a {stem} and no {name}, which tasks of terms have whose `action` is "
                "`joint_position`. Take the format `onnx`."
            )
            raise ArtifactNotFound(
                detail, job=job.id, job_status=job.status, artifacts=[own.name], reason=job.reason
            )
        detail = (
            f"Job {job.id} has a {stem} and no {name}: either its events say why, or a version that wrote "
            "none has trained it. Without `format` you get the policy's own file."
        )
        raise ArtifactNotFound(
            detail, job=job.id, job_status=job.status, artifacts=[own.name], reason=job.reason
        )
    if found is None:
        raise absence(job, name, role)
    if own is None and not job.status.is_final:
        raise absence(job, f"final {name}", "export")
    return found


def check_seed(job: Job, seed: int | None) -> None:
    """Raises ArtifactNotFound where the job has no such seed."""
    if detail := no_such_seed(job, seed):
        raise ArtifactNotFound(detail)


def of_seed(job: Job, seed: int | None) -> str:
    """The end of a sentence about a file, where it matters whose it is."""
    return f" of seed {seed}" if job.seeds and seed is not None else ""


def _check_exportable(spec: TrainSpec, form: str) -> None:
    kind = spec.algorithm.algorithm()
    if why := ALGORITHMS[kind].no_export:
        detail = (
            f"There is no policy of {kind} as {form}: {why}. Without `format` you get the policy's own file, "
            "which `client.load_policy` reads."
        )
        raise Rejected(detail, [Problem("/format", detail)])


def last_made(found: Sequence[Artifact]) -> Artifact:
    """The newest of these, of which one at least; one without a step was made at the job's end."""
    return max(found, key=lambda artifact: float("inf") if artifact.step is None else artifact.step)


def absence(job: Job, wanted: str, role: ArtifactRole | None = None) -> NotFound:
    """The refusal for a file that is missing, for now or for good; it names the files that exist."""
    there = [artifact for artifact in job.artifacts if role in (None, artifact.role)]
    names = ", ".join(artifact.name for artifact in there[:20])
    instead = f" It has {names}." if there else ""
    facts: dict[str, Any] = {"job": job.id, "job_status": job.status, "artifacts": [a.name for a in there]}
    if not job.status.is_final:
        return ArtifactNotReady(f"Job {job.id} is {job.status} and has no {wanted} yet.{instead}", **facts)
    because = f" ({job.reason}: {job.message})" if job.reason else ""
    sentence = f"Job {job.id} has ended as {job.status}{because} without a {wanted}.{instead}"
    if role is not None:
        sentence += removed_by_rule(job, role)
    if role in ("video", "poster") and any(artifact.role == "replay" for artifact in job.artifacts):
        sentence += " Its replay is there, in 3D on its page."
        if isinstance(job.spec, TrainSpec):
            sentence += f" `gaitway rollout {job.id}` draws a video."
    return ArtifactNotFound(sentence, reason=job.reason, **facts)
