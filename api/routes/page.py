"""The web page, the HTTP interface's documentation, the files of both, and the pages of problems."""

import html
import inspect
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import HTMLResponse

from api.page_files import PageFile, page_files
from api.problems import RouteNotFound, classes_of_errors, refusals, status_of
from core.bounds import LONGEST_NAME
from core.errors import GaitwayError

router = APIRouter()

_CONTENT_SECURITY_POLICY = "; ".join(
    [
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self' data: blob:",
        "media-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ]
)
_HEADERS = {
    "Content-Security-Policy": _CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Vary": "Accept-Encoding",
}
# The one script that compiles WebAssembly: a worker, which runs under its own file's policy.
_PHYSICS = "lib/push/worker.js"
_PHYSICS_POLICY = _CONTENT_SECURITY_POLICY.replace(
    "script-src 'self'", "script-src 'self' 'wasm-unsafe-eval'"
)
_CHECK_EACH_TIME = "no-cache"
_KEEP = "public, max-age=31536000, immutable"
_PROBLEM_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>
<body style="font: 1rem/1.5 system-ui, sans-serif; max-width: 40rem; margin: 3rem auto; padding: 0 1rem">
<h1>{title}</h1><p><code>{code}</code>, answered with HTTP {status}</p><p>{text}</p></body></html>
"""


@router.get("/", include_in_schema=False)
async def show_page(request: Request) -> Response:
    """The page that people use."""
    return _answer(request, page_files().by_path["index.html"], _CHECK_EACH_TIME)


def page_with_refusal(sentence: str, status: int) -> Response:
    """The page, which shows why a sign-in at the identity provider was refused."""
    here = page_files().by_path["index.html"]
    meta = f'<meta name="refusal" content="{html.escape(sentence)}"><title>'
    content = here.content.replace(b"<title>", meta.encode(), 1)
    return Response(
        content, status, headers={**_HEADERS, "Cache-Control": "no-store"}, media_type=here.media_type
    )


@router.get("/docs", include_in_schema=False)
async def show_docs(request: Request) -> Response:
    """The HTTP interface, to read and to try."""
    return _answer(request, page_files().by_path["docs.html"], _CHECK_EACH_TIME)


@router.get("/pages/{version}/{path:path}", include_in_schema=False)
async def show_file(version: str, path: str, request: Request) -> Response:
    """A file of the page. Its address changes with its content, so that browsers may keep it.

    While processes of two versions run side by side, one may be asked for the other's files: it sends its
    own, which browsers then do not keep.
    """
    here = page_files()
    if path not in here.by_path:
        raise RouteNotFound(f"The page has no file {path[:200]!r}.")
    answer = _answer(request, here.by_path[path], _KEEP if version == here.version else _CHECK_EACH_TIME)
    if path == _PHYSICS:
        answer.headers["Content-Security-Policy"] = _PHYSICS_POLICY
    return answer


def _answer(request: Request, file: PageFile, caching: str) -> Response:
    headers = {**_HEADERS, "Cache-Control": caching}
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(
            file.compressed, headers={**headers, "Content-Encoding": "gzip"}, media_type=file.media_type
        )
    return Response(file.content, headers=headers, media_type=file.media_type)


@router.get(
    "/problems/{code}", tags=["problems"], response_class=HTMLResponse, responses=refusals(RouteNotFound)
)
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
    return _PROBLEM_PAGE.format(**escaped, status=status_of(error))
