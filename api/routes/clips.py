"""Files of clips: upload one, see its contents and its replay, name it, delete it."""

import re
from collections.abc import Sequence
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field, TypeAdapter

from api.access import Forbidden, PrincipalDep, ownership_of_new
from api.dependencies import Service, ServiceDep
from api.files import file_response, responses
from api.problems import (
    BodyTooLarge,
    MalformedBody,
    TooManyUploads,
    UnsupportedMediaType,
    refusals,
)
from api.submissions import PatchBody, Upload, parse, patch_of
from api.uploads import (
    Name,
    SentUpload,
    UploadFilters,
    added,
    own_projects,
    page_of,
    received,
    settled,
    shown,
)
from api.views import Listing, answer
from core.accounts.principal import Ownership, Principal
from core.clips.record import REPLAY, SCENE, ClipFile, clips_id
from core.documents import Strict
from core.environments import catalog
from core.errors import (
    ArtifactNotFound,
    BadClips,
    ClipsInUse,
    ClipsNotFound,
    EnvironmentNotFound,
    ModelNotFound,
    Problem,
    QuotaExceeded,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.ending import remove_upload
from core.jobs.job import Artifact, ArtifactRole
from core.jobs.spec import EnvironmentSpec
from core.jobs.submission import check_readable_uploads
from core.storage import keys
from core.uploads import library
from gaitway.schema import ClipFileView, ClipsContents

router = APIRouter(tags=["clips"])

_ANY = "application/octet-stream"
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            _ANY: {
                "schema": {
                    "type": "string",
                    "format": "binary",
                    "description": "Clips in one of the formats that docs/imitation.md lists.",
                }
            }
        },
    }
}
# The pattern documents; another id is one that nobody has.
ClipsId = Annotated[
    str,
    Path(
        description="The id that `POST /clips` returned.",
        examples=[f"sha256:{'0' * 64}"],
        json_schema_extra={"pattern": "^sha256:[0-9a-f]{64}$"},
    ),
]


class SentClips(SentUpload):
    """The parameters that come with the file. With another body or rate, it is another file of clips."""

    body: str = Field(
        min_length=1,
        max_length=200,
        description="Whose clips they are: an environment of the catalog, or a model of your own by its id.",
        examples=["g1"],
    )
    rate: float | None = Field(
        None,
        gt=0,
        le=10_000,
        allow_inf_nan=False,
        description="Frames per second, for a file that does not say.",
    )


class ClipsPatch(Strict):
    """What may be changed."""

    name: Name


_PATCH: TypeAdapter[ClipsPatch] = TypeAdapter(ClipsPatch)


def _views(records: Sequence[ClipFile], service: Service, principal: Principal) -> list[ClipFileView]:
    return [_view(record, whose) for record, whose in shown(records, service.store.clips, principal)]


def _view(record: ClipFile, whose: Ownership) -> ClipFileView:
    here = f"/clips/{record.id}"
    found = record.description
    links = {"self": here, "file": f"{here}/file"}
    if found is not None and found.num_replayed:
        links |= {"replay": f"{here}/replay", "scene": f"{here}/replay/scene"}
    return ClipFileView(
        **record.model_dump(exclude={"description", "refused_at", "sha256"}),
        description=None if found is None else ClipsContents.model_validate(found.model_dump()),
        owner=whose.owner,
        project=whose.project,
        links=links,
    )


async def _added(
    request: Request, sent: Annotated[SentClips, Query()], service: ServiceDep, principal: PrincipalDep
) -> ClipFile:
    said = request.headers.get("content-type", "")
    if said.partition(";")[0].strip().lower() != _ANY:
        raise UnsupportedMediaType(said, what="a file of clips", accepted=(_ANY,))
    ownership = await run_sync(ownership_of_new, principal, sent.project, service)
    await run_sync(_check_body, sent.body, service, principal)
    clips = service.store.clips
    async with received(request, clips, service.settings.max_clips_bytes, service) as upload:
        if not upload.size:
            raise BadClips("The file is empty.")
        return await run_sync(_add, upload, sent, ownership, service, principal)


def _check_body(body: str, service: Service, principal: Principal) -> None:
    """Raises Rejected where there is no such body."""
    if body.startswith("sha256:"):
        environment = EnvironmentSpec(id="mjcf", options={"model": body})
        try:
            check_readable_uploads(environment, principal.readable, service.store)
            status = library.find(body, service.store.models).status
        except (Rejected, ModelNotFound) as error:
            raise Rejected(error.detail, [Problem("/body", error.detail)]) from None
        if status == "ready":
            return
        detail = f"The model {body} is not ready: it is {status}."
    else:
        try:
            if not catalog.find(body).takes_model:
                return
            detail = f"{body} has no body of its own: give the id of the model, sha256:…."
        except EnvironmentNotFound as error:
            detail = error.detail
    raise Rejected(detail, [Problem("/body", detail)])


def _add(
    upload: Upload, sent: SentClips, ownership: Ownership, service: Service, principal: Principal
) -> ClipFile:
    store = service.store
    record = ClipFile(
        id=clips_id(upload.sha256, sent.body, sent.rate),
        name=sent.name,
        status="validating",
        media_type=_ANY,
        size=upload.size,
        created_at=store.now(),
        sha256=upload.sha256,
        body=sent.body,
        rate=sent.rate,
    )
    return added(upload, record, store.clips, ownership, service, principal)


@router.post(
    "/clips",
    status_code=201,
    openapi_extra=_BODY,
    response_model=ClipFileView,
    response_description="The clips can be used",
    responses={
        200: {"model": ClipFileView, "description": "The clips are known already"},
        202: {
            "model": ClipFileView,
            "description": "A worker has yet to validate them; ask again at the Location",
        },
        **refusals(
            BodyTooLarge,
            UnsupportedMediaType,
            TooManyUploads,
            BadClips,
            Rejected,
            QuotaExceeded,
            StorageUnavailable,
            RecordsUnavailable,
        ),
    },
)
async def add_clips(
    record: Annotated[ClipFile, Depends(_added)],
    service: ServiceDep,
    principal: PrincipalDep,
    response: Response,
) -> ClipFileView:
    """Upload a file of clips, recordings of a body's motion. The same bytes, read so, are the same clips."""
    response.status_code = 200 if record.status == "ready" else 201
    record = await settled(record, service.store.clips, service)
    if record.status == "validating":
        response.status_code = 202
        response.headers["Retry-After"] = "2"
    response.headers["Location"] = f"/clips/{record.id}"
    return (await run_sync(_views, [record], service, principal))[0]


@router.get("/clips", response_model=Listing[ClipFileView], responses=refusals(Rejected, RecordsUnavailable))
def list_clips(
    listed: Annotated[UploadFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Files of clips, the last sent first; with accounts those of your projects."""
    page = page_of(service.store.clips, listed, principal)
    items = _views(page.uploads, service, principal)
    return answer(Listing[ClipFileView](items=items, next=page.next_cursor))


@router.get("/clips/{clips_id}", responses=refusals(ClipsNotFound, RecordsUnavailable))
def read_clips(clips_id: ClipsId, service: ServiceDep, principal: PrincipalDep) -> ClipFileView:
    """What is in a file of clips, or the state of its validation."""
    return _views([library.find(clips_id, service.store.clips)], service, principal)[0]


@router.head("/clips/{clips_id}/file", include_in_schema=False, response_class=Response)
@router.get("/clips/{clips_id}/file", response_class=Response, responses=responses(_ANY, ClipsNotFound))
def read_clips_file(clips_id: ClipsId, service: ServiceDep, request: Request) -> Response:
    """The file as it was sent."""
    record = library.find(clips_id, service.store.clips)
    name = re.sub(r"[^A-Za-z0-9._-]", "_", record.name or "clips")
    key = keys.clip_file_source(record.id)
    sent = Artifact(
        name=name, role="trajectory", media_type=_ANY, size=record.size, sha256=record.sha256, key=key
    )
    return file_response(request, sent, service)


@router.head("/clips/{clips_id}/replay", include_in_schema=False, response_class=Response)
@router.get("/clips/{clips_id}/replay", response_class=Response, responses=responses(_ANY, ClipsNotFound))
def read_clips_replay(clips_id: ClipsId, service: ServiceDep, request: Request) -> Response:
    """The poses of the body in the clips, each an episode: the same file as a job's replay."""
    return file_response(request, _made(clips_id, REPLAY, "replay", _ANY, service), service)


@router.head("/clips/{clips_id}/replay/scene", include_in_schema=False, response_class=Response)
@router.get(
    "/clips/{clips_id}/replay/scene",
    response_class=Response,
    responses=responses("model/gltf-binary", ClipsNotFound),
)
def read_clips_scene(clips_id: ClipsId, service: ServiceDep, request: Request) -> Response:
    """The body as binary glTF."""
    return file_response(request, _made(clips_id, SCENE, "scene", "model/gltf-binary", service), service)


def _made(clips_id: str, name: str, role: ArtifactRole, media_type: str, service: Service) -> Artifact:
    found = library.find(clips_id, service.store.clips).description
    made = None if found is None else found.made.get(name)
    if made is None:
        why = "they are not validated yet" if found is None else found.no_replay or "none was made"
        raise ArtifactNotFound(f"The clips {clips_id} have no {role}: {why}", clips=clips_id)
    key = keys.made_of_clips(clips_id, name)
    return Artifact(name=name, role=role, media_type=media_type, size=made.size, sha256=made.sha256, key=key)


@router.patch(
    "/clips/{clips_id}",
    response_model=ClipFileView,
    openapi_extra=patch_of(_PATCH),
    response_description="The clips as they are now",
    responses=refusals(
        MalformedBody, ClipsNotFound, BodyTooLarge, UnsupportedMediaType, Rejected, RecordsUnavailable
    ),
)
def change_clips(
    clips_id: ClipsId, body: PatchBody, service: ServiceDep, principal: PrincipalDep
) -> ClipFileView:
    """Give a file of clips another name, by a JSON merge patch (RFC 7396)."""
    clips = service.store.clips
    record = library.find(clips_id, clips)
    name = parse(body, _PATCH).name
    if not library.may_rename(record.id, principal, clips):
        raise Forbidden("Others have these clips, too, and there is one name for all: ask an admin.")
    clips.rename(record.id, name)
    return _views([record.model_copy(update={"name": name})], service, principal)[0]


@router.delete(
    "/clips/{clips_id}",
    status_code=204,
    responses=refusals(ClipsNotFound, ClipsInUse, StorageUnavailable, RecordsUnavailable),
)
def delete_clips(clips_id: ClipsId, service: ServiceDep, principal: PrincipalDep) -> None:
    """Delete a file of clips that no unfinished job needs; other projects to which it was sent keep it."""
    clips = service.store.clips
    library.find(clips_id, clips)
    projects = own_projects(clips_id, clips, principal)
    remove_upload(clips_id, clips, projects, objects=service.objects)
