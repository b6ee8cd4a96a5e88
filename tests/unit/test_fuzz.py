"""Every parser of bytes that users send: whatever they are, it gives a result or one of its own errors."""
# ruff: noqa: PT017 - whether there is an error depends on the example

import io
import json
import string
import time
import zipfile
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as searching
from hypothesis import strategies as st
from pydantic import ValidationError

from api.app import OriginCheck
from api.files import is_known, requested_range
from api.problems import MalformedBody, RangeNotSatisfiable
from api.routes.jobs import JobListing
from api.submissions import EXAMPLES, fingerprint, parse
from core.accounts.principal import ANYONE
from core.adapters.postgres.listing import check_cursor
from core.adapters.postgres.store import PostgresJobStore
from core.configuration import read
from core.documents import read_leniently
from core.environments.mjcf.archive import MAX_TOTAL_BYTES, examine
from core.environments.mjcf.document import parse as parse_xml
from core.errors import BadModel, Misconfigured, Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import entry_number
from core.settings import ApiSettings, ReconcilerSettings, WorkerSettings
from core.variables import variable
from worker.protocol import MESSAGE

# The same examples each time; the stores and patches of a test serve all of its examples.
fuzzed = searching(
    max_examples=100,
    derandomize=True,
    database=None,
    deadline=2000,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

_TEXT = st.text(max_size=40) | st.text(string.ascii_letters + string.digits + "_.-:=/,", max_size=40)
_NUMBERS = st.integers() | st.sampled_from([2**31, 2**63, 2**64, 10**400, -(10**400)]) | st.floats()
_JSON = st.recursive(
    st.none() | st.booleans() | _NUMBERS | _TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_TEXT, inner, max_size=4),
    max_leaves=10,
)
_FULL: dict[str, Any] = {
    "kind": "train",
    "environment": {"id": "corridor", "options": {"walker": "rodent"}},
    "randomization": [{"field": "geom_friction", "range": [0.6, 1.4], "axis": 0, "names": ["floor"]}],
    "resume_from": {"job": "019aa3c2f0b1-5be0c1d2e3", "step": 1},
    "tracking": {"wandb": {"project": "gaits"}},
    "video": {"cameras": ["track", 0]},
    "algorithm": {"kind": "ppo", "num_envs": 256, "policy_hidden_layer_sizes": [32, 32]},
}
_Q_LEARNING: dict[str, Any] = {
    "kind": "train",
    "environment": {"id": "brittle_star", "options": {}},
    "algorithm": {"kind": "q_learning", "epsilon": {"start": 1.0}, "action_set": {"kind": "leading_arm"}},
}
_SAC: dict[str, Any] = {
    "kind": "train",
    "environment": {"id": "ant", "options": {}},
    "algorithm": {"kind": "sac", "max_replay_size": 10_000, "value_min": -10.0, "q_hidden_layer_sizes": [32]},
}
_DQN: dict[str, Any] = {
    "kind": "train",
    "environment": {"id": "brittle_star", "options": {}},
    "algorithm": {"kind": "dqn", "epsilon": {"shape": "exponential"}, "action_set": {"kind": "arm_roles"}},
}
_DOCUMENTS = [*(example["value"] for example in EXAMPLES.values()), _FULL, _Q_LEARNING, _SAC, _DQN]


@st.composite
def _nearly_a_job(draw: st.DrawFn) -> Any:
    """A good document with one place of it changed, removed, or filled twice as deep."""
    document: Any = deepcopy(draw(st.sampled_from(_DOCUMENTS)))
    place, step = document, draw(st.sampled_from(list(document)))
    while isinstance(place[step], dict | list) and place[step] and draw(st.booleans()):
        place = place[step]
        step = draw(st.sampled_from(list(place) if isinstance(place, dict) else list(range(len(place)))))
    match draw(st.integers(0, 3)):
        case 0:
            del place[step]
        case 1 if isinstance(place, dict):
            place[draw(_TEXT)] = draw(_JSON)
        case _:
            place[step] = draw(_JSON)
    return document


@fuzzed
@given(document=_nearly_a_job())
def test_a_job_is_parsed_and_checked_or_rejected(job_store: PostgresJobStore, document: Any) -> None:
    body = json.dumps(document).encode()
    try:
        spec = parse(body, JOB_SPEC)
        assert fingerprint(spec) == fingerprint(parse(body, JOB_SPEC))
        check(spec, job_store)
    except (Rejected, MalformedBody) as refusal:
        assert refusal.problems
        assert len(refusal.detail) < 20_000


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 900_000,
        b'{"a":' * 150_000,
        b'{"kind":"train","environment":{"id":"ant","options":' + b"[" * 150 + b"]" * 150 + b"}}",
        b'{"kind":"train","environment":"ant","seed":1' + b"0" * 900_000 + b"}",
        b'{"kind":"train","environment":"ant","labels":{'
        + b",".join(b'"a%d":"1"' % number for number in range(60_000))
        + b"}}",
        b'{"kind":"train","environment":"ant",'
        + b",".join(b'"a%d":1' % number for number in range(60_000))
        + b"}",
        b'"' + b"\\ud800" * 100_000 + b'"',
    ],
    ids=["arrays", "objects", "options", "a number", "labels", "fields", "surrogates"],
)
def test_the_longest_bodies_are_parsed_in_a_moment(body: bytes) -> None:
    began = time.thread_time()  # Without what other tests take of the cores.
    with pytest.raises((Rejected, MalformedBody)):
        parse(body, JOB_SPEC)
    assert time.thread_time() - began < 2


@fuzzed
@given(text=_nearly_a_job().map(json.dumps) | st.text(max_size=60))
def test_a_stored_specification_is_read_or_a_value_error(text: str) -> None:
    try:
        spec = read_leniently(text, JOB_SPEC)
    except ValueError:
        return
    assert JOB_SPEC.validate_python(spec) == spec


@pytest.mark.parametrize("text", ["[" * 100_000, '{"kind":"train","x":' + "[" * 300 + "]" * 300 + "}"])
def test_a_stored_specification_of_any_depth_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match="recursion limit"):
        read_leniently(text, JOB_SPEC)


@fuzzed
@given(
    asked=st.fixed_dictionaries(
        {},
        optional={
            "status": st.sampled_from(["failed", "running", "lost"]),
            "kind": st.sampled_from(["train", "rollout", "walk"]),
            "environment": _TEXT,
            "name": _TEXT,
            "label": st.lists(_TEXT | st.tuples(_TEXT, _TEXT).map(":".join), max_size=3),
            "cursor": _TEXT | st.from_regex(r"[0-9a-f]{12}-[0-9a-f]{10}\s?"),
            "limit": st.integers().map(str),
        },
    )
)
def test_a_listing_is_given_or_its_filters_are_rejected(
    job_store: PostgresJobStore, asked: Mapping[str, Any]
) -> None:
    try:
        wanted = JobListing.model_validate(asked)
        found = job_store.list(wanted.query(ANYONE), cursor=wanted.cursor, limit=wanted.limit)
    except (ValidationError, Rejected):
        return
    assert not found.jobs


@fuzzed
@given(text=_TEXT)
def test_a_cursor_and_the_id_of_an_event_are_taken_or_rejected(text: str) -> None:
    for take in (check_cursor, entry_number):
        try:
            found = take(text)
        except Rejected as refusal:
            assert refusal.problems
        else:
            assert str(found).lstrip("0") == text.lstrip("0") or (found, text) == (0, text)


_RANGES = st.one_of(
    _TEXT,
    st.from_regex(r"\Abytes ?= ?\d{0,25}-\d{0,25}(,.{0,5})?\Z"),
    st.tuples(st.integers(0, 60), st.integers(0, 60)).map(lambda ends: f"bytes={ends[0]}-{ends[1]}"),
)


@fuzzed
@given(asked=_RANGES, size=st.integers(0, 50), known=_TEXT)
def test_a_range_lies_within_the_file(asked: str, size: int, known: str) -> None:
    is_known({"if-none-match": known}, '"etag"')
    try:
        found = requested_range({"range": asked, "if-range": '"etag"'}, size, '"etag"')
    except RangeNotSatisfiable:
        return
    assert found is None or (found.length > 0 and 0 <= found.start <= size - found.length)


_HEADERS = st.binary(max_size=40) | st.sampled_from([b"http://[", b"http://[::1", b"//:99999", b"null", b"["])


@fuzzed
@given(host=_HEADERS, origin=_HEADERS)
def test_no_host_and_no_origin_breaks_the_check_of_origins(host: bytes, origin: bytes) -> None:
    headers = [(b"host", host), (b"origin", origin)]
    assert OriginCheck().refusal({"type": "http", "headers": headers}) is not None
    assert OriginCheck().refusal({"type": "http", "headers": [(b"host", b"[::1]"), headers[1]]}) is not None


_XML = st.sampled_from(
    [
        b"<mujoco><worldbody/></mujoco>",
        b'<mujoco><compiler meshdir="m"/><asset><mesh name="a" file="a.stl"/></asset></mujoco>',
        b'<mujoco><include file="other.xml"/></mujoco>',
        b'<robot name="r"><link name="l"><visual><geometry><mesh filename="package://a.stl"/>'
        b"</geometry></visual></link></robot>",
    ]
)


@st.composite
def _damaged(draw: st.DrawFn, whole: st.SearchStrategy[bytes]) -> bytes:
    """With some bytes changed, and perhaps cut short."""
    body = bytearray(draw(whole))
    for _ in range(draw(st.integers(0, 4))):
        body[draw(st.integers(0, len(body) - 1))] = draw(st.integers(0, 255))
    return bytes(body[: draw(st.integers(0, len(body)) | st.just(len(body)))])


@st.composite
def _zipped(draw: st.DrawFn) -> bytes:
    names = _TEXT | st.sampled_from(["model.xml", "other.xml", "m/a.stl", "../x.xml", "a.stl", "/etc/x.urdf"])
    files = draw(st.dictionaries(names, _XML | st.binary(max_size=20), min_size=1, max_size=4))
    body = io.BytesIO()
    with zipfile.ZipFile(
        body, "w", draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))
    ) as packed:
        for name, content in files.items():
            packed.writestr(name.partition("\0")[0] or "x", content)
    return body.getvalue()


@fuzzed
@given(body=_damaged(_XML) | _damaged(_zipped()) | _zipped() | st.binary(max_size=60).map(b"PK\3\4".__add__))
def test_a_model_is_examined_or_bad(body: bytes) -> None:
    try:
        found = examine(body)
    except BadModel as refusal:
        assert 0 < len(refusal.detail) < 2000
    else:
        assert found.main in found.names


@fuzzed
@given(body=_damaged(_XML) | st.binary(max_size=60))
def test_a_document_is_parsed_or_bad(body: bytes) -> None:
    try:
        parse_xml("model.xml", body)
    except BadModel as refusal:
        assert refusal.detail


def test_the_worst_zips_are_refused_in_a_moment() -> None:
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as packed:
        for number in range(1 + MAX_TOTAL_BYTES // 2**24):
            packed.writestr(f"{number}.stl", bytes(2**24))
    many = b"PK\3\4" + b"PK\1\2" * 1_000_000
    quotes = b"<mujoco " + b" ".join(b'a%d=""' % number for number in range(200_000)) + b"/>"
    began = time.thread_time()
    for body in (bomb.getvalue(), many, b"<a>" * 1_000_000):
        with pytest.raises(BadModel):
            examine(body)
    examine(quotes)
    assert time.thread_time() - began < 2


@fuzzed
@given(
    line=st.binary(max_size=60)
    | _JSON.map(lambda said: json.dumps(said).encode())
    | st.fixed_dictionaries(
        {"type": st.sampled_from(["hello", "started", "progress", "metrics", "file", "note", "failed"])},
        optional={
            name: _JSON
            for name in (
                "pid",
                "device",
                "engine",
                "details",
                "step",
                "total",
                "values",
                "name",
                "role",
                "text",
            )
        },
    ).map(lambda said: json.dumps(said).encode())
)
def test_a_message_of_the_training_is_understood_or_passed_over(line: bytes) -> None:
    try:
        MESSAGE.validate_json(line)
    except ValidationError as error:
        assert error.errors()


_VALUES = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=30)


@fuzzed
@given(changed=st.data())
@pytest.mark.parametrize("kind", [ApiSettings, WorkerSettings, ReconcilerSettings])
def test_settings_are_read_or_misconfigured(
    kind: Any, changed: st.DataObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = {
        "database_url": "postgresql:///unused",
        "redis_url": "unix:///unused",
        "s3_endpoint": "unused",
        "s3_access_key": "unused",
        "s3_secret_key": "unused",
        "data_dir": "/unused",
    }
    name = changed.draw(st.sampled_from(sorted(kind.model_fields)))
    addresses = st.sampled_from(["postgresql://[", "redis://[::1", "redis://:@h:99999999/x", "http://["])
    durations = st.sampled_from(["28800000000000", "1e300", "nan", "P1Y", "-1"])
    value = changed.draw(_VALUES | _NUMBERS.map(str) | addresses | durations)
    with monkeypatch.context() as patch:
        for field, said in {**good, name: value}.items():
            patch.setenv(variable(field), said)
        try:
            read(kind)
        except Misconfigured as error:
            assert variable(name) in error.detail or name in ("lease", "heartbeat", "reconcile_every")
