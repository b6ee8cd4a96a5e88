"""The commit that an attempt's record names."""

import subprocess
from pathlib import Path

import pytest

from worker.host import commit
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


def test_code_that_is_installed_within_another_clone_names_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commit, "_CODE", tmp_path / "venv" / "gaitway" / "_service")
    (tmp_path / "venv" / "gaitway" / "_service").mkdir(parents=True)
    identity = ("-c", "user.name=a user", "-c", "user.email=user@example.org")
    for command in (("init", "--quiet"), (*identity, "commit", "--quiet", "--allow-empty", "-m", "theirs")):
        subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
    assert commit_here() is None


def test_where_there_is_no_git_it_names_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    assert commit_here() is None
