"""`gaitway up` listens beyond this machine only with accounts."""

from pathlib import Path

import pytest

from core.errors import EXIT_STATUS
from gaitway.service.embedded.up import run_stack


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.7", "gaitway.lab"])  # noqa: S104
def test_without_accounts_it_does_not_start_there(
    host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("GAITWAY_ACCOUNTS", raising=False)
    assert run_stack(tmp_path / "data", host=host) == EXIT_STATUS
    told = capsys.readouterr().err
    assert "--accounts" in told
    assert "ssh -L" in told
    assert not (tmp_path / "data").exists()
