"""The HTTP edge: composition root, and the middleware for every request.

Only `build` knows the real adapters. The middleware checks access, gives a correlation id, writes one line of
log, and answers a defect with 500.
"""

import re
import secrets
import time
from collections.abc import Collection
from dataclasses import dataclass
from importlib.metadata import version
from ipaddress import ip_address
from urllib.parse import urlsplit

import structlog
from fastapi import Depends, FastAPI
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api import problems
from api.access import authorize, undeclared
from api.dependencies import Service, ServiceStore
from api.monitoring import Instruments
from api.openapi import describe, serve
from api.problems import CrossSiteRequest, EdgeError, UnexpectedError, UnknownHost, answer
from api.routes import ROUTERS
from core.configuration import read
from core.errors import Misconfigured
from core.jobs.queue import JobQueue
from core.settings import ApiSettings
from core.storage.objects import ObjectStore

_DESCRIPTION = """Train simulated bodies to walk: submit a training or a rollout, follow it, fetch its video.

Every refusal is `application/problem+json` (RFC 9457). Times are RFC 3339 in UTC; ids sort by time."""
_FOREIGN = ("cross-site", "same-site")
log = structlog.get_logger()
HEADER = "X-Request-ID"
_ACCEPTABLE = re.compile(r"[A-Za-z0-9_.:-]{1,64}")


def create_app(
    settings: ApiSettings,
    *,
    store: ServiceStore,
    queue: JobQueue,
    objects: ObjectStore,
    patient: ObjectStore | None = None,
    instruments: Instruments | None = None,
) -> FastAPI:
    """The service, built from these parts.

    patient: the object store for requests that may take minutes. instruments: those that observe the stores.
    """
    app = interface()
    app.state.service = Service(settings, store, queue, objects, patient)
    app.state.instruments = instruments = instruments or Instruments()
    app.add_middleware(Correlation, origin_check=OriginCheck(settings.hosts), instruments=instruments)
    return app


def interface() -> FastAPI:
    """Every route and its description; `create_app` adds what answers.

    Raises Misconfigured where a route does not say what it needs.
    """
    if missing := undeclared(ROUTERS):
        raise Misconfigured(f"api.access.ROUTES and the routers differ in {', '.join(missing)}.")
    app = FastAPI(
        title="Gaitway",
        version=version("gaitway"),
        description=_DESCRIPTION,
        redirect_slashes=False,
        docs_url=None,  # `api.routes.page` serves it, without any network but this service.
        redoc_url=None,
        openapi_url=None,  # `serve` answers it
    )
    app.openapi = lambda: describe(app)
    serve(app)
    problems.install(app)
    for router in ROUTERS:
        app.include_router(router, dependencies=[Depends(authorize)])
    return app


def build(settings: ApiSettings) -> FastAPI:
    """The service over PostgreSQL, RQ and the object store that the settings name."""
    from core.adapters.wiring import job_queue, job_store, object_store

    instruments = Instruments()
    observe = instruments.observe_store
    # A client waits for each answer, so a store that does not answer is given up after two seconds.
    objects = object_store(settings, retries=1, timeout_s=2.0, observe=observe)
    return create_app(
        settings,
        store=job_store(settings, observe=observe),
        queue=job_queue(settings, observe=observe),
        objects=objects,
        patient=object_store(settings, observe=observe),
        instruments=instruments,
    )


def from_environment() -> FastAPI:
    """The service, configured from the environment; for `uvicorn --factory api.app:from_environment`.

    The caller answers for where it listens: `python -m api` refuses an address that others reach while the
    service has no accounts, and this does not know the address. Raises Misconfigured.
    """
    from core.adapters.startup import check_stores

    settings = read(ApiSettings)
    check_stores(settings, timeout_s=0)  # until they answer, requests get 503
    return build(settings)


@dataclass(frozen=True)
class OriginCheck:
    """Access check for browsers: a page of another site may not read, submit or cancel anything.

    With accounts or without: the browser would send the user's cookie. A foreign page is refused because its
    browser sends the page's origin (`Origin`,
    `Sec-Fetch-Site`) and the host name that the page used (`Host`).
    allowed_hosts: names of this service, besides localhost and numeric addresses.
    If a foreign name resolves to this service (DNS rebinding), the browser takes that name's page and this
    service for one site. This cannot happen with a numeric address.
    """

    allowed_hosts: Collection[str] = ()

    def refusal(self, scope: Scope) -> EdgeError | None:
        """The refusal of this request, or None."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._is_ours(_name(host)):
            return UnknownHost(_name(host))
        if self._is_foreign(headers.get("origin"), host) or _is_embedded(headers):
            return CrossSiteRequest("A page of another site may not use this service.")
        return None

    def _is_ours(self, name: str) -> bool:
        if name == "localhost" or name.endswith(".localhost") or name in self.allowed_hosts:
            return True
        try:
            ip_address(name)
        except ValueError:
            return False
        return True

    def _is_foreign(self, origin: str | None, host: str) -> bool:
        if origin is None:
            return False
        try:
            place = urlsplit(origin).netloc
        except ValueError:  # Not a URL.
            return True
        return place != host and _name(place) not in self.allowed_hosts


def _is_embedded(headers: Headers) -> bool:
    """Whether another site's page sent this in the background; following a link from there is allowed."""
    return headers.get("sec-fetch-site") in _FOREIGN and headers.get("sec-fetch-mode") != "navigate"


def _name(host: str) -> str:
    """The host without its port, in lower case."""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""


class Correlation:
    """ASGI middleware. It keeps the client's X-Request-ID if that is harmless, and sends it back.

    It also counts the request for monitoring.
    """

    def __init__(self, app: ASGIApp, origin_check: OriginCheck, instruments: Instruments) -> None:
        self._app = app
        self._origin_check = origin_check
        self._instruments = instruments

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        sent = Headers(scope=scope).get(HEADER, "")
        correlation_id = sent if _ACCEPTABLE.fullmatch(sent) else secrets.token_hex(8)
        scope.setdefault("state", {})["correlation_id"] = correlation_id
        with structlog.contextvars.bound_contextvars(correlation_id=correlation_id):
            await self._answer(scope, receive, _Sender(send, correlation_id), correlation_id)

    async def _answer(self, scope: Scope, receive: Receive, sender: "_Sender", correlation_id: str) -> None:
        started = time.perf_counter()
        try:
            if (refusal := self._origin_check.refusal(scope)) is not None:
                await answer(refusal, scope["path"])(scope, receive, sender)
            else:
                await self._app(scope, receive, sender)
        except Exception:
            log.exception("request_crashed", method=scope["method"], path=scope["path"])
            if sender.status:  # Part of the answer is sent: only a broken connection can report this.
                raise
            await answer(UnexpectedError(correlation_id), scope["path"])(scope, receive, sender)
        if (audited := scope["state"].get("audited")) is not None and sender.status < 400:
            action, actor = audited
            # `/jobs/<id>/cancel`; of a new thing the header Location has the id.
            about = f"{action.partition('.')[0]} {(sender.location or scope['path']).split('/')[2]}"
            scope["app"].state.service.audit_log.add(actor, action, about)
        ended = time.perf_counter()
        log.info(
            "request_answered",
            method=scope["method"],
            path=scope["path"],
            status=sender.status,
            seconds=round(ended - started, 4),
        )
        self._instruments.observe_request(
            scope["method"], _route(scope), sender.status, (sender.began_at or ended) - started
        )


def _route(scope: Scope) -> str:
    """The path of the route as written, such as `/jobs/{job_id}`: there are few enough to count each."""
    return getattr(scope.get("route"), "path", "none")


class _Sender:
    """Sends the answer with the correlation id.

    It keeps the answer's status, its location, and when it began; 0 before that.
    """

    def __init__(self, send: Send, correlation_id: str) -> None:
        self.status = 0
        self.location = ""
        self.began_at = 0.0
        self._send = send
        self._correlation_id = correlation_id

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status, self.began_at = message["status"], time.perf_counter()
            headers = MutableHeaders(scope=message)
            headers[HEADER] = self._correlation_id
            self.location = headers.get("location", "")
        await self._send(message)
