"""The client against a service that breaks connections, refuses, and lies."""

import copy
import hashlib
import json
import pickle
import socket
import time
from pathlib import Path

import pytest

from gaitway import (
    Client,
    Conflict,
    DownloadFailed,
    NotFound,
    NotReady,
    Rejected,
    Unavailable,
    Unreachable,
    WaitTimeout,
    WrongAddress,
)
from tests.unit.gaitway.scripted import QUICK, Answer, Request, scripted

ID = "019aa3c2f0b1-5be0c1d2e3"
BODY = bytes(range(256)) * 40  # 10,240 bytes


def job(status: str = "running", **more: object) -> Answer:
    document = {"id": ID, "kind": "train", "status": status, "created_at": "2026-11-20T12:00:00Z", **more}
    return Answer(200, json.dumps(document).encode(), {"Content-Type": "application/json"})


def problem(status: int, headers: dict[str, str] | None = None, **members: object) -> Answer:
    document = {"type": "/problems/x", "title": "T", "detail": "D.", "status": status, **members}
    headers = {"Content-Type": "application/problem+json", **(headers or {})}
    return Answer(status, json.dumps(document).encode(), headers)


def event(number: int, kind: str, **data: object) -> bytes:
    document = json.dumps({"time": "2026-11-20T12:00:00Z", "data": data})
    return f"id: {number}-0\nevent: {kind}\ndata: {document}\n\n".encode()


def with_video(body: bytes = BODY, sha256: str | None = None) -> Answer:
    artifact = {
        "name": "video.mp4",
        "role": "video",
        "size": len(body),
        "sha256": sha256 or hashlib.sha256(body).hexdigest(),
        "href": f"/jobs/{ID}/artifacts/video.mp4",
    }
    return job("succeeded", artifacts=[artifact])


def ranged(request: Request, body: bytes, most: int) -> Answer:
    """The bytes that a Range asks for; the connection breaks after `most` of them."""
    start = int(request.headers.get("range", "bytes=0-").removeprefix("bytes=").partition("-")[0])
    rest = body[start:]
    headers = {"Content-Range": f"bytes {start}-{len(body) - 1}/{len(body)}"}
    return Answer(206 if start else 200, rest[:most], headers if start else {}, announce=len(rest))


def test_a_submission_whose_answer_was_lost_is_repeated_with_the_same_key() -> None:
    with scripted(lambda _, before: None if before < 2 else job("queued")) as service:
        assert service.client.submit(environment="ant").status == "queued"
    keys = [request.headers["idempotency-key"] for request in service.requests]
    assert len(keys) == 3
    assert len(set(keys)) == 1
    assert json.loads(service.requests[0].body) == {"kind": "train", "environment": "ant"}


def test_a_job_can_be_copied_and_sent_to_another_process() -> None:
    with scripted(lambda *_: job("succeeded")) as service:
        read = service.client.get(ID)
        for copied in (copy.deepcopy(read), pickle.loads(pickle.dumps(read))):  # noqa: S301
            assert copied.model_dump() == read.model_dump()
            assert copied.wait(timeout=5).succeeded
            copied._client.close()


def test_two_submissions_have_two_keys() -> None:
    with scripted(lambda *_: job("queued")) as service:
        service.client.submit(environment="ant")
        service.client.submit(environment="ant")
    assert len({request.headers["idempotency-key"] for request in service.requests}) == 2


def test_an_unavailable_service_is_asked_again_after_as_long_as_it_says() -> None:
    with scripted(lambda _, n: problem(503, {"Retry-After": "0"}) if n == 0 else job()) as service:
        assert service.client.get(ID).status == "running"
    assert len(service.requests) == 2


def test_an_unavailable_service_is_given_up_after_the_last_attempt() -> None:
    with scripted(lambda *_: problem(503, {"Retry-After": "7"})) as service:
        with pytest.raises(Unavailable) as caught:
            service.client.get(ID)
        assert caught.value.retry_after_s == 7
    assert len(service.requests) == QUICK.attempts


@pytest.mark.parametrize(
    ("status", "headers", "family"),
    [
        (404, {}, NotFound),
        (404, {"Retry-After": "5"}, NotReady),
        (409, {}, Conflict),
        (422, {}, Rejected),
        (413, {}, Rejected),
    ],
)
def test_a_refusal_is_raised_by_its_family_and_not_repeated(
    status: int, headers: dict[str, str], family: type[Exception]
) -> None:
    with scripted(lambda *_: problem(status, headers)) as service, pytest.raises(family) as caught:
        service.client.get(ID)
    assert type(caught.value) is family
    assert len(service.requests) == 1


def test_a_rejection_reads_as_its_sentence_and_its_places() -> None:
    errors = [{"pointer": "/seed", "detail": "must be ≥ 0"}, {"pointer": "", "detail": "too much"}]
    with scripted(lambda *_: problem(422, errors=errors)) as service, pytest.raises(Rejected) as caught:
        service.client.submit(environment="ant", seed=-1)
    assert str(caught.value) == "D.\n  /seed: must be ≥ 0\n  /: too much"
    assert (caught.value.type, caught.value.title, caught.value.errors[0].pointer) == (
        "/problems/x",
        "T",
        "/seed",
    )


def test_a_rejection_does_not_say_its_sentence_twice() -> None:
    errors = [{"pointer": "/seed", "detail": "D."}, {"pointer": "", "detail": "D."}]
    with scripted(lambda *_: problem(422, errors=errors)) as service, pytest.raises(Rejected) as caught:
        service.client.submit(environment="ant", seed=-1)
    assert str(caught.value) == "D.\n  at /seed"


def test_a_model_that_no_worker_reads_in_time_is_said_to_wait(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    model = {"id": "sha256:0", "status": "validating", "size": 9, "created_at": "2026-11-20T12:00:00Z"}
    with (
        scripted(lambda *_: Answer(200, json.dumps(model).encode())) as service,
        pytest.raises(WaitTimeout, match=r"No worker has read model sha256:0.*reads it after its job"),
    ):
        service.client.add_model(tmp_path / "robot.xml", timeout=0)


def test_an_error_page_of_a_proxy_is_a_refusal_too() -> None:
    with (
        scripted(lambda *_: Answer(403, b"<html>\nno</html>")) as service,
        pytest.raises(Rejected, match=r"403.*<html>"),
    ):
        service.client.get(ID)


def test_nobody_listening_is_a_sentence_that_says_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
    with (
        Client(url, retry=QUICK) as client,
        pytest.raises(Unreachable, match=r"No Gaitway service.*gaitway up"),
    ):
        client.get(ID)


def test_a_repeated_delete_that_finds_nothing_has_succeeded() -> None:
    with scripted(lambda _, before: None if before == 0 else problem(404)) as service:
        service.client.delete(ID)
    assert [request.method for request in service.requests] == ["DELETE", "DELETE"]


def test_events_go_on_after_a_broken_connection_without_gap_or_repetition() -> None:
    def script(request: Request, before: int) -> Answer:
        after = request.headers.get("last-event-id")
        if before == 0:
            assert after is None
            return Answer(200, event(1, "phase") + event(2, "progress", step=5)[:-1], announce=10_000)
        assert after == "1-0"  # the second was cut off, so it is not seen yet
        return Answer(200, event(2, "progress", step=5) + event(3, "status", status="succeeded"))

    with scripted(script) as service:
        events = list(service.client.events(ID))
    assert [(found.id, found.kind) for found in events] == [
        ("1-0", "phase"),
        ("2-0", "progress"),
        ("3-0", "status"),
    ]
    assert events[1].data == {"step": 5}


def test_events_of_a_job_that_ended_before_are_over() -> None:
    def script(request: Request, _: int) -> Answer:
        return Answer(204) if request.path.endswith("/events") else job("succeeded")

    with scripted(script) as service:
        assert list(service.client.events(ID, after="9-0")) == []
    assert service.requests[0].headers["last-event-id"] == "9-0"


def test_waiting_survives_a_stream_that_never_works_and_asks_for_the_job_instead() -> None:
    def script(request: Request, before: int) -> Answer:
        if request.path.endswith("/events"):
            return Answer(200)  # closes at once, each time
        return job("running" if before < 6 else "failed", reason="diverged")

    with scripted(script) as service:
        assert service.client.wait(ID, timeout=5).reason == "diverged"


def test_waiting_ends_at_its_time_and_leaves_the_job_alone() -> None:
    with scripted(lambda r, _: Answer(200) if r.path.endswith("/events") else job()) as service:
        began = time.monotonic()
        with pytest.raises(WaitTimeout, match=r"still running after 0\.1 s"):
            service.client.wait(ID, timeout=0.1)
        assert time.monotonic() - began < 10
        # Pauses of up to 10 ms between looks: far fewer than a busy loop would make.
        assert len(service.requests) < 60
    assert {request.method for request in service.requests} == {"GET"}


def test_a_service_that_stays_away_ends_the_following() -> None:
    with scripted(lambda *_: None) as service, pytest.raises(Unreachable):
        list(service.client.events(ID))


def test_a_followed_log_is_taken_up_again_behind_the_lines_that_were_seen() -> None:
    def script(request: Request, before: int) -> Answer:
        if "/logs" not in request.path:
            return job("succeeded")
        return Answer(200, b"one\ntwo\nth", announce=99) if before == 0 else Answer(200, b"one\ntwo\nthree\n")

    with scripted(script) as service:
        assert list(service.client.logs(ID, follow=True)) == ["one", "two", "three"]


def test_a_download_is_resumed_until_it_is_whole(tmp_path: Path) -> None:
    def script(request: Request, _: int) -> Answer:
        return ranged(request, BODY, 4000) if "artifacts/" in request.path else with_video()

    seen: list[tuple[int, int]] = []
    with scripted(script) as service:
        path = service.client.download(ID, "video.mp4", tmp_path, on_bytes=lambda *now: seen.append(now))
    assert path == tmp_path / "video.mp4"
    assert path.read_bytes() == BODY
    assert seen[-1] == (10_240, 10_240)
    # 10,240 bytes by at most 4,000 a connection.
    ranges = [r.headers.get("range") for r in service.requests if "artifacts/" in r.path]
    assert ranges == [None, "bytes=4000-", "bytes=8000-"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_server_without_ranges_starts_the_file_again(tmp_path: Path) -> None:
    def script(request: Request, before: int) -> Answer:
        if "artifacts/" not in request.path:
            return with_video()
        return Answer(200, BODY[:100], announce=len(BODY)) if before == 1 else Answer(200, BODY)

    with scripted(script) as service:
        assert service.client.video(ID, tmp_path / "v.mp4").read_bytes() == BODY


def test_a_spoilt_part_of_an_earlier_try_is_thrown_away(tmp_path: Path) -> None:
    part = tmp_path / f"v.mp4.{hashlib.sha256(BODY).hexdigest()[:8]}.part"
    part.write_bytes(b"x" * 50)
    with scripted(lambda r, _: ranged(r, BODY, 10**6) if "artifacts/" in r.path else with_video()) as service:
        assert service.client.video(ID, tmp_path / "v.mp4").read_bytes() == BODY


def test_a_file_with_another_hash_is_never_given_its_name(tmp_path: Path) -> None:
    def script(request: Request, _: int) -> Answer:
        return ranged(request, BODY, 10**6) if "artifacts/" in request.path else with_video(sha256="0" * 64)

    with scripted(script) as service, pytest.raises(DownloadFailed, match="SHA-256"):
        service.client.video(ID, tmp_path / "v.mp4")
    assert list(tmp_path.iterdir()) == []


def test_an_id_with_a_slash_stays_one_part_of_the_address() -> None:
    with scripted(lambda *_: problem(404)) as service, pytest.raises(NotFound):
        service.client.get("../x/y?z")
    assert service.requests[0].path == "/jobs/..%2Fx%2Fy%3Fz"


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://localhost"])
def test_an_address_without_http_is_refused_before_anything_is_sent(url: str) -> None:
    with pytest.raises(WrongAddress, match=f"^{url} is no address of a service: begin it with http://"):
        Client(url)
