"""Users: they submit, cancel and follow jobs through any fault, and write down what they were told."""

import json
import random
import secrets
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import httpx

_PAUSE_S = 0.1
_FINAL = ("succeeded", "failed", "cancelled")


@dataclass
class Told:
    """The service's answers about one job. statuses: by every look at it, in their order."""

    seed: int
    job_id: str = ""
    cancel_answered: bool = False
    statuses: list[str] = field(default_factory=list[str])
    feeds: list[list[tuple[int, str, Any]]] = field(default_factory=list[list[tuple[int, str, Any]]])
    problems: list[str] = field(default_factory=list[str])


class Users:
    """Each job has a thread that submits it and perhaps cancels it, and two that follow its events.

    spec: what each job says besides its seed.
    """

    def __init__(
        self, url: str, num_jobs: int, rng: random.Random, spec: Mapping[str, Any] | None = None
    ) -> None:
        self._url, self._spec = url, spec or {}
        self._over = threading.Event()
        self.told = [Told(seed=rng.randrange(1000)) for _ in range(num_jobs)]
        self._threads: list[threading.Thread] = []
        for told in self.told:
            cancels_after_s = rng.uniform(0.2, 4.0) if rng.random() < 0.25 else None
            self._start(self._submit, told, rng.uniform(0.0, 2.0), cancels_after_s)

    def wait(self, timeout_s: float) -> list[str]:
        """Until every job has ended, and every reader has heard so; what did not come to an end."""
        deadline = time.monotonic() + timeout_s
        for thread in list(self._threads):
            thread.join(max(0.0, deadline - time.monotonic()))
        self._over.set()
        late = [thread.name for thread in self._threads if thread.is_alive()]
        for thread in self._threads:
            thread.join(10)
        return late

    def _start(self, target: Any, *arguments: Any) -> None:
        thread = threading.Thread(target=target, args=arguments, name=target.__name__, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _client(self) -> httpx.Client:
        # Without certificates: every look has a client of its own, and loading them takes 28 ms.
        return httpx.Client(base_url=self._url, timeout=5, trust_env=False, verify=False)  # noqa: S501

    def _submit(self, told: Told, after_s: float, cancels_after_s: float | None) -> None:
        self._over.wait(after_s)
        key, spec = (
            secrets.token_hex(8),
            {
                "kind": "train",
                "environment": "inverted_pendulum",
                "seed": told.seed,
                "max_attempts": 100,
                "checkpoints": {"keep": 2},
                **self._spec,
            },
        )
        answer = self._insist("POST", "/jobs", json=spec, headers={"Idempotency-Key": key})
        if answer is None:
            return
        if answer.status_code != 202:
            told.problems.append(f"POST /jobs: {answer.status_code} {answer.text[:300]}")
            return
        told.job_id = answer.json()["id"]
        for _ in range(2):
            told.feeds.append(feed := [])
            self._start(self._follow, told, feed)
        if cancels_after_s is not None:
            self._over.wait(cancels_after_s)
            answer = self._insist("POST", f"/jobs/{told.job_id}/cancel")
            told.cancel_answered = answer is not None and answer.status_code in (200, 202)
        self._look_until_the_end(told)

    def _insist(self, method: str, path: str, **sent: Any) -> httpx.Response | None:
        """The first answer that is not an outage."""
        with self._client() as client:
            while not self._over.is_set():
                with suppress(httpx.HTTPError):
                    answer = client.request(method, path, **sent)
                    if answer.status_code != 503:
                        return answer
                self._over.wait(_PAUSE_S)
        return None

    def _look_until_the_end(self, told: Told) -> None:
        looks_after_the_end = 0
        while not self._over.is_set() and looks_after_the_end < 3:
            answer = self._insist("GET", f"/jobs/{told.job_id}")
            if answer is None:
                return
            if answer.status_code != 200:
                told.problems.append(f"GET: {answer.status_code} {answer.text[:300]}")
                return
            status = answer.json()["status"]
            if not told.statuses or told.statuses[-1] != status:
                told.statuses.append(status)
            looks_after_the_end += status in _FINAL
            self._over.wait(_PAUSE_S)

    def _follow(self, told: Told, feed: list[tuple[int, str, Any]]) -> None:
        """Server-sent events, taken up again after the last one wherever they break off."""
        while not self._over.is_set():
            headers = {"Last-Event-ID": str(feed[-1][0])} if feed else {}
            with suppress(httpx.HTTPError), self._client() as client:
                path = f"/jobs/{told.job_id}/events"
                with client.stream("GET", path, headers=headers, timeout=20) as answer:
                    if answer.status_code == 204:
                        return
                    if answer.status_code == 200 and self._hear(answer, feed):
                        return
                    if answer.status_code not in (200, 503):
                        told.problems.append(f"events: {answer.status_code}")
                        return
            self._over.wait(_PAUSE_S)

    def _hear(self, answer: httpx.Response, feed: list[tuple[int, str, Any]]) -> bool:
        """Write down what comes; whether that was all."""
        number, kind = 0, ""
        for line in answer.iter_lines():
            if self._over.is_set():
                return True
            name, _, value = line.partition(": ")
            if name == "id":
                number = int(value)
            elif name == "event":
                kind = value
            elif name == "data":
                data = json.loads(value)["data"]
                feed.append((number, kind, data))
                if kind == "status" and data["status"] in _FINAL:
                    return True
        return False
