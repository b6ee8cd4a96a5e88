"""Sentences for the object store's refusals; most of them are in tests/faults/test_misconfigured.py."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from core.adapters.s3.connection import connect_s3
from core.adapters.s3.errors import meaning
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.startup import exercise_objects
from core.adapters.wiring import object_store
from core.errors import Misconfigured, ObjectNotFound, StorageRefuses, StorageUnavailable
from core.settings import StoreSettings, WorkerSettings
from gaitway.service.embedded.weed import REGION, Weed


@pytest.fixture
def elsewhere(weed: Weed) -> S3ObjectStore:
    """A store whose bucket does not exist."""
    client = connect_s3(weed.endpoint, weed.access_key, weed.secret_key, secure=False, region=REGION)
    return S3ObjectStore(client, "elsewhere")


@contextmanager
def answering(status: int, body: bytes) -> Iterator[S3ObjectStore]:
    """A store that is none: an HTTP server that says this to everything."""

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        client = connect_s3(
            f"127.0.0.1:{server.server_port}", "a", "b", secure=False, region=REGION, retries=0
        )
        yield S3ObjectStore(client, "gaitway")
        server.shutdown()
        thread.join()


def settings_with(**changed: str) -> StoreSettings:
    values = {
        "database_url": "postgresql://unused",
        "redis_url": "unix:///unused",
        "s3_endpoint": "127.0.0.1:1",
        "s3_access_key": "a",
        "s3_secret_key": "b",
        "s3_region": REGION,
    }
    return StoreSettings.model_validate({**values, **changed})


@pytest.mark.parametrize("code", ["AuthorizationHeaderMalformed", "PermanentRedirect"])
def test_another_region_is_named(code: str) -> None:
    error = meaning(code, "expecting 'eu-1'", "walkers")
    assert isinstance(error, StorageRefuses)
    assert "GAITWAY_S3_REGION is not the region of bucket 'walkers'" in error.detail


def test_what_is_not_known_is_repeated_and_may_pass() -> None:
    error = meaning("SlowDown", "Reduce your request rate", "walkers")
    assert not isinstance(error, StorageRefuses)
    assert "(SlowDown): Reduce your request rate." in error.detail


def test_in_a_missing_bucket_nothing_is_merely_not_there(elsewhere: S3ObjectStore) -> None:
    for look in (elsewhere.get, elsewhere.info, elsewhere.list):
        with pytest.raises(StorageRefuses, match="there is no bucket 'elsewhere'"):
            look("a")


def test_a_head_that_is_refused_tells_why(weed: Weed) -> None:
    client = connect_s3(weed.endpoint, "nobody", weed.secret_key, secure=False, region=REGION)
    with pytest.raises(StorageRefuses, match="GAITWAY_S3_ACCESS_KEY is not known there"):
        S3ObjectStore(client, weed.bucket).info("a")


def test_in_a_bucket_that_is_there_a_missing_object_is_not_found(object_store: S3ObjectStore) -> None:
    with pytest.raises(ObjectNotFound):
        object_store.info("a")


def test_deleting_what_is_not_there_is_no_error(object_store: S3ObjectStore) -> None:
    object_store.put("b", b"x")
    object_store.delete(["a", "b"])
    assert list(object_store.list("")) == []


@pytest.mark.parametrize(("status", "body"), [(200, b"<html>Welcome</html>"), (200, b"hello"), (404, b"no")])
def test_a_server_that_is_no_object_store_is_refused(status: int, body: bytes) -> None:
    with (
        answering(status, body) as store,
        pytest.raises(StorageRefuses, match="is not an S3 server"),
    ):
        store.list("")


def test_a_proxy_before_a_store_that_is_away_is_an_outage() -> None:
    with answering(502, b"Bad Gateway") as store, pytest.raises(StorageUnavailable) as caught:
        store.list("")
    assert not isinstance(caught.value, StorageRefuses)
    assert "HTTP 502" in caught.value.detail


@pytest.mark.parametrize(
    ("style", "host"),
    [("path", "store.invalid"), ("auto", "store.invalid"), ("host", "gaitway.store.invalid")],
)
def test_the_bucket_is_part_of_the_host_s_name_where_that_is_asked_for(style: str, host: str) -> None:
    store = object_store(settings_with(s3_endpoint="store.invalid:1", s3_style=style), retries=0)
    with pytest.raises(StorageUnavailable, match=f" {host}:1 "):
        store.get("a")


@pytest.mark.parametrize("changed", [{"s3_endpoint": "h:99999"}, {"s3_bucket": "a b c"}])
def test_what_cannot_be_read_is_refused(changed: dict[str, str]) -> None:
    with pytest.raises(Misconfigured, match="GAITWAY_S3_"):
        object_store(settings_with(**changed))


class Forgetful(S3ObjectStore):
    """A store that gives back something else, as one behind a careless cache does."""

    def get(self, key: str) -> bytes:
        super().get(key)
        return b"stale"


class Protected(S3ObjectStore):
    """A store that takes objects and then refuses to read them."""

    def get(self, key: str) -> bytes:
        raise StorageRefuses("You may not read.")


@pytest.mark.parametrize(
    ("kind", "words"), [(Forgetful, "without a cache in front of it"), (Protected, "may not read")]
)
def test_a_probe_that_fails_leaves_nothing_behind(
    kind: type[S3ObjectStore], words: str, settings: WorkerSettings
) -> None:
    whole = object_store(settings)
    with pytest.raises(StorageRefuses, match=words):
        exercise_objects(kind(whole._client, settings.s3_bucket))
    assert list(whole.list("")) == []
