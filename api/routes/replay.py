"""A job's replay: episodes as the page draws them in three dimensions (docs/replay.md)."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from api.dependencies import JobId, QueryParameters, ServiceDep
from api.files import file_response, responses
from api.routes.files import OfSeed, absence, check_seed, last_made, of_seed
from core.algorithms.catalog import ALGORITHMS
from core.errors import ArtifactNotFound
from core.jobs.job import Artifact, Job
from core.jobs.spec import TrainSpec

router = APIRouter(tags=["files"])


class ReplayQuery(QueryParameters):
    """Selects a replay; by default the newest."""

    step: int | None = Field(None, ge=0, le=10**18, description="The one of the checkpoint with this step.")
    seed: OfSeed = None


@router.head("/jobs/{job_id}/replay", include_in_schema=False, response_class=Response)
@router.get(
    "/jobs/{job_id}/replay",
    response_class=Response,
    responses=responses("application/octet-stream"),
)
def read_replay(
    job_id: JobId, asked: Annotated[ReplayQuery, Query()], service: ServiceDep, request: Request
) -> Response:
    """The poses of bodies in episodes: a header in JSON, then numbers, which `Range` reaches."""
    return file_response(request, _replay(service.store.get(job_id), asked), service)


@router.head("/jobs/{job_id}/replay/scene", include_in_schema=False, response_class=Response)
@router.get(
    "/jobs/{job_id}/replay/scene",
    response_class=Response,
    responses=responses("model/gltf-binary"),
)
def read_scene(job_id: JobId, service: ServiceDep, request: Request) -> Response:
    """The body and its surroundings as binary glTF."""
    job = service.store.get(job_id)
    found = job.newest("scene")
    if found is None:
        raise _none(job, "scene")
    return file_response(request, found, service)


@router.head("/jobs/{job_id}/simulation", include_in_schema=False, response_class=Response)
@router.get(
    "/jobs/{job_id}/simulation",
    response_class=Response,
    responses=responses("application/json"),
)
def read_simulation(job_id: JobId, service: ServiceDep, request: Request) -> Response:
    """The trained body for MuJoCo alone: its model, what it observes, how an action moves it."""
    job = service.store.get(job_id)
    found = job.newest("simulation")
    if found is None:
        raise _no_simulation(job)
    return file_response(request, found, service)


def _no_simulation(job: Job) -> Exception:
    """Why there is none: nothing was trained, the page cannot run the policy, or the job is older."""
    if not isinstance(job.spec, TrainSpec):
        detail = f"Job {job.id} is a rollout; open the job that trained its policy."
    elif why := ALGORITHMS[job.spec.algorithm.algorithm()].no_export:
        detail = f"Job {job.id} has no simulation, since the page cannot run its policy: {why}."
    elif job.newest("policy") is not None:
        detail = f"Job {job.id} has no simulation: an older version trained it."
    else:
        return absence(job, "simulation", "simulation")
    return ArtifactNotFound(detail, job=job.id, job_status=job.status, artifacts=[], reason=job.reason)


def _replay(job: Job, asked: ReplayQuery) -> Artifact:
    check_seed(job, asked.seed)
    step = asked.step
    found = [one for one in job.files_of(asked.seed) if one.role == "replay" and step in (None, one.step)]
    if not found:
        at_step = "" if step is None else f" of step {step}"
        raise _none(job, f"replay{at_step}{of_seed(job, asked.seed)}")
    return last_made(found)


def _none(job: Job, wanted: str) -> Exception:
    """Why there is none: it comes later, was not asked for, or the job is older than replays."""
    has_trajectory = job.newest("trajectory") is not None
    if job.status.is_final and has_trajectory and job.newest("replay") is None:
        again = "roll its policy out" if isinstance(job.spec, TrainSpec) else "submit it"
        detail = (
            f"Job {job.id} has no {wanted}: an older version ran it, or its events say why. "
            f"To get one, {again} again."
        )
    elif isinstance(job.spec, TrainSpec) and job.spec.video is None:
        detail = f"Job {job.id} has no {wanted}: its `video` is null, and replays show what videos would."
    else:
        return absence(job, wanted, "replay")
    names = [artifact.name for artifact in job.artifacts]
    return ArtifactNotFound(detail, job=job.id, job_status=job.status, artifacts=names, reason=job.reason)
