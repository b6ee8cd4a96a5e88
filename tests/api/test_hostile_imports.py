"""Whatever an import holds: it is refused and leaves nothing, or it is a job like another."""

import time

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.api.conftest import Stack
from tests.api.exports import bring
from tests.faults.campaign.hostile_imports import PARTS, archives

_MOST_CPU_S = 2.0
_NUMBER = 20


def test_a_hostile_import_is_refused_whole_or_is_a_job_like_another(stack: Stack, exported: bytes) -> None:
    """H2, H3, and all of their kind."""
    for job in stack.http.get("/jobs").json()["items"]:
        assert stack.http.delete(f"/jobs/{job['id']}").status_code == 204
    accepted = list[bool]()

    @settings(
        max_examples=_NUMBER,
        database=None,
        deadline=None,
        suppress_health_check=[
            HealthCheck.too_slow,
            HealthCheck.data_too_large,
            HealthCheck.large_base_example,
        ],
    )
    @given(data=st.data())
    def send(data: st.DataObject) -> None:
        archive = data.draw(archives(exported))
        before = time.process_time()
        answer = bring(stack.http, archive)
        accepted.append(answer.status_code == 201)
        if answer.status_code == 201:
            _is_like_another(stack, answer.json()["id"])
        else:
            assert answer.status_code == 422, answer.text[:500]
            problem = answer.json()
            assert problem["detail"].endswith((".", "?"))
            assert problem["errors"][0]["detail"]
            assert len(answer.content) < 20_000
        assert time.process_time() - before < _MOST_CPU_S
        assert stack.is_empty()  # Nothing is half stored.
        assert stack.http.get("/healthz").status_code == 200

    send()
    print(f"{len(accepted)} hostile imports: {sum(accepted)} accepted, the others refused.")
    assert len(accepted) >= _NUMBER


def _is_like_another(stack: Stack, job_id: str) -> None:
    """Every part of it can be read, and it can be deleted."""
    listed = stack.http.get("/jobs")
    assert [job["id"] for job in listed.json()["items"]] == [job_id]
    for part in PARTS:
        answer = stack.http.get(f"/jobs/{job_id}{part}")
        assert answer.status_code == 200, (part, answer.text[:300])
    assert stack.http.delete(f"/jobs/{job_id}").status_code == 204
