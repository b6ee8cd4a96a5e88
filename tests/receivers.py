"""HTTP receivers of webhooks, on addresses of this machine."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from queue import Queue
from threading import Event, Thread
from typing import Any

from pydantic_core import from_json


@dataclass(frozen=True)
class Received:
    """A request that has come. headers: with small letters."""

    headers: dict[str, str]
    body: bytes

    @property
    def message(self) -> Any:
        return from_json(self.body)


@dataclass
class Receiver:
    """url: where it listens. requests: as they come. answers: gives the status for the number of a request,
    from 1, and its Location, or Retry-After where it does not redirect; None: no answer until `release`."""

    url: str
    answers: Callable[[int], tuple[int, str] | None]
    requests: Queue[Received] = field(default_factory=Queue[Received])
    release: Event = field(default_factory=Event)
    number: int = 0

    def next(self, timeout_s: float = 10.0) -> Received:
        return self.requests.get(timeout=timeout_s)


@contextmanager
def receiving(
    answers: Callable[[int], tuple[int, str] | None] = lambda number: (204, ""), host: str = "127.0.0.1"
) -> Iterator[Receiver]:
    """A receiver at a free port of this address."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            receiver.number += 1
            answer = receiver.answers(receiver.number)
            headers = {name.lower(): value for name, value in self.headers.items()}
            receiver.requests.put(Received(headers, body))
            if answer is None:
                receiver.release.wait()
                return
            self.send_response(answer[0])
            if answer[1]:
                is_redirect = 300 <= answer[0] < 400
                self.send_header("location" if is_redirect else "retry-after", answer[1])
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:
            pass

    with ThreadingHTTPServer((host, 0), Handler) as server:
        server.daemon_threads = True
        receiver = Receiver(f"http://{host}:{server.server_address[1]}/hook", answers)
        thread = Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield receiver
        finally:
            receiver.release.set()
            server.shutdown()
            thread.join()
