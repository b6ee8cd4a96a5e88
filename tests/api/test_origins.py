"""What keeps a foreign page out of a service that has no accounts."""

import httpx
import pytest

from api.app import OriginCheck
from api.problems import CrossSiteRequest, UnknownHost
from tests.api.problems import problem

JOB = {"kind": "train", "environment": "ant"}


def refusal(origin_check: OriginCheck, **headers: str) -> object:
    said = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    return origin_check.refusal({"type": "http", "method": "GET", "headers": said})


@pytest.mark.parametrize(
    "host", ["localhost:8000", "127.0.0.1", "[::1]:8000", "192.168.1.7:8000", "LOCALHOST"]
)
def test_localhost_and_addresses_in_numbers_are_ours(host: str) -> None:
    assert refusal(OriginCheck(), host=host) is None


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8000", "localhost.evil.example", "", "["])
def test_a_name_that_was_not_allowed_is_refused(host: str) -> None:
    # DNS rebinding: evil.example leads to 127.0.0.1, and its page asks for its own name.
    assert isinstance(refusal(OriginCheck(), host=host), UnknownHost)


def test_a_name_that_was_allowed_is_ours() -> None:
    assert refusal(OriginCheck({"gaitway.lab"}), host="gaitway.lab:443") is None


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "null", "http://localhost:3000", "http://127.0.0.1:81"]
)
def test_a_page_from_elsewhere_is_refused(origin: str) -> None:
    assert isinstance(refusal(OriginCheck(), host="localhost:8000", origin=origin), CrossSiteRequest)


def test_our_own_page_and_that_of_an_allowed_name_are_welcome() -> None:
    assert refusal(OriginCheck(), host="localhost:8000", origin="http://localhost:8000") is None
    # Behind a proxy that asks for us by our address.
    assert refusal(OriginCheck({"gaitway.lab"}), host="127.0.0.1:8000", origin="https://gaitway.lab") is None


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_foreign_page_embeds_nothing_of_ours(site: str) -> None:
    asked = {"host": "localhost:8000", "sec_fetch_site": site}
    assert isinstance(refusal(OriginCheck(), **asked, sec_fetch_mode="no-cors"), CrossSiteRequest)
    # A link that a person follows.
    assert refusal(OriginCheck(), **asked, sec_fetch_mode="navigate") is None


@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", "/jobs"), ("POST", "/jobs"), ("POST", "/jobs/x/cancel"), ("DELETE", "/jobs/x")],
)
def test_a_foreign_page_neither_reads_nor_submits_nor_cancels(
    http: httpx.Client, method: str, path: str
) -> None:
    answer = http.request(method, path, json=JOB, headers={"Origin": "https://evil.example"})
    problem(answer, 403, "cross-site-request")
    answer = http.request(method, path, json=JOB, headers={"Host": "evil.example"})
    problem(answer, 421, "unknown-host")
    assert http.get("/jobs").json()["items"] == []
