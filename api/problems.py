"""Errors as problem details (RFC 9457): the status comes from the family, the sentence from the error.

Refusals that exist only in HTTP have their own status.
"""

from collections.abc import Iterable, Sequence
from http import HTTPMethod
from typing import Any, ClassVar

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from pydantic_core import to_json
from starlette.exceptions import HTTPException
from starlette.routing import Match

from api.sentences import parameter_problems
from core.errors import (
    ArtifactNotReady,
    Conflict,
    GaitwayError,
    JobFailed,
    NotFound,
    Problem,
    Rejected,
    TooManySweeps,
    Unavailable,
)

MEDIA_TYPE = "application/problem+json"
_FAMILIES: dict[type[GaitwayError], int] = {
    NotFound: 404,
    Conflict: 409,
    TooManySweeps: 429,
    Rejected: 422,
    Unavailable: 503,
    JobFailed: 500,  # Raised inside a training process; it never reaches the edge.
    GaitwayError: 500,
}


class EdgeError(GaitwayError):
    """A refusal of how a request was made."""

    status: ClassVar[int] = 400
    code = "bad-request"
    title = "Bad request"

    @property
    def headers(self) -> dict[str, str]:
        """The headers of the answer."""
        return {}


class RouteNotFound(EdgeError):
    """There is no resource at this address; /docs lists all of them."""

    status = 404
    code = "route-not-found"
    title = "Nothing at this address"


class MethodNotAllowed(EdgeError):
    """The resource exists but does not support this method; the header Allow lists those that it supports."""

    status = 405
    code = "method-not-allowed"
    title = "Method not allowed"

    def __init__(self, method: str, allowed: str) -> None:
        super().__init__(f"This address does not support {method}; it supports {allowed}.", allowed=allowed)
        self._allowed = allowed

    @property
    def headers(self) -> dict[str, str]:
        return {"Allow": self._allowed}


class MalformedBody(EdgeError):
    """The body is not a JSON document; `detail` gives the line and column of the error."""

    status = 400
    code = "malformed-body"
    title = "The body is not JSON"

    def __init__(self, why: str) -> None:
        super().__init__(f"The body is not a JSON document: {why}.")
        self.problems = (Problem("", self.detail),)


class BodyTooLarge(EdgeError):
    """The body is longer than this service accepts."""

    status = 413
    code = "body-too-large"
    title = "The body is too large"

    def __init__(self, limit: int) -> None:
        super().__init__(f"The body is longer than {limit:,} bytes.", limit_bytes=limit)

    @property
    def headers(self) -> dict[str, str]:
        return {"Connection": "close"}


class UnsupportedMediaType(EdgeError):
    """Send a job as application/json, a model as application/xml or application/zip, and an export as
    application/zip."""

    status = 415
    code = "unsupported-media-type"
    title = "Unsupported media type"

    def __init__(
        self, media_type: str, *, what: str = "the job", accepted: Sequence[str] = ("application/json",)
    ) -> None:
        sent = f"{media_type[:100]!r}" if media_type else "no Content-Type"
        super().__init__(f"Send {what} as {' or '.join(accepted)}; this request has {sent}.")
        self._accepted = accepted

    @property
    def headers(self) -> dict[str, str]:
        return {"Accept-Post": ", ".join(self._accepted)}


class TooManyUploads(EdgeError):
    """GAITWAY_MAX_WAITING_MODELS models, or as many files of clips, are being uploaded or wait for
    validation. Workers validate them when no job waits."""

    status = 429
    code = "too-many-models"
    title = "Too many models are waiting"

    def __init__(self, most: int) -> None:
        super().__init__(
            f"{most} models or files of clips, the maximum, wait for a worker that has no job and can "
            "validate them; send this one later.",
            most=most,
        )

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "30"}


class TooManyImports(EdgeError):
    """Exports may be of gigabytes, and each waits on the disk of the API until it is imported."""

    status = 429
    code = "too-many-imports"
    title = "Too many exports are being imported"

    def __init__(self, most: int) -> None:
        super().__init__(f"{most} exports, the maximum, are being imported; send this one later.", most=most)

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": "5"}


class RangeNotSatisfiable(EdgeError):
    """The file ends before the range begins; the header Content-Range gives its length."""

    status = 416
    code = "range-not-satisfiable"
    title = "The range lies outside the file"

    def __init__(self, size: int) -> None:
        super().__init__(f"The range begins after the end of the file, which has {size:,} bytes.", size=size)
        self._size = size

    @property
    def headers(self) -> dict[str, str]:
        return {"Content-Range": f"bytes */{self._size}"}


class UnknownHost(EdgeError):
    """The request's Host is not a name of this service: a page of another site may have pointed its own name
    to this address. GAITWAY_ALLOWED_HOSTS lists further names."""

    status = 421
    code = "unknown-host"
    title = "Unknown host"

    def __init__(self, host: str) -> None:
        super().__init__(
            f"This service does not answer as {host[:100]!r}. If that is its name, add it to "
            "GAITWAY_ALLOWED_HOSTS where it is started."
        )


class CrossSiteRequest(EdgeError):
    """A page of another site sent this request through a browser."""

    status = 403
    code = "cross-site-request"
    title = "Cross-site request"


class UnexpectedError(EdgeError):
    """A defect of the service. Its log has the details under the same correlation id."""

    status = 500
    code = "unexpected-error"
    title = "The service failed"

    def __init__(self, correlation_id: str) -> None:
        super().__init__(
            "The service failed on this request; its log has the reason under this correlation id.",
            correlation_id=correlation_id,
        )


class ErrorView(BaseModel):
    """One offending place: a JSON pointer into the body, or `/` and a parameter's or header's name."""

    pointer: str = Field(examples=["/algorithm/learning_rate"])
    detail: str


class ProblemView(BaseModel):
    """The reason of a refusal (RFC 9457). Each type adds facts of its own as further members."""

    type: str = Field(
        examples=["/problems/invalid-request"], description="Stable; the path of a page that explains it."
    )
    title: str
    status: int
    detail: str = Field(description="A sentence for people.")
    instance: str = Field(description="The path of the request.")
    errors: list[ErrorView] | None = None


def status_of(error: type[GaitwayError]) -> int:
    """The HTTP status of an error class: an EdgeError's own, otherwise that of its family."""
    if issubclass(error, EdgeError):
        return error.status
    return next(_FAMILIES[ancestor] for ancestor in error.__mro__ if ancestor in _FAMILIES)


def classes_of_errors() -> Iterable[type[GaitwayError]]:
    """Every error class, families included."""
    waiting: list[type[GaitwayError]] = [GaitwayError]
    while waiting:
        found = waiting.pop()
        yield found
        waiting += found.__subclasses__()


def problem(error: GaitwayError, instance: str) -> dict[str, Any]:
    """The problem document of an error. instance: the path of the request."""
    document: dict[str, Any] = {
        **error.facts,
        "type": f"/problems/{error.code}",
        "title": error.title,
        "status": status_of(type(error)),
        "detail": error.detail,
        "instance": instance,
    }
    places = getattr(error, "problems", ())
    if places:
        document["errors"] = [{"pointer": place.pointer, "detail": place.detail} for place in places]
    return document


def answer(error: GaitwayError, instance: str) -> Response:
    """The whole answer: document, status and headers."""
    headers = dict(error.headers) if isinstance(error, EdgeError) else {}
    if isinstance(error, Unavailable | ArtifactNotReady):
        headers["Retry-After"] = str(error.retry_after_s)
    body = to_json(problem(error, instance), inf_nan_mode="null", fallback=str)
    return Response(body, status_of(type(error)), headers, media_type=MEDIA_TYPE)


def refusals(*errors: type[GaitwayError]) -> dict[int | str, dict[str, Any]]:
    """For a route's `responses`: these refusals, with an example of each."""
    documented: dict[int | str, dict[str, Any]] = {}
    for error in errors:
        status = status_of(error)
        response = documented.setdefault(
            status,
            {
                "description": "",
                "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "examples": {}}},
            },
        )
        response["description"] = ", or ".join(filter(None, [response["description"], error.title]))
        response["content"][MEDIA_TYPE]["examples"][error.code] = {
            "value": {
                "type": f"/problems/{error.code}",
                "title": error.title,
                "status": status,
                "detail": "A sentence that says what to do.",
                "instance": "/jobs",
            },
        }
    return documented


def install(app: FastAPI) -> None:
    """Answer every refusal as a problem."""
    app.add_exception_handler(GaitwayError, _refused)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _from_the_framework)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, GaitwayError)  # noqa: S101
    return answer(error, request.url.path)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    problems = parameter_problems(error.errors())
    return answer(Rejected(" ".join(p.detail for p in problems), problems), request.url.path)


async def _from_the_framework(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101
    if error.status_code == 405:
        return answer(MethodNotAllowed(request.method, ", ".join(_allowed(request))), request.url.path)
    if error.status_code == 404:
        return answer(RouteNotFound(f"There is nothing at {request.url.path[:200]!r}."), request.url.path)
    raise error


def _allowed(request: Request) -> list[str]:
    """The methods of all routes at this address, which each are asked; the framework asks only the first."""
    return [
        method
        for method in HTTPMethod
        if any(
            route.matches({**request.scope, "method": method})[0] is Match.FULL
            for route in request.app.routes
        )
    ]
