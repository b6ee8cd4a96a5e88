"""L5: no control character of others reaches the terminal, however it is printed."""

import json
import re
import sys
from io import StringIO
from pathlib import Path

import pytest
import typer
from rich.table import Table
from rich.text import Text
from typer.testing import CliRunner

from gaitway.cli import common, terminal
from gaitway.cli.common import print_json
from gaitway.errors import GaitwayError

# Clears the screen, sets the title, writes the clipboard, in both forms; overrides the direction; returns.
HOSTILE = "a\x1b[2J\x1b]0;title\x07\x9b2J\x9d52;c;aGk=\x9c\u202eb\u2066\r\x08\x7f\u0000ü→ \t end"
SHOWN = re.compile("[^\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]*")
app = typer.Typer(cls=common.CommandGroup)


@app.command("print")
def _print() -> None:
    print(HOSTILE)
    print(HOSTILE, file=sys.stderr)
    sys.stdout.writelines([HOSTILE, "\n"])


@app.command("rich")
def _rich() -> None:
    table = Table(HOSTILE)
    table.add_row(HOSTILE)
    terminal.Console().print(table)
    terminal.Console(stderr=True).print(Text(HOSTILE, style="yellow"), soft_wrap=True)


@app.command("fail")
def _fail() -> None:
    raise GaitwayError(HOSTILE)


@app.command("json")
def _json() -> None:
    print_json({HOSTILE: HOSTILE})


@pytest.mark.parametrize("command", ["print", "rich", "fail", "json"])
def test_l5_whatever_a_command_prints_is_text(command: str) -> None:
    result = CliRunner().invoke(app, [command])
    assert "end" in result.output
    assert "ü→" in result.output
    assert SHOWN.fullmatch(result.output), result.output
    if command == "json":
        assert json.loads(result.stdout) == {HOSTILE: HOSTILE}


def test_l5_the_terminal_programs_own_colours_stay() -> None:
    file = StringIO()
    terminal.Console(file=file, force_terminal=True, color_system="standard").print(Text("\x1b[2J", "red"))
    assert file.getvalue() == "\x1b[31m�[2J\x1b[0m\n"


def test_l5_no_command_prints_past_it() -> None:
    folder = Path(terminal.__file__).parents[1]
    past = re.compile(
        r"from rich\.console import .*\bConsole\b|rich\.get_console|rich import print|__stdout__"
    )
    found = [str(file) for file in folder.rglob("*.py") if past.search(file.read_text())]
    assert found == []
