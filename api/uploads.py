"""What the routes of users' models and of clips have in common."""

import time
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Annotated, Any

from anyio import sleep
from anyio.to_thread import run_sync
from fastapi import Request
from pydantic import Field

from api.access import whose
from api.dependencies import QueryParameters, Service
from api.problems import TooManyUploads
from api.submissions import Upload, receiving
from core.accounts.principal import AccountName, Ownership, Principal
from core.jobs.quotas import check_bytes
from core.jobs.spec import Text
from core.uploads import library
from core.uploads.record import Record, UploadPage, UploadStore

# How long a request waits for the validation before it is answered 202.
_TIMEOUT_S = 5.0
_POLL_S = 0.1

# A name for people. It has no line breaks or other characters that a terminal would act on.
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]


class SentUpload(QueryParameters):
    """The parameters that come with any file."""

    name: Name | None = Field(None, description="What people call it; several may have the same name.")
    project: AccountName | None = Field(
        None, description="Whose members may use it; with one project of your own you need not say it."
    )


class UploadFilters(QueryParameters):
    """A part of the listing."""

    # The pattern documents; the store's own check gives a better message.
    cursor: str | None = Field(
        None,
        max_length=100,
        description="The `next` of an earlier page.",
        json_schema_extra={"pattern": "^[0-9]{1,17}-sha256:[0-9a-f]{64}$"},
    )
    limit: int = Field(50, ge=1, le=200)
    name: Name | None = Field(None, description="Only those of this name.")
    owner: Text | None = Field(None, description="A user's name.", examples=[None])
    project: Text | None = Field(None, description="One of your projects.", examples=[None])


def page_of(uploads: UploadStore[Record], listed: UploadFilters, principal: Principal) -> UploadPage[Record]:
    """The part of the listing that is asked for, of what the principal may see. Raises Rejected."""
    asked = whose(principal, listed.owner, listed.project)
    return uploads.list(
        cursor=listed.cursor,
        limit=listed.limit,
        name=listed.name,
        projects=asked.projects,
        owner=asked.owner,
    )


@asynccontextmanager
async def received(
    request: Request, store: UploadStore[Any], most_bytes: int, service: Service
) -> AsyncGenerator[Upload]:
    """The file of a request. Raises TooManyUploads where too many wait for validation, BodyTooLarge."""
    most = service.settings.max_waiting_models
    if await run_sync(store.num_waiting) + service.num_uploads >= most:
        raise TooManyUploads(most)
    service.num_uploads += 1
    try:
        async with receiving(request, most_bytes) as upload:
            yield upload
    finally:
        service.num_uploads -= 1


def added(
    upload: Upload,
    record: Record,
    store: UploadStore[Record],
    ownership: Ownership,
    service: Service,
    principal: Principal,
) -> Record:
    """The record of the file, in the project. Raises QuotaExceeded, StorageUnavailable."""
    owners = store.owners_of([record.id]).get(record.id, ())
    if ownership.project not in {one.project for one in owners}:
        check_bytes(ownership, service.store, upload.size)
    return library.add(
        upload.path,
        record,
        store=store,
        objects=service.objects,
        queue=service.queue,
        sender=principal,
        ownership=ownership,
    )


async def settled(record: Record, store: UploadStore[Record], service: Service) -> Record:
    """The record once a worker has accepted the file, or as it is after `_TIMEOUT_S`.

    Raises the kind's `unusable` where it was refused; nothing is left of it then.
    """
    until = time.monotonic() + _TIMEOUT_S
    while record.status == "validating" and time.monotonic() < until and not service.stopping:
        await sleep(_POLL_S)
        record = await run_sync(library.find, record.id, store)
    if record.status == "refused":
        raise await run_sync(_refused, record, store, service)
    return record


def _refused(record: Record, store: UploadStore[Record], service: Service) -> Exception:
    return library.refused(record, store=store, objects=service.objects)


def shown(
    records: Sequence[Record], store: UploadStore[Record], principal: Principal
) -> Sequence[tuple[Record, Ownership]]:
    """Each with one of the projects that have it and that the principal sees, where they own it if any."""
    owners = store.owners_of([record.id for record in records])
    return [(record, _shown(owners, record.id, principal)) for record in records]


def _shown(owners: Mapping[str, Sequence[Ownership]], upload_id: str, principal: Principal) -> Ownership:
    seen = [one for one in owners.get(upload_id, ()) if principal.sees(one.project)]
    return min(seen, key=lambda one: one.owner != principal.user, default=Ownership())


def own_projects(upload_id: str, store: UploadStore[Any], principal: Principal) -> Sequence[str]:
    """The projects in which the principal may take the file away."""
    owners = store.owners_of([upload_id]).get(upload_id, ())
    return [one.project for one in owners if principal.may_change(one.owner) and principal.sees(one.project)]
