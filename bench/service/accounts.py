"""What accounts add to a request: two processes of the API over the same stores, one with accounts.

Requests go to one and the other in turn, one after another, so that the machine's noise meets both alike.
"""

import argparse
import http.client
import json
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import psutil

from bench.stack import Parts, running_parts, until
from bench.summary import Figure, percentile
from core.accounts.principal import DEFAULT_PROJECT, Role, TokenScope
from core.accounts.store import Actor, Token, User
from core.accounts.tokens import new_secret
from core.adapters.wiring import job_store
from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.processes import ServerProcess, free_ports

_MOST_MS = 0.5
_WARM = 50
# For an accelerator that no worker here has: the jobs wait.
_JOB = json.dumps({"kind": "train", "environment": "ant", "resources": {"accelerator": "gpu"}})


@dataclass
class _Api:
    """A connection that stays open, the token that each request on it carries, and the API's process."""

    connection: http.client.HTTPConnection
    token: str | None
    process: psutil.Process

    def cpu_s(self) -> float:
        """Processor seconds until now; unlike a request's time, other work on the machine adds nothing."""
        times = self.process.cpu_times()
        return times.user + times.system

    def request(self, method: str, path: str, body: str | None = None) -> tuple[float, bytes]:
        """Seconds to the end of the answer, and its body. Raises RuntimeError for a refusal."""
        headers = {} if self.token is None else {"Authorization": f"Bearer {self.token}"}
        headers |= {} if body is None else {"Content-Type": "application/json"}
        began = time.perf_counter()
        self.connection.request(method, path, body, headers)
        answer = self.connection.getresponse()
        content = answer.read()
        seconds = time.perf_counter() - began
        if answer.status >= 400:
            raise RuntimeError(f"{method} {path}: {answer.status} {content[:300]!r}")
        return seconds, content


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """A submitter's requests for a job of their own, and for the first page of jobs; and submissions."""
    count = 100 if arguments.quick else 2000
    with running_parts() as parts, _with_accounts(parts) as (url, token, pid):
        one = next(parts.family("api"))
        apis = [_Api(_connected(parts.url), None, one), _Api(_connected(url), token, psutil.Process(pid))]
        own = json.loads(apis[1].request("POST", "/jobs", _JOB)[1])["id"]
        for name, method, path, body in (
            ("`GET /jobs/{id}`", "GET", f"/jobs/{own}", None),
            ("`POST /jobs`", "POST", "/jobs", _JOB),
            ("`GET /jobs`, 20 of them", "GET", "/jobs?limit=20", None),
        ):
            took: list[list[float]] = [[], []]
            before = [api.cpu_s() for api in apis]
            for number in range(_WARM + count):
                for api, seconds in zip(apis, took, strict=True):
                    spent = api.request(method, path, body)[0]
                    if number >= _WARM:
                        seconds.append(spent)
            without, more = (1000 * percentile(seconds, 50) for seconds in took)
            yield Figure(f"{name} without accounts, 50th percentile", without, "ms")
            # The listing has other queries: one's own jobs come first.
            most = None if "20" in name else _MOST_MS
            yield Figure(f"{name}: what accounts add, 50th percentile", more - without, "ms", at_most=most)
            used = [api.cpu_s() - began for api, began in zip(apis, before, strict=True)]
            added = 1000 * (used[1] - used[0]) / (_WARM + count)
            yield Figure(f"{name}: processor time that accounts add", added, "ms", at_most=most)


def _connected(url: str) -> http.client.HTTPConnection:
    parts = urlsplit(url)
    return http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=30)


@contextmanager
def _with_accounts(parts: Parts) -> Generator[tuple[str, str, int]]:
    """A second process of the API, which has accounts; its address, a submitter's token, and its id."""
    store = job_store(parts.settings())
    secret = new_secret()
    user = User(name="ann", role=Role.SUBMITTER, projects=(DEFAULT_PROJECT,), created_at=store.now())
    store.add_user(user, Actor())
    token = Token(id=secret.id, user=user.name, name="", scope=TokenScope.SUBMIT, created_at=store.now())
    store.add_token(token, secret, Actor())
    store.close()
    [port] = free_ports(1)
    folder = Path(parts.environment["GAITWAY_DATA_DIR"], "api-with-accounts")
    process = ServerProcess("api-with-accounts", private_folder(folder))
    environment = {
        **parts.environment,
        "GAITWAY_ACCOUNTS": "true",
        "GAITWAY_REQUESTS_PER_SECOND": "100000",
    }
    process.start([sys.executable, "-m", "api", "--port", str(port)], environment)
    try:
        until(lambda: _answers(port))
        assert process.pid is not None  # noqa: S101
        yield f"http://127.0.0.1:{port}", secret.text, process.pid
    finally:
        process.stop(3)


def _answers(port: int) -> bool:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=2)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()
