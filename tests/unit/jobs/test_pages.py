"""The jobs that the pages give to paste."""

import re
from pathlib import Path

import pytest

from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore

PAGES = Path(__file__).parents[3] / "docs"
# Of a model of the reader's own: tests/unit/environments/mjcf/test_check.py holds it to its model.
JOBS = [
    job
    for page in sorted(PAGES.rglob("*.md"))
    for job in re.findall(r"-d '(\{\"kind\"[^']*\})'", page.read_text())
    if '"mjcf"' not in job
]


@pytest.mark.parametrize("job", JOBS)
def test_a_job_of_the_pages_is_one(job: str, jobs: JobStore) -> None:
    check(JOB_SPEC.validate_json(job), jobs)


def test_the_pages_have_a_job_for_each_family_of_environments() -> None:
    asked = " ".join(JOBS)
    for environment in ("ant", "rodent", "corridor", "brittle_star", "playground/CheetahRun", "brax/"):
        assert environment in asked
