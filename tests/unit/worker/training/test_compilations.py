"""Where a training process leaves what it compiles, for the next."""

from pathlib import Path

import pytest

from mujoco_compiled.code import kept_code
from worker.training.built_environment import keep_machine_code


def test_the_code_of_a_body_is_kept_if_the_supervisor_has_made_a_folder_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_code, "_folder", None)
    monkeypatch.chdir(tmp_path)
    keep_machine_code()
    kept_code.kept("an ant", lambda: b"code")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "cache").mkdir()
    keep_machine_code()
    kept_code.kept("an ant", lambda: b"code")
    assert [file.read_bytes() for file in (tmp_path / "cache" / "compiled").iterdir()] == [b"code"]
