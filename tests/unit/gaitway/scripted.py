"""An HTTP server over real sockets that answers as a test scripts it, broken connections included."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from gaitway.client import Client
from gaitway.retry import Retry

QUICK = Retry(attempts=3, first_delay_s=0.001, max_delay_s=0.01, patience_s=0.05)


@dataclass
class Request:
    method: str
    path: str
    headers: dict[str, str]
    body: bytes


@dataclass
class Answer:
    """announce: the Content-Length to claim, larger than the body for a connection that breaks off."""

    status: int = 200
    body: bytes = b""
    headers: dict[str, str] = field(default_factory=dict[str, str])
    announce: int | None = None


Script = Callable[[Request, int], Answer | None]


@dataclass
class Scripted:
    client: Client
    url: str
    requests: list[Request]


@contextmanager
def scripted(script: Script) -> Iterator[Scripted]:
    """script: (request, how many came before it) -> answer; None hangs up without one."""
    requests: list[Request] = []

    class Handler(BaseHTTPRequestHandler):
        def _answer(self) -> None:
            length = int(self.headers.get("Content-Length") or 0)
            headers = {name.lower(): value for name, value in self.headers.items()}
            request = Request(self.command, self.path, headers, self.rfile.read(length))
            requests.append(request)
            answer = script(request, len(requests) - 1)
            self.close_connection = True
            if answer is None:
                return
            self.send_response(answer.status)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(answer.announce or len(answer.body)))
            self.end_headers()
            self.wfile.write(answer.body)

        do_GET = do_POST = do_DELETE = _answer  # noqa: N815 # the names it asks for

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    url = f"http://127.0.0.1:{server.server_port}"
    try:
        with Client(url, retry=QUICK, timeout_s=5) as client:
            yield Scripted(client, url, requests)
    finally:
        server.shutdown()
        thread.join(5)
        server.server_close()
