"""Models and workers page by page, over HTTP and by the client."""

from datetime import timedelta

import pytest

from core.adapters.postgres import listing
from core.jobs.workers import WorkerInfo
from core.user_models.record import ModelRecord
from gaitway import Client
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.problems import pointers, problem

NAMES = [f"w{number:02}" for number in range(60)]
IDS = [f"sha256:{number:064x}" for number in range(60)]


@pytest.fixture
def workers(stack: Stack) -> None:
    """More than a page of them."""
    for name in NAMES:
        worker = WorkerInfo(name=name, host="h", pid=1, device="cpu", started_at=NOON, seen_at=NOON)
        stack.store.announce(worker, timedelta(minutes=1))


@pytest.fixture
def models(stack: Stack) -> None:
    """More than a page of them, sent one second after the other."""
    for second, model_id in enumerate(IDS):
        at = NOON + timedelta(seconds=second)
        record = ModelRecord(id=model_id, status="ready", media_type="application/xml", size=7, created_at=at)
        stack.store.models.add(record)


@pytest.mark.usefixtures("workers")
def test_workers_come_by_name_and_without_a_cursor_fifty_of_them(stack: Stack) -> None:
    first = stack.http.get("/workers").json()
    assert ([item["name"] for item in first["items"]], first["next"]) == (NAMES[:50], "w49")
    rest = stack.http.get("/workers", params={"cursor": first["next"]}).json()
    assert ([item["name"] for item in rest["items"]], rest["next"]) == (NAMES[50:], None)
    assert len(stack.http.get("/workers", params={"limit": 7}).json()["items"]) == 7


@pytest.mark.usefixtures("models")
def test_models_come_newest_first_and_without_a_cursor_fifty_of_them(stack: Stack) -> None:
    first = stack.http.get("/models").json()
    rest = stack.http.get("/models", params={"cursor": first["next"]}).json()
    assert [item["id"] for item in first["items"] + rest["items"]] == IDS[::-1]
    assert (len(first["items"]), rest["next"]) == (50, None)


@pytest.mark.usefixtures("workers", "models")
def test_the_client_reads_on_until_the_end_or_its_limit(stack: Stack) -> None:
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        assert [one.name for one in client.workers()] == NAMES
        assert [one.name for one in client.workers(limit=2)] == NAMES[:2]
        assert [one.id for one in client.models()] == IDS[::-1]
        assert [one.id for one in client.models(limit=2)] == IDS[:-3:-1]


@pytest.mark.parametrize("path", ["/workers", "/models"])
@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ("limit=0", "/limit"),
        ("limit=201", "/limit"),
        ("crusor=a", "/crusor"),
        ("cursor=", "/cursor"),
        ("cursor=%00", "/cursor"),
        ("cursor=" + "9" * 300, "/cursor"),
    ],
)
def test_another_part_is_refused_with_its_place(stack: Stack, path: str, query: str, pointer: str) -> None:
    document = problem(stack.http.get(f"{path}?{query}"), 422, "invalid-request")
    assert pointers(document) == [pointer]


def test_a_models_id_is_no_cursor_and_the_refusal_says_what_to_do(stack: Stack) -> None:
    document = problem(stack.http.get("/models", params={"cursor": IDS[0]}), 422, "invalid-request")
    assert "leave it out to begin with the first page" in document["detail"]


def test_a_page_of_long_records_ends_early_and_leads_on(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H2: 50 imports made `GET /jobs` 786 MB long, and of models 200 were a gigabyte."""
    monkeypatch.setattr(listing, "_MOST_BYTES", 1000)
    for number in range(9):
        stack.store.add(job(f"{number:012x}-0000000000", name=f"{number}" * 200))
    for asked, most in (({}, 4), ({"search": "000"}, 1)):
        found, cursor = list[str](), ""
        while cursor is not None:
            page = stack.http.get("/jobs", params={**asked, **({"cursor": cursor} if cursor else {})}).json()
            assert 1 <= len(page["items"]) <= most
            found += [item["name"][0] for item in page["items"]]
            cursor = page["next"]
        assert found == ["0"] if most == 1 else sorted("012345678", reverse=True) == found


def test_a_listing_has_the_newest_attempts_and_files_in_brief(stack: Stack) -> None:
    """H2: every listing carried all that a record says at length about itself."""
    attempt = Attempt(stack, job())
    attempt.claim.start(details={"long": "x" * 5000})
    for step in range(12):
        attempt.keep(f"{step}.ckpt", b"", role="checkpoint", step=step, metadata={"long": "x" * 90 * step})
    [listed] = stack.http.get("/jobs").json()["items"]
    whole = stack.http.get(f"/jobs/{attempt.id}").json()
    assert [one["details"] for one in listed["attempts"]] == [{}]
    assert whole["attempts"][0]["details"]["long"] == "x" * 5000
    assert [file["step"] for file in listed["artifacts"]] == list(range(7, 12))
    assert len(whole["artifacts"]) == 5
    assert [bool(file["metadata"]) for file in listed["artifacts"]] == [True] * 4 + [False]


def test_a_sorted_list_is_read_page_by_page(stack: Stack) -> None:
    for number, arm in enumerate(("b", "c", "a")):
        stack.store.add(job(f"{number:012x}-0000000000", name=f"{number}" * 200, labels={"arm": arm}))
    query = {"sort": "label:arm", "order": "asc", "limit": 2}
    first = stack.http.get("/jobs", params=query).json()
    rest = stack.http.get("/jobs", params={**query, "cursor": first["next"]}).json()
    assert [item["labels"]["arm"] for item in (*first["items"], *rest["items"])] == ["a", "b", "c"]
    # The longest name is a part of the cursor, and the greatest comes first where nothing else is said.
    first = stack.http.get("/jobs?sort=name&limit=2").json()
    rest = stack.http.get("/jobs", params={"sort": "name", "limit": 2, "cursor": first["next"]}).json()
    assert [item["name"][0] for item in (*first["items"], *rest["items"])] == ["2", "1", "0"]
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        found = client.list(sort="label:arm", labels={"arm": "b"})
        assert [one.labels["arm"] for one in found] == ["b"]


@pytest.mark.parametrize(
    ("query", "pointer", "hint"),
    [
        ("sort=retrun", "/sort", "did you mean `return`?"),
        ("sort=", "/sort", "choose one of created, "),
        ("sort=label:", "/sort", "a key of letters"),
        ("order=asc", "/order", "say by which column"),
        ("sort=name&order=up", "/order", "'asc' or 'desc'"),
        ("sweep=mine", "/sweep", "`none` or `folded`"),
        ("sort=name&cursor=019aa3c2f0b1-5be0c1d2e3", "/cursor", "leave it out"),
        ("cursor=sorted-AAAA", "/cursor", "leave it out"),
    ],
)
def test_a_wrong_order_is_refused_with_its_place(stack: Stack, query: str, pointer: str, hint: str) -> None:
    document = problem(stack.http.get(f"/jobs?{query}"), 422, "invalid-request")
    assert pointers(document) == [pointer]
    assert hint in document["errors"][0]["detail"]
