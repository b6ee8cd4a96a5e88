"""Reads what a request sends: a submission, an uploaded file, an environment's options.

A submission's media type, length, JSON and shape are checked. An uploaded file is hashed and written to disk
as it arrives, but not parsed.
"""

import hashlib
import json
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Annotated, Any, TypeVar

from anyio import fail_after
from fastapi import Depends, Header, Request
from pydantic import JsonValue, TypeAdapter, ValidationError
from pydantic_core import from_json

from api.dependencies import Service, ServiceDep
from api.problems import BodyTooLarge, MalformedBody, UnsupportedMediaType
from api.sentences import body_problems
from core.accounts.principal import Principal
from core.bounds import check_extent
from core.documents import Strict
from core.environments import catalog
from core.environments.info import EnvironmentInfo
from core.errors import Problem, Rejected, StorageUnavailable
from core.jobs.resolved import resolve_environment
from core.jobs.spec import JOB_SPEC, EnvironmentSpec, JobSpec
from core.jobs.store import Idempotency
from core.jobs.submission import check_readable_uploads
from core.jobs.uploads import Uploads
from core.sweeps.spec import SWEEP_SPEC, Budget, SweepSpec

Document = TypeVar("Document")
# A client does not read the answer while it is still sending, so this much excess is read and discarded.
_DRAINED_BYTES = 16 * 2**20
_LONGEST_KEY = 255
MERGE_PATCH = "application/merge-patch+json"
EXAMPLE_KEY = "7d1f0c7a-first-try"
EXAMPLES = {
    "the smallest job": {"value": {"kind": "train", "environment": "ant"}},
    "a training run": {
        "value": {
            "kind": "train",
            "name": "first steps",
            "labels": {"project": "gaits"},
            "environment": {"id": "ant", "options": {"healthy_reward": 0.5}},
            "algorithm": {"kind": "ppo", "num_timesteps": 3_000_000, "num_envs": 256, "learning_rate": 6e-4},
            "physics": "auto",
            "seed": 0,
            "checkpoints": {"every_steps": 500_000, "keep": 5},
            "video": {"camera": "track", "width": 640, "height": 480, "fps": 30, "seconds": 10.0},
        }
    },
    "a rollout of its policy": {
        "value": {
            "kind": "rollout",
            "environment": "ant",
            "policy": {"kind": "checkpoint", "job": "019aa3c2f0b1-5be0c1d2e3"},
            "num_steps": 1000,
        }
    },
    "a rollout of random actions": {
        "value": {"kind": "rollout", "environment": "ant", "policy": {"kind": "random"}, "num_episodes": 3}
    },
}
_BEGINNING = 8
# The end of a zip's directory with the longest comment.
_END = 22 + 2**16 - 1
# A machine that sleeps in the middle of its upload closes no connection.
_LONGEST_PAUSE_S = 60.0
# After the first minute: an upload holds one of few places.
_SLOWEST_BYTES_PER_S = 2**16
OPTIONS_DESCRIPTION = "The environment's options, as a JSON object."
# A character takes up to 12 in an address, and the server takes addresses of 64 KiB.
MAX_OPTIONS_LENGTH = 5_000
_OPTIONS: TypeAdapter[dict[str, JsonValue]] = TypeAdapter(dict[str, JsonValue])


class Resumption(Strict):
    """The budget under which a sweep continues; it replaces the one before, and counts all trials."""

    budget: Budget


RESUMPTION: TypeAdapter[Resumption] = TypeAdapter(Resumption)


def body_of(kind: TypeAdapter[Any], *media_types: str) -> dict[str, Any]:
    """A route's body as OpenAPI says it, for `openapi_extra`; by default of JSON alone.

    `api.openapi` makes components of its `$defs`.
    """
    schema = kind.json_schema(ref_template="#/components/schemas/{model}")
    content = {media_type: {"schema": schema} for media_type in media_types or ("application/json",)}
    return {"requestBody": {"required": True, "content": content}}


def patch_of(kind: TypeAdapter[Any]) -> dict[str, Any]:
    """`body_of` a JSON merge patch (RFC 7396)."""
    return body_of(kind, MERGE_PATCH, "application/json")


def parse(body: bytes, kind: TypeAdapter[Document]) -> Document:
    """The document in a body. Raises MalformedBody, and Rejected with the fields that are wrong.

    For a thread: a large body takes some tenths of a second.
    """
    try:
        said = from_json(body)
    except ValueError as error:
        raise MalformedBody(str(error)) from None
    check_extent(said)
    try:
        return kind.validate_json(body)
    except ValidationError as error:
        problems = body_problems(error.errors(include_url=False), said, kind)
    raise Rejected(" ".join(problem.detail for problem in problems[:5]), problems)


def fingerprint(spec: JobSpec | SweepSpec) -> str:
    """Equal for bodies with the same content, regardless of spacing and order."""
    said = spec.model_dump(mode="json", exclude_unset=True)
    kind = "sweep" if isinstance(spec, SweepSpec) else spec.kind
    return hashlib.sha256(json.dumps([kind, said], sort_keys=True).encode()).hexdigest()


async def read_body(request: Request, limit: int) -> bytes:
    """The whole body. Raises BodyTooLarge."""
    return b"".join([piece async for piece in pieces_of(request, limit)])


async def pieces_of(request: Request, limit: int) -> AsyncIterator[bytes]:
    """The body in pieces, as they arrive. Raises BodyTooLarge where it is longer than the limit."""
    announced = request.headers.get("content-length", "0")
    if announced.isdecimal() and int(announced) > limit + _DRAINED_BYTES:
        raise BodyTooLarge(limit)
    size = 0
    async for piece in request.stream():
        size += len(piece)
        if size <= limit:
            yield piece
        elif size > limit + _DRAINED_BYTES:
            break
    if size > limit:
        raise BodyTooLarge(limit)


async def _json_body(request: Request, service: ServiceDep) -> bytes:
    return await _json_of(request, service, "application/json")


async def _patch_body(request: Request, service: ServiceDep) -> bytes:
    return await _json_of(request, service, MERGE_PATCH, "application/json")


async def _json_of(request: Request, service: Service, *accepted: str) -> bytes:
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() not in accepted:
        raise UnsupportedMediaType(media_type, what="the document", accepted=accepted)
    return await read_body(request, service.settings.max_body_bytes)


JsonBody = Annotated[bytes, Depends(_json_body)]
PatchBody = Annotated[bytes, Depends(_patch_body)]


# Not asynchronous: these run in threads.
def _submitted(body: JsonBody) -> JobSpec:
    return parse(body, JOB_SPEC)


def _submitted_sweep(body: JsonBody) -> SweepSpec:
    return parse(body, SWEEP_SPEC)


async def _idempotency_key(
    key: Annotated[
        str | None,
        Header(
            alias="Idempotency-Key",
            description="1 to 255 printable ASCII characters. The same key with the same body creates one "
            "job, however often it is sent within 24 hours.",
            examples=[EXAMPLE_KEY],
            json_schema_extra={"pattern": f"^[ -~]{{1,{_LONGEST_KEY}}}$"},
        ),
    ] = None,
) -> str | None:
    if key is None:
        return None
    if not 1 <= len(key) <= _LONGEST_KEY or not (key.isascii() and key.isprintable()):
        detail = f"The Idempotency-Key must be 1 to {_LONGEST_KEY} printable ASCII characters."
        raise Rejected(detail, [Problem("/Idempotency-Key", detail)])
    return key


Submitted = Annotated[JobSpec, Depends(_submitted)]
SubmittedSweep = Annotated[SweepSpec, Depends(_submitted_sweep)]
IdempotencyKey = Annotated[str | None, Depends(_idempotency_key)]


def idempotency(key: str | None, spec: JobSpec | SweepSpec, principal: Principal) -> Idempotency | None:
    """The key with the fingerprint of its submission; None without a key."""
    return None if key is None else Idempotency(key, fingerprint(spec), principal.user)


@dataclass(frozen=True)
class Upload:
    """path: exists until the request ends. beginning: the first bytes."""

    path: Path
    sha256: str
    size: int
    beginning: bytes


@asynccontextmanager
async def receiving(request: Request, limit: int) -> AsyncGenerator[Upload]:
    """The whole body in a file.

    Raises BodyTooLarge; Rejected where it stops coming or comes too slowly; StorageUnavailable where this
    machine has no room.
    """
    digest, size, beginning = hashlib.sha256(), 0, b""
    with NamedTemporaryFile(prefix="gaitway-upload-") as file:
        try:
            began = time.monotonic()
            async for piece in _without_pauses(pieces_of(request, limit)):
                _check_pace(size, time.monotonic() - began)
                file.write(piece)
                digest.update(piece)
                size += len(piece)
                beginning = (beginning + piece)[:_BEGINNING]
            file.flush()
        except OSError as error:
            raise StorageUnavailable(f"The API has no room for the upload: {error.strerror}.") from error
        yield Upload(Path(file.name), digest.hexdigest(), size, beginning)


async def _without_pauses(pieces: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    while True:
        try:
            with fail_after(_LONGEST_PAUSE_S):
                piece = await anext(pieces, None)
        except TimeoutError:
            raise Rejected(f"The body of the request stopped coming for {_LONGEST_PAUSE_S:.0f} s.") from None
        if piece is None:
            return
        yield piece


def _check_pace(size: int, seconds: float) -> None:
    """Raises Rejected. size: bytes that have come until now."""
    if seconds > _LONGEST_PAUSE_S + size / _SLOWEST_BYTES_PER_S:
        raise Rejected(
            f"The body of the request came too slowly: {size:,} bytes in {seconds:.0f} s. After the first "
            f"{_LONGEST_PAUSE_S:.0f} s it may take a second for each {_SLOWEST_BYTES_PER_S:,} bytes."
        )


def with_end(upload: Upload, changed: Callable[[bytes], bytes | None]) -> Upload | None:
    """The upload with another end, in its own file; None if `changed` makes none of the last bytes."""
    with upload.path.open("r+b") as file:
        file.seek(max(0, upload.size - _END))
        at, end = file.tell(), changed(file.read())
        if end is None:
            return None
        file.seek(at)
        file.truncate()
        file.write(end)
        file.seek(0)
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return replace(upload, sha256=sha256, size=at + len(end))


def parse_options(text: str) -> dict[str, JsonValue]:
    """Raises Rejected unless the text is a JSON object."""
    try:
        return _OPTIONS.validate_json(text)
    except ValidationError:
        detail = "`options` is not a JSON object."
        raise Rejected(detail, [Problem("/options", detail)]) from None


def in_the_query(refusal: Rejected) -> Rejected:
    """A job's refusal with its pointers turned into names of query parameters."""
    problems = [
        Problem(problem.pointer.removeprefix("/environment").removeprefix("/video"), problem.detail)
        for problem in refusal.problems
    ]
    return Rejected(refusal.detail, problems, **refusal.facts)


def info_under(
    environment_id: str, options: str | None, store: Uploads, principal: Principal
) -> EnvironmentInfo:
    """The environment's row of the catalog under these options; without any, the row itself.

    Raises EnvironmentNotFound, and Rejected with the same messages as for a job.
    """
    info = catalog.find(environment_id)
    if options is None:
        return info
    environment = EnvironmentSpec(id=environment_id, options=parse_options(options))
    try:
        check_readable_uploads(environment, principal.readable, store)
        return resolve_environment(environment, store)[0]
    except Rejected as refusal:
        raise in_the_query(refusal) from None
