"""Exports for the tests of their import."""

import io
import json
import tracemalloc
from collections.abc import Callable, Iterable
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import httpx

from tests.api.conftest import ARTIFACT, Attempt, Stack, job

Change = Callable[[dict[str, bytes]], None]


def trained(stack: Stack, **spec: Any) -> Attempt:
    """A job with every kind of file, metrics and a log, which has not ended."""
    attempt = Attempt(stack, job(name="first", labels={"project": "gaits"}, note="A note.", **spec))
    used = stack.http.get(f"/jobs/{attempt.id}/specification").json()["algorithm"]
    attempt.claim.start(details={"hyperparameters": used})
    for step in (100, 200):
        values = {"eval/episode_reward": step / 7, "eval/not_finite": float("nan")}
        attempt.say("metrics", step=step, values=values)
        attempt.keep(f"checkpoint-{step}.ckpt", ARTIFACT[: step + 1], role="checkpoint", step=step)
    attempt.print("compiled", "a line with U+0000: \0", "")
    attempt.keep("policy", b"policy", role="policy", media_type="application/octet-stream")
    attempt.keep("video.mp4", ARTIFACT, step=200, metadata={"cameras": ["track"]})
    attempt.keep("tables.npz", b"", role="tables", media_type="application/x-npz")
    return attempt


def bring(http: httpx.Client, archive: bytes, **headers: str) -> httpx.Response:
    return http.post("/jobs/import", content=archive, headers={"Content-Type": "application/zip", **headers})


def sent_in_pieces(stack: Stack, pieces: Iterable[bytes | memoryview]) -> tuple[httpx.Response, int]:
    """The answer, and the most memory that this process took besides."""
    tracemalloc.start()
    sent = (bytes(piece) for piece in pieces)
    answer = stack.http.post("/jobs/import", content=sent, headers={"Content-Type": "application/zip"})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return answer, peak


def changed(archive: bytes, change: Change) -> bytes:
    """The same zip with other files."""
    with ZipFile(io.BytesIO(archive)) as source:
        files = {name: source.read(name) for name in source.namelist()}
    change(files)
    out = io.BytesIO()
    with ZipFile(out, "w", ZIP_DEFLATED) as target:
        for name, body in files.items():
            target.writestr(name, body)
    return out.getvalue()


def edit(name: str, **members: Any) -> Change:
    """Gives a document of the zip these members; a path a.0.b leads into it."""

    def change(files: dict[str, bytes]) -> None:
        document = json.loads(files[name])
        for path, value in members.items():
            *way, last = path.split("__")
            place = document
            for step in way:
                place = place[int(step) if step.isdecimal() else step]
            place[last] = value
        files[name] = json.dumps(document).encode()

    return change


def without(name: str) -> Change:
    """Takes a file out of the zip."""

    def change(files: dict[str, bytes]) -> None:
        del files[name]

    return change


def with_file(name: str, body: bytes) -> Change:
    """Puts a file into the zip, or replaces it."""

    def change(files: dict[str, bytes]) -> None:
        files[name] = body

    return change
