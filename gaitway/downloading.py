"""Downloads a file: resumes broken connections, and checks the hash before the file gets its name."""

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import httpx

from gaitway.errors import ApiError, DownloadFailed, Unavailable, Unreachable
from gaitway.retry import Retry
from gaitway.steps import Call, Open, Read, Request, Run, Sleep
from gaitway.views import ArtifactView

OnBytes = Callable[[int, int], None]


@dataclass(frozen=True)
class _Wanted:
    href: str
    size: int
    sha256: str
    part: Path


def download(retry: Retry, artifact: ArtifactView, path: Path, on_bytes: OnBytes | None = None) -> Call[Path]:
    """Download the artifact to `path`, which is returned. on_bytes: called with (bytes here, in all).

    Bytes are gathered in `<path>.<hash>.part`, from which a later call resumes. Raises DownloadFailed
    when two downloads had another hash, ApiError, and Unreachable when the service stays unavailable.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{artifact.sha256[:8]}.part")
    wanted = _Wanted(artifact.href, artifact.size, artifact.sha256, part)
    for _ in range(2):  # the second time from the beginning, in case an old part was damaged
        yield from _fill(retry, wanted, on_bytes or (lambda _here, _all: None))
        if (yield Run(lambda: _sha256(part))) == artifact.sha256:
            part.replace(path)
            return path
        part.unlink()
    raise DownloadFailed(f"{artifact.name} came with another SHA-256 than announced, twice; it was deleted.")


def save(retry: Retry, href: str, path: Path) -> Call[Path]:
    """Save a document that the service makes as it is asked, whose size and hash nobody knows before.

    The file gets its name once it is whole; after a broken connection it is asked for again. Raises ApiError,
    and Unreachable.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    for failures in range(1, retry.attempts + 1):
        try:
            yield Open(Request("GET", href, headers={"Accept-Encoding": "identity"}))
            with part.open("wb") as file:
                while (chunk := (yield Read())) is not None:
                    file.write(chunk)
            part.replace(path)
            return path
        except (Unreachable, Unavailable) as error:
            part.unlink(missing_ok=True)
            if failures == retry.attempts:
                raise
            yield Sleep(retry.delay_s(failures, error))
    raise AssertionError("a Retry needs at least one attempt")


def _fill(retry: Retry, wanted: _Wanted, on_bytes: OnBytes) -> Call[None]:
    """Download the part to its full size, over as many connections as needed."""
    wanted.part.touch()
    failures, lost_since = 0, time.monotonic()
    while (have := wanted.part.stat().st_size) < wanted.size:
        error: Exception | None = None
        try:
            yield from _one_connection(wanted, have, on_bytes)
        except (Unreachable, Unavailable) as caught:
            error = caught
        except ApiError as caught:
            if caught.status != 416:
                raise
            wanted.part.unlink()
            raise DownloadFailed(
                f"The service has fewer bytes of {wanted.href} than it announced."
            ) from caught
        if wanted.part.stat().st_size > have:
            failures, lost_since = 0, time.monotonic()
            continue
        failures += 1
        if time.monotonic() - lost_since > retry.patience_s:
            raise error or DownloadFailed(f"{wanted.href} stops after {have} of {wanted.size} bytes.")
        yield Sleep(retry.delay_s(failures, error))
    if wanted.part.stat().st_size > wanted.size:
        wanted.part.write_bytes(b"")
        yield from _fill(retry, wanted, on_bytes)


def _one_connection(wanted: _Wanted, have: int, on_bytes: OnBytes) -> Call[None]:
    # Any re-encoding on the way would make byte positions meaningless.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={have}-"} if have else {})
    response: httpx.Response = yield Open(Request("GET", wanted.href, headers=headers))
    resumed = _goes_on_at(response, have)
    here = have if resumed else 0
    with wanted.part.open("ab" if resumed else "wb") as file:
        while (chunk := (yield Read(raw=True))) is not None:
            here += len(chunk)
            if here > wanted.size:
                raise DownloadFailed(f"{wanted.href} has more bytes than the {wanted.size} announced.")
            file.write(chunk)
            on_bytes(here, wanted.size)


def _goes_on_at(response: httpx.Response, have: int) -> bool:
    """Whether the answer is the rest that was asked for, not the whole file."""
    return response.status_code == 206 and response.headers.get("Content-Range", "").startswith(
        f"bytes {have}-"
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
