"""Videos, checkpoints and other files: ranges, versions, and what is not there."""

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.api.conftest import ARTIFACT, Attempt, Stack, job
from tests.api.problems import problem

SIZE = len(ARTIFACT)
ETAG = f'"{hashlib.sha256(ARTIFACT).hexdigest()}"'


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    attempt = Attempt(stack, job())
    attempt.keep("video.mp4", metadata={"camera": "track"})
    return attempt


@pytest.fixture
def video(attempt: Attempt) -> str:
    return f"/jobs/{attempt.id}/video"


def test_a_whole_video_comes_with_what_a_player_needs(stack: Stack, video: str) -> None:
    answer = stack.http.get(video)
    assert (answer.status_code, answer.content) == (200, ARTIFACT)
    assert answer.headers["Content-Type"] == "video/mp4"
    assert answer.headers["Content-Length"] == str(SIZE)
    assert answer.headers["Accept-Ranges"] == "bytes"
    assert answer.headers["ETag"] == ETAG
    assert answer.headers["Content-Disposition"] == "inline; filename*=UTF-8''video.mp4"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    ("wanted", "start", "end"),
    [
        ("bytes=0-0", 0, 1),
        ("bytes=0-99", 0, 100),
        ("bytes=1048570-1048579", 1048570, 1048580),  # across the border of two pieces
        ("bytes=100-", 100, SIZE),
        ("bytes=-5", SIZE - 5, SIZE),
        (f"bytes=-{SIZE + 9}", 0, SIZE),
        (f"bytes={SIZE - 1}-{SIZE + 9}", SIZE - 1, SIZE),
        ("Bytes=7-8", 7, 9),
    ],
)
def test_a_range_is_answered_with_exactly_its_bytes(
    stack: Stack, video: str, wanted: str, start: int, end: int
) -> None:
    answer = stack.http.get(video, headers={"Range": wanted})
    assert answer.status_code == 206
    assert answer.content == ARTIFACT[start:end]
    assert answer.headers["Content-Range"] == f"bytes {start}-{end - 1}/{SIZE}"
    assert answer.headers["Content-Length"] == str(end - start)


@pytest.mark.parametrize(
    "wanted", [f"bytes={SIZE}-", f"bytes={SIZE}-{SIZE + 5}", "bytes=9999999999999999999-", "bytes=-0"]
)
def test_a_range_past_the_end_is_refused_with_the_size(stack: Stack, video: str, wanted: str) -> None:
    answer = stack.http.get(video, headers={"Range": wanted})
    assert problem(answer, 416, "range-not-satisfiable")["size"] == SIZE
    assert answer.headers["Content-Range"] == f"bytes */{SIZE}"


@pytest.mark.parametrize(
    "wanted", ["bytes=0-1,5-6", "bytes=5-2", "bytes=-", "bytes=a-b", "lines=1-2", "bytes=٣-٤".encode()]
)
def test_a_range_that_makes_no_sense_or_is_many_gives_the_whole(
    stack: Stack, video: str, wanted: str
) -> None:
    answer = stack.http.get(video, headers={"Range": wanted})
    assert (answer.status_code, len(answer.content)) == (200, SIZE)


@pytest.mark.parametrize(
    ("version", "status"),
    [(ETAG, 206), ('"x"', 200), (f"W/{ETAG}", 200), ("Fri, 20 Nov 2026 12:00:00 GMT", 200)],
)
def test_a_range_holds_for_its_version_only(stack: Stack, video: str, version: str, status: int) -> None:
    assert stack.http.get(video, headers={"Range": "bytes=0-9", "If-Range": version}).status_code == status


@pytest.mark.parametrize(
    ("known", "status"), [(ETAG, 304), (f'"x", W/{ETAG}', 304), ("*", 304), ('"x"', 200)]
)
def test_a_version_that_the_client_has_is_not_sent_again(
    stack: Stack, video: str, known: str, status: int
) -> None:
    answer = stack.http.get(video, headers={"If-None-Match": known})
    assert answer.status_code == status
    assert answer.headers["ETag"] == ETAG
    assert len(answer.content) == (0 if status == 304 else SIZE)


def test_a_head_tells_the_size_and_sends_nothing(stack: Stack, video: str) -> None:
    answer = stack.http.head(video, headers={"Range": "bytes=0-1"})
    assert (answer.status_code, answer.content) == (200, b"")
    assert (answer.headers["Content-Length"], answer.headers["ETag"]) == (str(SIZE), ETAG)


def test_the_newest_video_is_shown_unless_another_is_asked_for(
    stack: Stack, attempt: Attempt, video: str
) -> None:
    attempt.keep("video-100.mp4", b"hundred", step=100, metadata={"camera": "side"})
    attempt.keep("video-200.mp4", b"two hundred", step=200, metadata={"cameras": ["top", "side"]})
    assert stack.http.get(video).content == ARTIFACT  # without a step: of the end
    assert stack.http.get(video, params={"step": 100}).content == b"hundred"
    assert stack.http.get(video, params={"camera": "side"}).content == b"two hundred"
    assert stack.http.get(video, params={"camera": "top"}).content == b"two hundred"
    answer = stack.http.get(video, params={"step": 100, "camera": "track"})
    assert "step 100 by camera 'track'" in problem(answer, 404, "artifact-not-ready")["detail"]


def test_a_video_that_may_come_says_when_to_ask_again(stack: Stack) -> None:
    stack.store.add(job())
    answer = stack.http.get("/jobs/019aa3c2f0b1-5be0c1d2e3/video")
    assert "is queued and has no video yet" in problem(answer, 404, "artifact-not-ready")["detail"]
    assert int(answer.headers["Retry-After"]) > 0


@pytest.mark.parametrize("picture", ["video", "poster"])
def test_a_job_that_asks_for_no_video_says_so(stack: Stack, picture: str) -> None:
    sent = {"kind": "train", "environment": "ant", "video": None}
    address = stack.http.post("/jobs", json=sent).headers["Location"]
    answer = stack.http.get(f"{address}/{picture}")
    assert "asks for no video: its `video` is null" in problem(answer, 404, "artifact-not-found")["detail"]
    assert "Retry-After" not in answer.headers


def test_a_video_that_never_comes_says_why(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.end(JobStatus.FAILED, Reason.OUT_OF_MEMORY)
    answer = stack.http.get(f"/jobs/{attempt.id}/video")
    document = problem(answer, 404, "artifact-not-found")
    assert "failed (out_of_memory: It came to its end.)" in document["detail"]
    assert "Retry-After" not in answer.headers


def test_without_a_video_the_replay_is_offered(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("replay.bin", role="replay", media_type="application/octet-stream")
    attempt.end()
    detail = problem(stack.http.get(f"/jobs/{attempt.id}/video"), 404, "artifact-not-found")["detail"]
    assert detail.endswith(
        f"Its replay is there, in 3D on its page. `gaitway rollout {attempt.id}` draws a video."
    )


def test_checkpoints_are_listed_by_step_and_fetched(stack: Stack, attempt: Attempt) -> None:
    for step in (300, 100, 200):
        facts = {"role": "checkpoint", "step": step, "media_type": "application/octet-stream"}
        attempt.keep(f"checkpoint-{step}", str(step).encode(), **facts)
    listed = stack.http.get(f"/jobs/{attempt.id}/checkpoints").json()
    assert [item["step"] for item in listed["items"]] == [100, 200, 300]
    assert stack.http.get(listed["items"][1]["href"]).content == b"200"
    assert stack.http.get(f"/jobs/{attempt.id}/checkpoints/300").content == b"300"
    attempt.end()
    answer = stack.http.get(f"/jobs/{attempt.id}/checkpoints/999")
    assert "checkpoint-100" in problem(answer, 404, "artifact-not-found")["detail"]


@pytest.mark.parametrize("step", ["-1", "x", "9" * 5000, "1.5"])
def test_a_step_that_is_no_step_is_refused(stack: Stack, attempt: Attempt, step: str) -> None:
    problem(stack.http.get(f"/jobs/{attempt.id}/checkpoints/{step}"), 422, "invalid-request")


@pytest.mark.parametrize(
    "name", ["..%2fspec.json", "..%00", "%2e%2e%2f%2e%2e", "a%20b", "spec.json", "manifest.json"]
)
def test_only_what_the_record_names_can_be_fetched(stack: Stack, attempt: Attempt, name: str) -> None:
    attempt.end()
    answer = stack.http.get(f"/jobs/{attempt.id}/artifacts/{name}")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_name_with_odd_characters_has_an_address_that_works(stack: Stack, attempt: Attempt) -> None:
    attempt.keep('Läufer "1" é.mp4', b"odd")
    href = stack.http.get(f"/jobs/{attempt.id}").json()["artifacts"][-1]["href"]
    answer = stack.http.get(href)
    assert answer.content == b"odd"
    assert answer.headers["Content-Disposition"].endswith("L%C3%A4ufer%20%221%22%20%C3%A9.mp4")


def test_text_is_never_run_by_a_browser(stack: Stack, attempt: Attempt) -> None:
    kept = attempt.keep("log.html", b"<script>", role="log", media_type="text/html")
    answer = stack.http.get(f"/jobs/{attempt.id}/artifacts/{kept.name}")
    assert answer.headers["Content-Type"] == "text/plain; charset=utf-8"
    assert answer.headers["Content-Security-Policy"] == "sandbox"


def test_an_empty_file_is_a_file(stack: Stack, attempt: Attempt) -> None:
    kept = attempt.keep("empty", b"")
    answer = stack.http.get(f"/jobs/{attempt.id}/artifacts/{kept.name}")
    assert (answer.status_code, answer.headers["Content-Length"]) == (200, "0")


def test_a_file_is_closed_when_the_client_leaves_half_way(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed, sent = threading.Event(), list[int]()

    @contextmanager
    def endless(*_: object, **__: object) -> Iterator[Iterator[bytes]]:
        try:
            yield (sent.append(1) or bytes(2**20) for _ in range(10**6))
        finally:
            closed.set()

    kept = attempt.keep("long.mp4", b"x", step=1)
    long = kept.model_copy(update={"name": "longer.mp4", "size": 10**6 * 2**20})
    attempt.claim.publish((long,), keep_checkpoints=5)
    monkeypatch.setattr(stack.objects, "open", endless)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/artifacts/longer.mp4") as answer:
        assert len(next(answer.iter_bytes())) > 0
    assert closed.wait(10)
    # What lies in the sockets' buffers was read ahead, and no more.
    assert sum(sent) < 100
