"""Users' own models: upload one, see its contents, delete it."""

from collections.abc import Sequence
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import Field

from api.access import PrincipalDep, ownership_of_new
from api.dependencies import Service, ServiceDep
from api.problems import BodyTooLarge, TooManyUploads, UnsupportedMediaType, refusals
from api.submissions import Upload, with_end
from api.uploads import SentUpload, UploadFilters, added, own_projects, page_of, received, settled, shown
from api.views import Listing, answer
from core.accounts.principal import Ownership, Principal
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
from core.uploads import library
from core.user_models.record import ModelRecord
from gaitway.schema import ModelView

router = APIRouter(tags=["models"])

XML, ZIP = "application/xml", "application/zip"
_ZIP_BEGINNING = b"PK\x03\x04"
_KNOWN = {XML: XML, "text/xml": XML, ZIP: ZIP, "application/x-zip-compressed": ZIP}
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


class Sent(SentUpload):
    """The parameters that come with the file."""

    main: str | None = Field(
        None,
        min_length=1,
        max_length=MAX_MAIN_CHARACTERS,
        description="Of a zip: the document that is the model, by its path or the end of it. By default the "
        "one that no other includes, or the least deep one called scene or model. It is part of the model: "
        "another one makes another id.",
    )


def _views(records: Sequence[ModelRecord], service: Service, principal: Principal) -> list[ModelView]:
    return [_view(record, whose) for record, whose in shown(records, service.store.models, principal)]


def _view(record: ModelRecord, whose: Ownership) -> ModelView:
    contents = None if record.description is None else record.description.model_dump(mode="json")
    facts = record.model_dump(exclude={"description", "refused_at"})
    return ModelView(
        **facts,
        description=contents,
        owner=whose.owner,
        project=whose.project,
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
    models = service.store.models
    async with received(request, models, service.settings.max_model_bytes, service) as upload:
        is_zip = upload.beginning.startswith(_ZIP_BEGINNING)
        if (media_type == ZIP) != is_zip:
            raise BadModel(f"The file is {'a' if is_zip else 'not a'} zip, but was sent as {media_type}.")
        return await run_sync(_add, upload, media_type, sent, ownership, service, principal)


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
            TooManyUploads,
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
    # Finding out which engines can run it takes several seconds more: a later request returns that.
    record = await settled(record, service.store.models, service)
    if record.status == "validating":
        response.status_code = 202
    if not record.is_settled:
        response.headers["Retry-After"] = "2"
    response.headers["Location"] = f"/models/{record.id}"
    return (await run_sync(_views, [record], service, principal))[0]


@router.get("/models", response_model=Listing[ModelView], responses=refusals(Rejected, RecordsUnavailable))
def list_models(
    listed: Annotated[UploadFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Models, the last sent first; with accounts those of your projects."""
    page = page_of(service.store.models, listed, principal)
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
    models = service.store.models
    library.find(model_id, models)
    projects = own_projects(model_id, models, principal)
    remove_upload(model_id, models, projects, objects=service.objects)


def _add(
    upload: Upload, media_type: str, sent: Sent, ownership: Ownership, service: Service, principal: Principal
) -> ModelRecord:
    store, main = service.store, sent.main
    if main is not None:
        named = with_end(upload, lambda end: with_main(end, main))
        if named is None:
            raise BadModel("The zip cannot be read: it has no directory at its end.")
        upload = named
    record = ModelRecord(
        id=f"sha256:{upload.sha256}",
        name=sent.name,
        status="validating",
        media_type=media_type,
        size=upload.size,
        created_at=store.now(),
    )
    return added(upload, record, store.models, ownership, service, principal)
