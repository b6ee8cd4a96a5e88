"""A job as a file for others: whole, streamed, and honest about what is missing."""

import csv
import hashlib
import io
import json
import re
import zipfile
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import Any
from zipfile import ZipFile

import httpx
import pytest

from api.sharing.export import ZipMember, zip_stream
from core.jobs import feeds
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.storage import keys
from core.user_models.record import ModelRecord
from tests.api.conftest import ARTIFACT, NOON, Attempt, Stack, job
from tests.in_memory import MemoryObjectStore

EVIL = '<img src=x onerror="alert(1)"> & </script>'


def opened(stack: Stack, job_id: str) -> ZipFile:
    answer = stack.http.get(f"/jobs/{job_id}/export")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/zip")
    archive = ZipFile(io.BytesIO(answer.content))
    assert archive.testzip() is None
    return archive


def contents(archive: ZipFile) -> dict[str, Any]:
    return json.loads(archive.read("contents.json"))


def test_a_whole_job_is_in_its_zip_and_its_specification_runs_again(stack: Stack) -> None:
    attempt = Attempt(stack, job(algorithm={"kind": "ppo", "num_timesteps": 1000}))
    attempt.say("metrics", step=7, values={"eval/episode_reward": 2.5})
    attempt.print("hello")
    for step in (100, 200):
        attempt.keep(
            f"checkpoint-{step}.ckpt", b"old" if step == 100 else ARTIFACT, role="checkpoint", step=step
        )
    attempt.keep("policy", b"policy", role="policy")
    attempt.keep("policy.npz", b"npz", role="export")
    attempt.keep("trajectory.npz", b"path", role="trajectory")
    attempt.keep("video.mp4", b"film")
    attempt.end()
    archive = opened(stack, attempt.id)
    assert archive.read("files/checkpoint-200.ckpt") == ARTIFACT
    assert "files/checkpoint-100.ckpt" not in archive.namelist()
    assert [archive.read(f"files/{name}") for name in ("policy.npz", "video.mp4")] == [b"npz", b"film"]
    assert "files/trajectory.npz" in archive.namelist()
    table = list(csv.DictReader(io.StringIO(archive.read("metrics.csv").decode())))
    assert [(row["step"], row["eval/episode_reward"]) for row in table] == [("7", "2.5")]
    assert json.loads(archive.read("metrics.jsonl"))["values"] == {"eval/episode_reward": 2.5}
    assert archive.read("log.txt") == b"hello\n"
    assert json.loads(archive.read("job.json"))["attempts"][0]["reason"] == "completed"
    assert json.loads(archive.read("versions.json"))["attempts"][0]["engine"] == "native"
    readme = archive.read("README.txt").decode()
    assert readme.count("\n") == 3
    assert "gaitway submit --file spec.json" in readme
    found = contents(archive)
    assert found["missing"] == []
    for file in found["files"]:
        body = archive.read(file["path"])
        assert (hashlib.sha256(body).hexdigest(), len(body)) == (file["sha256"], file["size"])

    spec = json.loads(archive.read("spec.json"))
    assert spec["algorithm"]["num_timesteps"] == 1000
    assert spec["algorithm"]["learning_rate"] > 0  # filled in
    again = stack.http.post("/jobs", json=spec)
    assert again.status_code == 202, again.text
    assert stack.http.get(f"/jobs/{again.json()['id']}/specification").json() == spec


def test_what_is_missing_is_named_with_its_reason(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    purged = attempt.keep("checkpoint-5.ckpt", role="checkpoint", step=5)
    stack.objects.delete_prefix(purged.key)
    archive = opened(stack, attempt.id)
    why = {part["part"]: part["why"] for part in contents(archive)["missing"]}
    assert why == {
        "checkpoint-5.ckpt": "the object store no longer has it",
        "policy": "the job is running and has none yet",
        "video": "the job is running and has none yet",
    }
    assert archive.read("metrics.csv") == b"step,time\r\n"
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    rollout = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": attempt.id}, "video": None}
    other = Attempt(stack, job("019aa3c2f0b2-5be0c1d2e4", **rollout))
    missing = contents(opened(stack, other.id))["missing"]
    assert {part["part"]: part["why"] for part in missing} == {
        f"the checkpoint of job {attempt.id}": "that is another job, which has its own export",
        "trajectory": "the job is running and has none yet",
        "video": "the job asks for none",
    }
    missing = contents(opened(stack, attempt.id))["missing"]
    assert {"part": "video", "why": "the job ended as failed (diverged) without one"} in missing


def test_the_users_own_model_goes_along_or_is_named(stack: Stack) -> None:
    xml = b"<mujoco/>"
    model = f"sha256:{hashlib.sha256(xml).hexdigest()}"
    options = {"model": model}
    stack.store.add(found := job(environment={"id": "mjcf", "options": options}))
    missing = contents(opened(stack, found.id))["missing"]
    assert {"part": f"the model {model}", "why": "it was deleted"} in missing
    stack.objects.put(keys.model_source(model), xml)
    record = ModelRecord(id=model, status="ready", media_type="application/xml", size=9, created_at=NOON)
    stack.store.models.add(record)
    archive = opened(stack, found.id)
    [path] = [name for name in archive.namelist() if name.startswith("model/")]
    assert archive.read(path) == xml
    assert "gaitway models add model/*" in archive.read("README.txt").decode()


def test_a_small_file_is_read_once_for_its_hash_and_its_bytes(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempt = Attempt(stack, job())
    kept = [attempt.keep(f"{number}.png", bytes([number]), role="picture") for number in range(9)]
    read, found = list[str](), MemoryObjectStore._found  # pyright: ignore[reportPrivateUsage]

    def noting(self: MemoryObjectStore, key: str) -> Any:
        read.append(key)
        return found(self, key)

    monkeypatch.setattr(MemoryObjectStore, "_found", noting)
    archive = opened(stack, attempt.id)
    assert read == [file.key for file in kept]
    assert [archive.read(f"files/{number}.png") for number in range(9)] == [bytes([n]) for n in range(9)]


def test_a_zip_is_sent_as_it_is_made() -> None:
    # Of 8 MiB in pieces of 1 MiB, no more than one piece (and the deflater's window) waits to be sent.
    read = 0

    def pieces() -> Iterator[bytes]:
        nonlocal read
        for _ in range(8):
            read += 2**20
            yield bytes(range(256)) * 4096

    sent = bytearray()
    for part in zip_stream([ZipMember("big", pieces(), compress=False), ZipMember("small", [b"x"])]):
        sent += part
        assert read - len(sent) <= 2**20
    archive = ZipFile(io.BytesIO(sent))
    assert (len(archive.read("big")), archive.read("small")) == (8 * 2**20, b"x")


def test_a_zip_of_a_member_that_breaks_off_has_no_end() -> None:
    def broken() -> Iterator[bytes]:
        yield b"half"
        raise OSError("gone")

    sent = bytearray()
    with pytest.raises(OSError, match="gone"):
        sent.extend(chain.from_iterable(zip_stream([ZipMember("half", broken())])))
    with pytest.raises(zipfile.BadZipFile):
        ZipFile(io.BytesIO(sent))


def test_a_store_that_goes_away_in_the_middle_breaks_the_connection(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("checkpoint-5.ckpt", role="checkpoint", step=5)

    @contextmanager
    def failing(*_: object, **__: object) -> Iterator[Iterator[bytes]]:
        def pieces() -> Iterator[bytes]:
            yield b"half"
            raise OSError("gone")

        yield pieces()

    monkeypatch.setattr(MemoryObjectStore, "open", failing)
    with pytest.raises(httpx.RemoteProtocolError):
        stack.http.get(f"/jobs/{attempt.id}/export")


@pytest.mark.parametrize("what", ["export", "report.html", "specification"])
def test_a_job_that_does_not_exist_is_a_404(stack: Stack, what: str) -> None:
    assert stack.http.get(f"/jobs/019aa3c2f0b1-5be0c1d2e3/{what}").status_code == 404
    with stack.away("store"):
        assert stack.http.get(f"/jobs/019aa3c2f0b1-5be0c1d2e3/{what}").status_code == 503


@pytest.mark.parametrize("size", [0, 1, 2, 3, 2**20, 2**21 + 1])
def test_a_report_has_the_video_inside_byte_by_byte(stack: Stack, size: int) -> None:
    attempt = Attempt(stack, job())
    film = (ARTIFACT * 2)[:size]
    attempt.keep("video.mp4", film)
    report = stack.http.get(f"/jobs/{attempt.id}/report.html")
    found = re.search(r'src="data:video/mp4;base64,([^"]*)"', report.text)
    assert found is not None
    assert b64decode(found[1], validate=True) == film


def test_markup_in_names_logs_and_metrics_is_text_and_nothing_runs(stack: Stack) -> None:
    attempt = Attempt(stack, job(name=EVIL, labels={"l": EVIL}, note=EVIL))
    attempt.say("metrics", step=7, values={EVIL: 1.0, "eval/episode_reward": 2.0})
    attempt.print(EVIL)
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    report = stack.http.get(f"/jobs/{attempt.id}/report.html")
    assert "<img" not in report.text
    # The page's own: values, addresses and the start of the viewers.
    assert re.findall(r"<script[^>]*>", report.text) == [
        '<script type="application/json" id="curves-data">',
        '<script type="importmap">',
        '<script type="module">',
    ]
    assert report.text.count("</script>") == 3
    assert report.text.count("&lt;img") >= 5
    assert "sandbox" in report.headers["content-security-policy"]


def test_a_report_reads_the_end_of_a_log_alone(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "_MAX_ENTRIES", 100)
    attempt = Attempt(stack, job())
    attempt.print(*(f"line {number}." for number in range(450)))
    attempt.end()
    while feeds.compact(store=stack.store, objects=stack.objects):
        pass
    first, second, *_ = [one for one in stack.store.chunks([attempt.id])[attempt.id] if one.channel == "logs"]
    for unneeded in (first, second):
        stack.objects.delete_prefix(unneeded.key)
    report = stack.http.get(f"/jobs/{attempt.id}/report.html").text
    assert re.findall(r"line (\d+)\.", report) == [str(number) for number in range(250, 450)]
    assert "lost from" not in report


def test_the_size_that_a_report_states_is_its_size(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("video.mp4", ARTIFACT)
    report = stack.http.get(f"/jobs/{attempt.id}/report.html")
    stated = re.search(r"This file has ([0-9.]+) MB", report.text)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(len(report.content) / 1e6, abs=0.06)


def test_a_report_holds_the_finite_values_of_each_metric_and_runs_nothing_without_any(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    empty = stack.http.get(f"/jobs/{attempt.id}/report.html")
    assert "Nothing was measured." in empty.text
    assert "<script" not in empty.text
    assert "allow-scripts" not in empty.headers["content-security-policy"]
    for step, value in enumerate([0.0, 10.0, None, 5.0]):
        attempt.say("metrics", step=50 * step, values={"eval/episode_reward": value, "training/loss": None})
    report = stack.http.get(f"/jobs/{attempt.id}/report.html").text
    held = re.search(r'id="curves-data">(.*?)</script>', report)
    assert held is not None
    assert json.loads(held[1]) == {"eval/episode_reward": [[0, 50, 150], [0.0, 10.0, 5.0]]}
    assert "<td>eval/episode_reward</td><td>5</td><td>10</td>" in report
