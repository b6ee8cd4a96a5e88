"""Users' own models: upload one, see its contents, delete it."""

import time
from collections.abc import Sequence
from typing import Annotated, Any

from anyio import sleep
from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field

from api.access import PrincipalDep, ownership_of_new, whose
from api.dependencies import QueryParameters, Service, ServiceDep
from api.problems import BodyTooLarge, TooManyModels, UnsupportedMediaType, refusals
from api.submissions import Upload, receiving, with_end
from api.views import Listing, answer
from core.accounts.principal import AccountName, Ownership, Principal
from core.environments.mjcf.main_document import MAX_MAIN_CHARACTERS, with_main
from core.errors import (
    BadModel,
    ModelInUse,
    ModelNotFound,
    Problem,
    QuotaExceeded,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.ending import remove_upload
from core.jobs.quotas import check_bytes
from core.jobs.spec import Text
from core.uploads import library
from core.user_models.record import ModelRecord
from gaitway.schema import ModelView

router = APIRouter(tags=["models"])

XML, ZIP = "application/xml", "application/zip"
_ZIP_BEGINNING = b"PK\x03\x04"
_KNOWN = {XML: XML, "text/xml": XML, ZIP: ZIP, "application/x-zip-compressed": ZIP}
# How long a request waits for the validation before it is answered 202.
_TIMEOUT_S = 5.0
_POLL_S = 0.1
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            XML: {"schema": {"type": "string", "description": "MJCF or URDF that refers to no other file."}},
            ZIP: {
                "schema": {
                    "type": "string",
                    "format": "binary",
                    "description": "MJCF or URDF with its meshes and textures.",
                }
            },
        },
    }
}
# The pattern documents; another id is one that nobody has.
ModelId = Annotated[
    str,
    Path(
        description="The id that `POST /models` returned.",
        examples=[f"sha256:{'0' * 64}"],
        json_schema_extra={"pattern": "^sha256:[0-9a-f]{64}$"},
    ),
]


# A model's name for people. It has no line breaks or other characters that a terminal would act on.
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]


class Sent(QueryParameters):
    """The parameters that come with the file."""

    name: Name | None = Field(None, description="What people call it; several models may have the same name.")
    project: AccountName | None = Field(
        None, description="Whose members may use it; with one project of your own you need not say it."
    )
    main: str | None = Field(
        None,
        min_length=1,
        max_length=MAX_MAIN_CHARACTERS,
        description="Of a zip: the document that is the model, by its path or the end of it. By default the "
        "one that no other includes, or the least deep one called scene or model. It is part of the model: "
        "another one makes another id.",
    )


class ModelFilters(QueryParameters):
    """A part of the listing."""

    # The pattern documents; the store's own check gives a better message.
    cursor: str | None = Field(
        None,
        max_length=100,
        description="The `next` of an earlier page.",
        json_schema_extra={"pattern": "^[0-9]{1,17}-sha256:[0-9a-f]{64}$"},
    )
    limit: int = Field(50, ge=1, le=200)
    name: Name | None = Field(None, description="Only models of this name.")
    owner: Text | None = Field(None, description="A user's name.", examples=[None])
    project: Text | None = Field(None, description="One of your projects.", examples=[None])


def _views(records: Sequence[ModelRecord], service: Service, principal: Principal) -> list[ModelView]:
    """Each with one of the projects that have it and that the principal sees, where they own it if any."""
    owners = service.store.models.owners_of([record.id for record in records])
    return [_view(record, owners.get(record.id, ()), principal) for record in records]


def _view(record: ModelRecord, owners: Sequence[Ownership], principal: Principal) -> ModelView:
    seen = [one for one in owners if principal.sees(one.project)]
    shown = min(seen, key=lambda one: one.owner != principal.user, default=Ownership())
    contents = None if record.description is None else record.description.model_dump(mode="json")
    facts = record.model_dump(exclude={"description", "refused_at"})
    return ModelView(
        **facts,
        description=contents,
        owner=shown.owner,
        project=shown.project,
        links={"self": f"/models/{record.id}"},
    )


async def _added(
    request: Request, sent: Annotated[Sent, Query()], service: ServiceDep, principal: PrincipalDep
) -> ModelRecord:
    said = request.headers.get("content-type", "")
    media_type = _KNOWN.get(said.partition(";")[0].strip().lower())
    if media_type is None:
        raise UnsupportedMediaType(said, what="a model", accepted=(XML, ZIP))
    if sent.main is not None and media_type != ZIP:
        detail = "`main` names a document of a zip, but the file is a single one: leave it out."
        raise Rejected(detail, [Problem("/main", detail)])
    ownership = await run_sync(ownership_of_new, principal, sent.project, service)
    most = service.settings.max_waiting_models
    if await run_sync(service.store.models.num_waiting) + service.num_uploads >= most:
        raise TooManyModels(most)
    service.num_uploads += 1
    try:
        async with receiving(request, service.settings.max_model_bytes) as upload:
            is_zip = upload.beginning.startswith(_ZIP_BEGINNING)
            if (media_type == ZIP) != is_zip:
                raise BadModel(f"The file is {'a' if is_zip else 'not a'} zip, but was sent as {media_type}.")
            return await run_sync(_add, upload, media_type, sent, ownership, service, principal)
    finally:
        service.num_uploads -= 1


@router.post(
    "/models",
    status_code=201,
    openapi_extra=_BODY,
    response_model=ModelView,
    response_description="The model can be used",
    responses={
        200: {"model": ModelView, "description": "The model is known already"},
        202: {
            "model": ModelView,
            "description": "A worker has yet to validate it; ask again at the Location",
        },
        **refusals(
            BodyTooLarge,
            UnsupportedMediaType,
            TooManyModels,
            BadModel,
            Rejected,
            QuotaExceeded,
            StorageUnavailable,
            RecordsUnavailable,
        ),
    },
)
async def add_model(
    record: Annotated[ModelRecord, Depends(_added)],
    service: ServiceDep,
    principal: PrincipalDep,
    response: Response,
) -> ModelView:
    """Upload a model of your own, as MJCF or URDF. The same bytes are the same model."""
    response.status_code = 200 if record.status == "ready" else 201
    record = await _settled(record, service)
    if record.status == "refused":
        raise await run_sync(_refused, record, service)
    if record.status == "validating":
        response.status_code = 202
    if not record.is_settled:
        response.headers["Retry-After"] = "2"
    response.headers["Location"] = f"/models/{record.id}"
    return (await run_sync(_views, [record], service, principal))[0]


@router.get("/models", response_model=Listing[ModelView], responses=refusals(Rejected, RecordsUnavailable))
def list_models(
    listed: Annotated[ModelFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Models, the last sent first; with accounts those of your projects."""
    asked = whose(principal, listed.owner, listed.project)
    page = service.store.models.list(
        cursor=listed.cursor,
        limit=listed.limit,
        name=listed.name,
        projects=asked.projects,
        owner=asked.owner,
    )
    items = _views(page.uploads, service, principal)
    return answer(Listing[ModelView](items=items, next=page.next_cursor))


@router.get("/models/{model_id}", responses=refusals(ModelNotFound, RecordsUnavailable))
def read_model(model_id: ModelId, service: ServiceDep, principal: PrincipalDep) -> ModelView:
    """A model's contents, or the state of its validation."""
    return _views([library.find(model_id, service.store.models)], service, principal)[0]


@router.delete(
    "/models/{model_id}",
    status_code=204,
    responses=refusals(ModelNotFound, ModelInUse, StorageUnavailable, RecordsUnavailable),
)
def delete_model(model_id: ModelId, service: ServiceDep, principal: PrincipalDep) -> None:
    """Delete a model that no unfinished job needs; other projects to which it was sent, too, keep it."""
    record = library.find(model_id, service.store.models)
    owners = service.store.models.owners_of([record.id]).get(record.id, ())
    projects = [
        one.project for one in owners if principal.may_change(one.owner) and principal.sees(one.project)
    ]
    remove_upload(model_id, service.store.models, projects, store=service.store, objects=service.objects)


def _add(
    upload: Upload, media_type: str, sent: Sent, ownership: Ownership, service: Service, principal: Principal
) -> ModelRecord:
    store, main = service.store, sent.main
    if main is not None:
        named = with_end(upload, lambda end: with_main(end, main))
        if named is None:
            raise BadModel("The zip cannot be read: it has no directory at its end.")
        upload = named
    model_id = f"sha256:{upload.sha256}"
    owners = store.models.owners_of([model_id]).get(model_id, ())
    if ownership.project not in {one.project for one in owners}:
        check_bytes(ownership, store, upload.size)
    return library.add(
        upload.path,
        ModelRecord(
            id=model_id,
            name=sent.name,
            status="validating",
            media_type=media_type,
            size=upload.size,
            created_at=store.now(),
        ),
        store=store.models,
        objects=service.objects,
        queue=service.queue,
        sender=principal,
        ownership=ownership,
    )


def _refused(record: ModelRecord, service: Service) -> Rejected:
    return library.refused(record, store=service.store.models, objects=service.objects)


async def _settled(record: ModelRecord, service: Service) -> ModelRecord:
    """The record once a worker has accepted or refused the model, or as it is after `_TIMEOUT_S`.

    Finding out which engines can run the model takes several seconds more: a later request returns that.
    """
    until = time.monotonic() + _TIMEOUT_S
    while record.status == "validating" and time.monotonic() < until and not service.stopping:
        await sleep(_POLL_S)
        record = await run_sync(library.find, record.id, service.store.models)
    return record
