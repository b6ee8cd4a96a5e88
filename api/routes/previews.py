"""Previews of an environment before any training: stills from its cameras, rendered by a worker and kept."""

import time
from collections.abc import Sequence
from typing import Annotated, Any
from urllib.parse import urlencode

from anyio import sleep
from anyio.to_thread import run_sync
from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import JSONResponse
from pydantic import Field

from api.access import PrincipalDep
from api.dependencies import QueryParameters, Service, ServiceDep
from api.files import file_response
from api.problems import refusals
from api.submissions import MAX_OPTIONS_LENGTH, OPTIONS_DESCRIPTION, in_the_query, parse_options
from core.accounts.principal import Principal
from core.bounds import LONGEST_NAME
from core.environments import catalog
from core.errors import (
    EnvironmentNotFound,
    NothingDraws,
    NoWorker,
    Problem,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
    TooManyPreviews,
)
from core.jobs.job import Artifact
from core.jobs.queue import looks_at_models
from core.jobs.resolved import model_of, resolve_environment
from core.jobs.spec import EnvironmentSpec
from core.jobs.submission import check_readable_uploads
from core.jobs.uploads import archives_of
from core.previews import library
from core.previews.record import Preview, PreviewRequest, Still
from core.rendering.layout import camera_choices, model_camera
from core.rendering.request import Overlay
from gaitway.schema import PreviewView, StillView

router = APIRouter(tags=["catalog"])

# How long a request waits for the stills before it is answered 202.
_TIMEOUT_S = 5.0
_POLL_S = 0.1
# The maximum in one preview; the stills of a model's further cameras are asked for one by one.
_MAX_STILLS = 32


class PreviewParameters(QueryParameters):
    """The environment that the stills show, the camera, and what is drawn besides the body."""

    options: str = Field(
        "{}",
        max_length=MAX_OPTIONS_LENGTH,
        description=OPTIONS_DESCRIPTION,
        examples=['{"walker": "rodent"}'],
    )
    camera: str | None = Field(
        None,
        max_length=200,
        description="`track`, or a camera of the model by name or number; the answer is then its PNG.",
        examples=["track"],
    )
    show: list[Overlay] = Field(
        [],
        max_length=4,
        description="Drawn besides the body, as in a job's `video.show`; several times for several.",
        examples=[["joints"]],
    )
    width: int = Field(640, ge=16, le=1920, description="Pixels.")
    height: int = Field(480, ge=16, le=1920, description="Pixels.")


def _view(
    wanted: PreviewRequest, stills: Sequence[Still], here: str, asked: PreviewParameters
) -> PreviewView:
    query_of_all = asked.model_dump(exclude_unset=True, exclude={"camera"})

    def href(**also: object) -> str:
        query = urlencode({**query_of_all, **also}, doseq=True)
        return f"{here}?{query}" if query else here

    return PreviewView(
        environment=wanted.environment,
        options=wanted.options,
        status="ready" if stills else "drawing",
        cameras=tuple(wanted.cameras),
        stills=tuple(
            StillView(
                camera=still.camera, size=still.size, sha256=still.sha256, href=href(camera=still.camera)
            )
            for still in stills
        ),
        links={"self": href()},
    )


@router.get(
    "/environments/{environment_id:path}/preview",
    response_model=PreviewView,
    response_description="The stills, each with its address; with `camera`, the PNG itself",
    responses={
        200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}},
        202: {
            "model": PreviewView,
            "description": "A worker has yet to render them; ask again at the Location",
        },
        304: {"description": "`If-None-Match` names this PNG"},
        **refusals(
            EnvironmentNotFound,
            Rejected,
            NoWorker,
            TooManyPreviews,
            NothingDraws,
            StorageUnavailable,
            RecordsUnavailable,
        ),
    },
)
async def preview_environment(
    environment_id: Annotated[str, Path(max_length=LONGEST_NAME, examples=["ant"])],
    asked: Annotated[PreviewParameters, Query()],
    service: ServiceDep,
    principal: PrincipalDep,
    request: Request,
) -> Any:
    """The environment as an episode begins, seen by the camera `track` and each of the model's own."""
    wanted, camera = await run_sync(_wanted, environment_id, asked, service, principal)
    drawn = await _drawn(wanted, service)
    here = request.url.path
    if drawn is None:
        again = f"{here}?{request.url.query}" if request.url.query else here
        view = _view(wanted, [], here, asked)
        return JSONResponse(view.model_dump(mode="json"), 202, {"Location": again, "Retry-After": "2"})
    if camera is None:
        return _view(wanted, drawn.stills, here, asked)
    still = next(still for still in drawn.stills if still.camera == camera)
    return await run_sync(file_response, request, _file(wanted, still), service)


def _wanted(
    environment_id: str, asked: PreviewParameters, service: Service, principal: Principal
) -> tuple[PreviewRequest, str | int | None]:
    """The stills to render, and the camera that the request asks for.

    Raises EnvironmentNotFound, and Rejected with the same messages as for a job.
    """
    catalog.find(environment_id)
    environment = EnvironmentSpec(id=environment_id, options=parse_options(asked.options))
    try:
        check_readable_uploads(environment, principal.readable, service.store)
        info, options = resolve_environment(environment, service.store)
        cameras = camera_choices(info.cameras)
        camera = None if asked.camera is None else _camera(asked.camera, info.cameras)
    except Rejected as refusal:
        raise in_the_query(refusal) from None
    shown = cameras[:_MAX_STILLS]
    request = PreviewRequest(
        environment=environment_id,
        options=options.model_dump(mode="json"),
        model=model_of(environment),
        clips=archives_of(environment, service.store),
        cameras=shown if camera is None or camera in shown else [camera],
        show=asked.show,
        width=asked.width,
        height=asked.height,
    )
    return request, camera


def _camera(written: str, cameras: Sequence[str]) -> str | int:
    """The camera that a query names, as `camera_choices` calls it."""
    by_number = written.isdecimal() and written not in cameras
    number = model_camera(int(written) if by_number else written, cameras)
    return camera_choices(cameras)[0 if number is None else number + 1]


async def _drawn(wanted: PreviewRequest, service: Service) -> Preview | None:
    """The stills once they exist; None after `_TIMEOUT_S`.

    Raises NoWorker, TooManyPreviews; NothingDraws and Rejected where a worker tried and failed.
    """
    until = time.monotonic() + _TIMEOUT_S
    drawn = await run_sync(library.find, wanted, service.objects)
    if drawn is None:
        await run_sync(_ask, wanted, service)
    while drawn is None and time.monotonic() < until and not service.stopping:
        await sleep(_POLL_S)
        drawn = await run_sync(library.find, wanted, service.objects)
    if drawn is not None and drawn.failure is not None:
        # The next request tries again.
        await run_sync(library.forget, wanted, service.objects)
        if drawn.failure.reason == "no_gl":
            raise NothingDraws(drawn.failure.message)
        raise Rejected(drawn.failure.message, [Problem("/options", drawn.failure.message)])
    return drawn


def _ask(wanted: PreviewRequest, service: Service) -> None:
    if not any(looks_at_models(worker.queues) for worker in service.store.workers()):
        raise NoWorker("No worker is available to render it: start one, and ask again.")
    library.ask(wanted, service.queue)


def _file(wanted: PreviewRequest, still: Still) -> Artifact:
    name = f"{wanted.environment}-{still.camera}.png".replace("/", "-")
    return Artifact(
        name=name, role="poster", media_type="image/png", size=still.size, sha256=still.sha256, key=still.key
    )
