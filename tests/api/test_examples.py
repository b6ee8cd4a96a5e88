"""The examples' jobs are what the service takes."""

import runpy
from pathlib import Path
from typing import Any

import pytest

from tests.api.conftest import Stack

EXAMPLES = sorted(Path(__file__).parents[2].glob("examples/*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_examples_job_is_accepted(stack: Stack, path: Path) -> None:
    names: dict[str, Any] = runpy.run_path(str(path))
    answer = stack.http.post("/jobs", json=names["JOB"])
    assert answer.status_code == 202, answer.text


JOBS = sorted(Path(__file__).parents[2].glob("examples/*.json"))


@pytest.mark.parametrize("path", JOBS, ids=[path.stem for path in JOBS])
def test_a_job_that_lies_beside_them_is_accepted(stack: Stack, path: Path) -> None:
    answer = stack.http.post("/jobs", content=path.read_bytes(), headers={"content-type": "application/json"})
    assert answer.status_code == 202, answer.text
