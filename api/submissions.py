"""Reads a submission: checks its media type, length, JSON and shape."""

import hashlib
import json
from collections.abc import AsyncIterator
from typing import Annotated, TypeVar

from fastapi import Depends, Header, Request
from pydantic import TypeAdapter, ValidationError
from pydantic_core import from_json

from api.dependencies import ServiceDep
from api.errors import BodyTooLarge, MalformedBody, UnsupportedMediaType
from api.sentences import body_problems
from core.bounds import check_extent
from core.documents import Strict
from core.errors import Problem, Rejected
from core.jobs.spec import JOB_SPEC, JobSpec
from core.jobs.store import Idempotency
from core.sweeps.spec import SWEEP_SPEC, Budget, SweepSpec

Document = TypeVar("Document")


class Resumption(Strict):
    """The budget under which a sweep continues; it replaces the one before, and counts all trials."""

    budget: Budget


RESUMPTION: TypeAdapter[Resumption] = TypeAdapter(Resumption)

# A client does not read the answer while it is still sending, so this much excess is read and discarded.
_DRAINED_BYTES = 16 * 2**20
_LONGEST_KEY = 255
EXAMPLE_KEY = "7d1f0c7a-first-try"


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
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != "application/json":
        raise UnsupportedMediaType(media_type)
    return await read_body(request, service.settings.max_body_bytes)


JsonBody = Annotated[bytes, Depends(_json_body)]


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


def idempotency(key: str | None, spec: JobSpec | SweepSpec) -> Idempotency | None:
    """The key with the fingerprint of its submission; None without a key."""
    return None if key is None else Idempotency(key, fingerprint(spec))


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
