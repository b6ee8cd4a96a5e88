"""The commit that an attempt's record names."""

import subprocess
from pathlib import Path

import pytest

from worker.host.commit import commit_here


def test_an_attempt_names_the_commit_of_its_code() -> None:
    root = Path(__file__).parent
    head = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    if head.returncode != 0:
        pytest.skip("This is no clone.")
    named = commit_here()
    assert named is not None
    assert named.removesuffix("-dirty") == head.stdout.strip()


def test_where_there_is_no_git_it_names_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert commit_here() is None
