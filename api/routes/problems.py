"""The pages that a problem's `type` points to."""

import html
import inspect
from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import HTMLResponse

from api.errors import RouteNotFound
from api.problems import classes_of_errors, refusals, status_of
from core.bounds import LONGEST_NAME
from core.errors import GaitwayError

router = APIRouter(tags=["problems"])

_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>
<body style="font: 1rem/1.5 system-ui, sans-serif; max-width: 40rem; margin: 3rem auto; padding: 0 1rem">
<h1>{title}</h1><p><code>{code}</code>, answered with HTTP {status}</p><p>{text}</p></body></html>
"""


@router.get("/problems/{code}", response_class=HTMLResponse, responses=refusals(RouteNotFound))
async def explain(
    code: Annotated[str, Path(max_length=LONGEST_NAME, examples=["job-not-found"])],
) -> HTMLResponse:
    """A page that explains a type of problem."""
    for error in classes_of_errors():
        if error.code == code:
            return HTMLResponse(_page(error))
    raise RouteNotFound(f"There is no problem of the type {code[:100]!r}.")


def _page(error: type[GaitwayError]) -> str:
    text = inspect.getdoc(error) if "__doc__" in vars(error) and error.__doc__ else error.title
    escaped = {"title": html.escape(error.title), "code": error.code, "text": html.escape(text or "")}
    return _PAGE.format(**escaped, status=status_of(error))
