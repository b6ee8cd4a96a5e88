"""`gaitway watch --open`."""

import webbrowser
from typing import Any

import pytest
from typer.testing import CliRunner

from gaitway.cli import watch
from gaitway.cli.main import app

ADDRESS = "http://127.0.0.1:8000/#/jobs/019aa3c2f0b1-5be0c1d2e3/replay"


@pytest.mark.parametrize("has_browser", [True, False])
def test_the_page_is_opened_or_its_address_told(
    has_browser: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[Any] = []

    def open_it(address: str) -> bool:
        opened.append(address)
        return has_browser

    monkeypatch.setattr(webbrowser, "open", open_it)
    watch.open_page(ADDRESS)
    assert opened == [ADDRESS]
    assert (ADDRESS in capsys.readouterr().err) is not has_browser


def test_watch_offers_it() -> None:
    assert "--open" in CliRunner().invoke(app, ["watch", "--help"]).output
