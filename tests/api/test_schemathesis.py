"""Requests that schemathesis makes up from the OpenAPI document, against the service under uvicorn."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from core.errors import Conflict, NotFound
from core.previews import library as previews
from core.uploads import library
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.test_clips import DESCRIPTION as CLIPS
from tests.api.test_models import DESCRIPTION
from tests.api.test_previews import announced

_CONFIG = Path(__file__).with_name("schemathesis.toml")
_ROOT = Path(__file__).parents[2]


@pytest.mark.extra
@pytest.mark.timeout(240)  # Twenty seconds where nobody else is at work.
def test_whatever_is_sent_the_service_answers_as_its_document_says(stack: Stack, tmp_path: Path) -> None:
    _end(Attempt(stack, job()))  # Under the id of the document's examples.
    command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(_CONFIG)]
    with _worker(stack):
        run = subprocess.run(
            [*command, "run", f"{stack.http.base_url}/openapi.json"],
            cwd=tmp_path,  # It leaves a folder where it runs.
            env={**os.environ, "COLUMNS": "100", "PYTHONPATH": str(_ROOT)},
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
    assert run.returncode == 0, run.stdout + run.stderr


@contextmanager
def _worker(stack: Stack) -> Iterator[None]:
    """One that ends each job as soon as it is queued, so that its streams end; and serves what else waits."""
    done = threading.Event()

    def work() -> None:
        while not done.wait(0.005):
            if waiting := stack.queue.take():
                with suppress(Conflict, NotFound):  # Somebody cancelled or deleted it.
                    _end(Attempt(stack, stack.store.get(waiting.job_id), is_new=False))
            if sent := stack.queue.take_upload():
                kind, upload_id = sent
                store, description = {
                    "model": (stack.store.models, DESCRIPTION),
                    "clips": (stack.store.clips, CLIPS),
                }[kind]
                ready = {"status": "ready", "description": description}
                store.settle(library.find(upload_id, store).model_copy(update=ready))
            if wanted := stack.queue.take_preview():
                previews.keep(wanted, [b"PNG"] * len(wanted.cameras), stack.objects, NOON)

    announced(stack)
    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def _end(attempt: Attempt) -> None:
    """Successful, with a row of each feed and a file of each kind."""
    attempt.say("metrics", step=0, values={"eval/episode_reward": 1.0})
    attempt.print("compiled")
    attempt.keep("video.mp4", b"video")
    attempt.keep("poster.png", b"poster", role="poster", media_type="image/png")
    attempt.keep(
        "500000.msgpack", b"state", role="checkpoint", media_type="application/octet-stream", step=500_000
    )
    attempt.keep("policy", b"own", role="policy", media_type="application/octet-stream", step=500_000)
    attempt.keep("policy.onnx", b"graph", role="export", media_type="application/octet-stream", step=500_000)
    attempt.end()
