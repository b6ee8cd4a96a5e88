"""A Compose project of the test's own: its name, its port, its volumes; its images alone stay, as a cache."""

import json
import os
import secrets
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from gaitway.client import Client
from gaitway.service.embedded.processes import free_ports

LONGEST_S = 500


BASE = "python:3.12-slim-bookworm"


class CommandFailed(Exception):
    """The command's message."""


def run(*command: str, stdin: bytes | None = None, **settings: str) -> str:
    """The command's output. Raises CommandFailed. settings: for its environment."""
    return run_for_bytes(*command, stdin=stdin, **settings).decode(errors="replace")


def run_for_bytes(*command: str, stdin: bytes | None = None, **settings: str) -> bytes:
    """The command's output, as bytes. Raises CommandFailed."""
    done = subprocess.run(
        command,
        input=stdin,
        capture_output=True,
        check=False,
        timeout=LONGEST_S,
        env={**surroundings(), **settings},
    )
    if done.returncode:
        said = (done.stdout + done.stderr).decode(errors="replace")
        raise CommandFailed(f"{' '.join(command)} ended with {done.returncode}:\n{said[-4000:]}")
    return done.stdout


def size_mb(image: str) -> float:
    return int(run("docker", "image", "inspect", "--format", "{{.Size}}", image)) / 1e6


def surroundings() -> dict[str, str]:
    """The environment without settings of the tester's own."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith(("GAITWAY_", "COMPOSE_"))
    }


@dataclass
class Project:
    """One `docker compose` project over a checkout.

    settings: what a user would write to .env, the published port among them.
    """

    checkout: Path
    settings: dict[str, str] = field(default_factory=dict)
    name: str = field(default_factory=lambda: f"gaitway-test-{secrets.token_hex(4)}")
    port: int = field(default_factory=lambda: free_ports(1)[0])

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def client(self) -> Client:
        return Client(self.url)

    def compose(self, *arguments: str, stdin: bytes | None = None) -> str:
        """`docker compose …` in the checkout, as its user would type it. Raises CommandFailed."""
        return run(*self.command(*arguments), stdin=stdin, **self.environment())

    def command(self, *arguments: str) -> list[str]:
        place = ["--project-directory", str(self.checkout), "--project-name", self.name]
        return ["docker", "compose", *place, "--ansi", "never", *arguments]

    def environment(self) -> dict[str, str]:
        return {"GAITWAY_PORT": str(self.port), **self.settings}

    def containers(self, service: str, *, stopped: bool = False) -> list[str]:
        """The ids of a service's containers."""
        return self.compose("ps", "--quiet", *(["--all"] if stopped else []), service).split()

    def exec(self, service: str, *command: str) -> str:
        return self.compose("exec", "-T", service, *command)

    def logs(self, service: str) -> list[dict[str, object]]:
        """The log of a service's containers, one document a line."""
        lines = self.compose("logs", "--no-color", "--no-log-prefix", service).splitlines()
        # Some versions of Compose begin a line by erasing it, terminal or not.
        documents = (line.removeprefix("\x1b[2K") for line in lines)
        return [json.loads(document) for document in documents if document.startswith("{")]

    def wait_until_it_accepts(self, spec: dict[str, object], deadline_s: float) -> str:
        """Submit until there is a 202; the job's id."""
        deadline = time.monotonic() + deadline_s
        while True:
            try:
                answer = httpx.post(f"{self.url}/jobs", json=spec, timeout=5)
                if answer.status_code == 202:
                    return answer.json()["id"]
            except httpx.TransportError:
                pass
            if time.monotonic() > deadline:
                raise CommandFailed(f"No job was accepted at {self.url} within {deadline_s:.0f} s.")
            time.sleep(0.1)  # There is nothing to await before somebody listens.

    def remove(self) -> None:
        """Containers, networks and volumes, however far things got."""
        self.compose("--profile", "gpu", "down", "--volumes", "--remove-orphans", "--timeout", "1")


@contextmanager
def removing(project: Project) -> Iterator[Project]:
    try:
        yield project
    finally:
        project.remove()
