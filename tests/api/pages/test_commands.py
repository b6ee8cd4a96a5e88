"""The commands that the page tells people to type."""

import json
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gaitway.cli.main import app
from tests.api.conftest import Stack

PAGES = Path(__file__).parents[3] / "api" / "pages"
COMMAND = re.compile(r"<code>gaitway ([^<]+)</code>")
SWEEP = {
    "job": {"kind": "train", "environment": "ant"},
    "method": "grid",
    "parameters": {"seed": [1, 2]},
}


def printed() -> list[str]:
    """The words after `gaitway` in each, but for those that need accounts (tests/e2e/test_accounts.py)."""
    found = [text for file in sorted(PAGES.rglob("*.js")) for text in COMMAND.findall(file.read_text())]
    return [text for text in found if not text.startswith(("login", "tokens"))]


@pytest.mark.parametrize("command", printed())
def test_every_command_that_the_page_prints_works(
    stack: Stack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    (tmp_path / "sweep.json").write_text(json.dumps(SWEEP))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    result = CliRunner().invoke(app, shlex.split(command))
    assert (result.exit_code, result.exception) == (0, None), result.output


def test_the_page_prints_commands() -> None:
    assert "submit ant" in printed()
