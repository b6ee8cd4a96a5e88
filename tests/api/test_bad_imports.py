"""The service refuses bad and too large exports, says why, and keeps nothing of them."""

import io
import json
import socket
import struct
import tempfile
from contextlib import suppress
from pathlib import Path
from zipfile import ZIP_BZIP2, ZipFile

import pytest

from tests.api.conftest import Stack
from tests.api.exports import Change, bring, changed, edit, sent_in_pieces, with_file, without
from tests.api.problems import problem
from tests.extra import extra

_ATTEMPT = {"number": 1, "worker": "w", "started_at": "2026-11-20T12:00:00Z"}


def _row(first: int, number: int) -> bytes:
    """A line of metrics with so many names."""
    values = {f"m{name}": 0.5 for name in range(first, first + number)}
    return json.dumps({"step": first, "time": "2026-11-20T12:00:00Z", "values": values}).encode() + b"\n"


BAD: dict[str, tuple[Change, str]] = {
    "no spec.json": (without("spec.json"), "The zip has no spec.json"),
    "no contents.json": (without("contents.json"), "The zip has no contents.json"),
    "no log": (without("log.txt"), "The zip has no log.txt"),
    "no checkpoint": (
        without("files/checkpoint-200.ckpt"),
        "The zip has no files/checkpoint-200.ckpt",
    ),
    "another hash": (
        with_file("files/policy", b"polity"),
        "files/policy does not have the SHA-256",
    ),
    "another size": (
        with_file("files/policy", b"policy."),
        "files/policy has 7 bytes, and contents.json says 6",
    ),
    "not in the record": (edit("job.json", artifacts=[]), "job.json does not name files/policy"),
    "not listed": (with_file("files/more", b""), "contents.json does not list files/more"),
    "not JSON": (with_file("job.json", b"{"), "job.json is not that of an export"),
    "a number too long": (edit("job.json", created_at="0001-01-01T00:00:00Z"), "created_at"),
    "unknown status": (
        edit("job.json", status="dreaming"),
        "does not know 'dreaming', which job.json has at status",
    ),
    "a header": (edit("job.json", artifacts__0__media_type="a/b\r\nX: y"), "artifacts/0/media_type"),
    "a path as a name": (edit("job.json", artifacts__0__name="../x"), "artifacts/0/name"),
    "metrics": (
        with_file("metrics.jsonl", b'{"step": -1}\n'),
        "metrics.jsonl, line 1, is not that of an export: step",
    ),
    "a long line": (with_file("log.txt", bytes(2**18)), "log.txt has a line of more than"),
    "U+0000": (edit("job.json", attempts__0__worker="a\0b"), "The record of the job cannot be stored"),
    # H2: an import's record had no bounds, and every listing carried it.
    "a long message": (
        edit("job.json", message="x" * 4001),
        "job.json is not that of an export: message: `message` has 4,001 characters; at most 4,000",
    ),
    "large details": (
        edit("job.json", attempts__0__details={"a": "x" * 2**16}),
        "attempts/0/details: `details`: has 65,544 bytes as JSON; at most 65,536 are allowed.",
    ),
    "many attempts": (
        edit("job.json", attempts=[_ATTEMPT] * 201),
        "attempts: `attempts` has 201 items; at most 200 are allowed.",
    ),
    "a large record": (with_file("job.json", bytes(2**20 + 1)), "job.json is longer than 1,048,576 bytes."),
    "a large specification": (edit("job.json", spec={"a": "x" * 2**17}), "at most 131,072 are allowed."),
    # H3: names of metrics had none, and the reconciler and the curves hold each.
    "many names in a row": (
        with_file("metrics.jsonl", _row(0, 501)),
        "metrics.jsonl, line 1, is not that of an export: values: `values` has 501 items; at most 500",
    ),
    "a long name": (
        with_file("metrics.jsonl", _row(0, 1).replace(b"m0", b"m" * 201)),
        "has 201 characters; at most 200 are allowed.",
    ),
    "many names": (
        with_file("metrics.jsonl", b"".join(_row(400 * row, 400) for row in range(6))),
        "metrics.jsonl has 2,400 names of metrics in its first 6 lines; at most 2,000 are allowed.",
    ),
    "many sets of names": (
        with_file("metrics.jsonl", b"".join(_row(0, row + 1) for row in range(201))),
        "metrics.jsonl has 201 sets of names in its first 201 lines; at most 200 are allowed.",
    ),
    # A zip of a few MiB held gigabytes of text.
    "many values": (
        with_file("metrics.jsonl", b"".join(_row(0, 500) for _ in range(2001))),
        "metrics.jsonl has more than 1,000,000 values in its first 2,001 lines; at most that many are",
    ),
    "a large log": (
        with_file("log.txt", (b"x" * 60_000 + b"\n") * 1200),
        "log.txt has more than 67,108,864 bytes in its first 1,119 lines; at most that many are allowed.",
    ),
    "a newer format": (edit("contents.json", format=2), "A newer version of Gaitway wrote this export"),
    "an unknown field": (
        edit("job.json", spec__gravity=0),
        "This version of Gaitway does not accept the job's specification",
    ),
    "an unknown environment": (edit("job.json", spec__environment="yeti"), "no environment 'yeti'"),
    "an unknown option": (
        edit("job.json", spec__environment={"id": "ant", "options": {"wings": 2}}),
        "This service cannot have the job",
    ),
    "unknown hyperparameters": (
        edit("job.json", attempts__0__details={"hyperparameters": {"kind": "alchemy"}}),
        "does not know the hyperparameters",
    ),
    "a model": (
        edit("job.json", spec__environment={"id": "mjcf", "options": {"model": f"sha256:{'0' * 64}"}}),
        "which this service does not have: unpack the zip, send the model by `gaitway models add model/*`",
    ),
    "a path up": (with_file("files/../../x", b""), "a file 'files/../../x'"),
    "an absolute path": (with_file("/etc/passwd", b""), "a file '/etc/passwd'"),
    "a path of Windows": (with_file("files\\x", b""), "an export has no such name"),
}


@pytest.mark.parametrize(
    "what", [*list(BAD)[::3], *extra(*(what for number, what in enumerate(BAD) if number % 3))]
)
def test_what_is_no_whole_export_is_refused_and_leaves_nothing(
    stack: Stack, exported: bytes, what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    change, sentence = BAD[what]
    document = problem(bring(stack.http, changed(exported, change)), 422, "bad-export")
    assert sentence in document["detail"]
    assert stack.is_empty()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("cut", [0, 1, 22, 1000])
def test_a_part_of_a_zip_is_refused(stack: Stack, exported: bytes, cut: int) -> None:
    for archive in (exported[:cut], exported[: len(exported) - 1 - cut]):
        document = problem(bring(stack.http, archive), 422, "bad-export")
        assert "This is not a zip file, or only a part of one" in document["detail"]
    assert stack.is_empty()


def test_a_zip_with_a_flipped_byte_is_refused(stack: Stack, exported: bytes) -> None:
    place = exported.index(b"files/video.mp4") + 2**20
    flipped = exported[:place] + bytes([exported[place] ^ 1]) + exported[place + 1 :]
    document = problem(bring(stack.http, flipped), 422, "bad-export")
    assert "Bad CRC-32 for file 'files/video.mp4'" in document["detail"]
    assert stack.is_empty()


def test_a_zip_that_unpacks_to_too_much_is_refused_whatever_it_declares(
    stack: Stack, exported: bytes
) -> None:
    limit = 2**22
    stack.service.settings = stack.service.settings.model_copy(update={"max_import_bytes": limit})
    archive = changed(exported, with_file("log.txt", b"\n" * limit))
    assert len(archive) < limit
    document = problem(bring(stack.http, archive), 422, "bad-export")
    assert f"this service accepts {limit:,}" in document["detail"]
    # The directory says that the log has one byte; the 32-bit size stands 24 bytes into its entry.
    entry = archive.rindex(b"PK\x01\x02", 0, archive.rindex(b"log.txt"))
    lying = archive[: entry + 24] + struct.pack("<L", 1) + archive[entry + 28 :]
    document = problem(bring(stack.http, lying), 422, "bad-export")
    assert "The zip is damaged" in document["detail"]
    document = problem(bring(stack.http, bytes(limit + 1)), 413, "body-too-large")
    assert document["limit_bytes"] == limit
    assert stack.is_empty()


def test_a_directory_of_a_million_entries_is_not_read(stack: Stack) -> None:
    # An entry of the least length, again and again: 46 bytes, a million times.
    entries = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", *[0] * 16) * 10**4
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, 100 * len(entries), 0, 0)
    answer, peak = sent_in_pieces(stack, [*[entries] * 100, end])
    assert "its directory is too long" in problem(answer, 422, "bad-export")["detail"]
    assert peak < 2**24


def test_another_kind_of_compression_and_a_name_twice_are_refused(stack: Stack, exported: bytes) -> None:
    out = io.BytesIO()
    with ZipFile(out, "w", ZIP_BZIP2) as archive:
        archive.writestr("spec.json", b"{}")
    document = problem(bring(stack.http, out.getvalue()), 422, "bad-export")
    assert "compressed in another way" in document["detail"]
    twice = io.BytesIO(exported)
    with ZipFile(twice, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("spec.json", b"{}")
    assert (
        "two files of the same name"
        in problem(bring(stack.http, twice.getvalue()), 422, "bad-export")["detail"]
    )
    assert stack.is_empty()


def test_a_body_of_another_type_is_refused(stack: Stack, exported: bytes) -> None:
    answer = bring(stack.http, exported, **{"Content-Type": "application/json"})
    document = problem(answer, 415, "unsupported-media-type")
    assert "Send an export as application/zip" in document["detail"]


def test_no_more_than_two_are_imported_at_once(stack: Stack, exported: bytes) -> None:
    stack.service.num_imports = 2
    answer = bring(stack.http, exported)
    assert problem(answer, 429, "too-many-imports")["most"] == 2
    assert answer.headers["retry-after"] == "5"
    stack.service.num_imports = 0
    assert bring(stack.http, exported).status_code == 201
    assert stack.service.num_imports == 0


def test_an_upload_that_stops_coming_gives_its_place_up(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.submissions._LONGEST_PAUSE_S", 0.2)
    head = (
        f"POST /jobs/import HTTP/1.1\r\nHost: 127.0.0.1:{stack.port}\r\n"
        "Content-Type: application/zip\r\nContent-Length: 1000\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", stack.port), timeout=10) as connection:
        connection.sendall(head.encode() + b"PK")
        answer = connection.recv(2**16)
    assert answer.startswith(b"HTTP/1.1 422")
    assert b"stopped coming" in answer
    assert stack.service.num_imports == 0


def test_an_upload_that_comes_too_slowly_gives_its_place_up(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """M10: a byte before each pause ends kept a place for ever."""
    monkeypatch.setattr("api.submissions._LONGEST_PAUSE_S", 0.5)
    head = (
        f"POST /jobs/import HTTP/1.1\r\nHost: 127.0.0.1:{stack.port}\r\n"
        "Content-Type: application/zip\r\nContent-Length: 1000\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", stack.port), timeout=0.1) as connection:
        connection.sendall(head.encode())
        answer = b""
        for _ in range(100):
            connection.sendall(b"P")
            with suppress(TimeoutError):
                answer = connection.recv(2**16)
                break
    assert answer.startswith(b"HTTP/1.1 422")
    assert b"came too slowly" in answer
    assert stack.service.num_imports == 0
