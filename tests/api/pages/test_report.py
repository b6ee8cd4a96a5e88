"""A report as people get it: a file on their disk, opened without a service."""

import shutil
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import MakeTab, Tab
from tests.api.pages.test_job_view import measure
from tests.unit.rendering.films import film

EVIL = '<img src=x onerror="document.title=1">'


def saved(stack: Stack, job_id: str, folder: Path) -> str:
    """The address of the report as a file."""
    path = folder / f"{job_id}.html"
    path.write_bytes(stack.http.get(f"/jobs/{job_id}/report.html").content)
    return path.as_uri()
