"""The folders of the embedded stack belong to one user."""

from pathlib import Path

import pytest

from gaitway.service.embedded.folders import private_folder
from gaitway.service.embedded.processes import ServerFailed


def test_it_is_made_for_its_owner_alone(tmp_path: Path) -> None:
    folder = private_folder(tmp_path / "new" / "data")
    assert folder.stat().st_mode & 0o777 == 0o700


def test_one_that_another_user_has_is_refused_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    # The tests may run as root, whom nothing is forbidden.
    monkeypatch.setattr(Path, "chmod", refuse)
    with pytest.raises(ServerFailed, match=rf"belongs to {tmp_path.owner()}. Name another folder by --data"):
        private_folder(tmp_path)
