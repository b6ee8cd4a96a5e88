"""Errors as problem details (RFC 9457): the status comes from the family, the sentence from the error."""

from collections.abc import Iterable
from http import HTTPMethod
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from pydantic_core import to_json
from starlette.exceptions import HTTPException
from starlette.routing import Match

from api.errors import EdgeError, MethodNotAllowed, RouteNotFound
from api.sentences import parameter_problems
from core.errors import (
    ArtifactNotReady,
    Conflict,
    GaitwayError,
    JobFailed,
    NotFound,
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
