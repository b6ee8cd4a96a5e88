"""Middleware for every request: access check, correlation id, one log line, and 500 for a defect."""

import re
import secrets
import time

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.errors import UnexpectedError
from api.origins import OriginCheck
from api.problems import answer

log = structlog.get_logger()

HEADER = "X-Request-ID"
_ACCEPTABLE = re.compile(r"[A-Za-z0-9_.:-]{1,64}")


class Correlation:
    """ASGI middleware. It keeps the client's X-Request-ID if that is harmless, and sends it back."""

    def __init__(self, app: ASGIApp, origin_check: OriginCheck) -> None:
        self._app = app
        self._origin_check = origin_check

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        sent = Headers(scope=scope).get(HEADER, "")
        correlation_id = sent if _ACCEPTABLE.fullmatch(sent) else secrets.token_hex(8)
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
        seconds = round(time.perf_counter() - started, 4)
        log.info(
            "request_answered",
            method=scope["method"],
            path=scope["path"],
            status=sender.status,
            seconds=seconds,
        )


class _Sender:
    """Sends the answer with the correlation id, and keeps its status; 0 before the answer begins."""

    def __init__(self, send: Send, correlation_id: str) -> None:
        self.status = 0
        self._send = send
        self._correlation_id = correlation_id

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            MutableHeaders(scope=message)[HEADER] = self._correlation_id
        await self._send(message)
