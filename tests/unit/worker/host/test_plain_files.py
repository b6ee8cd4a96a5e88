"""What a process that was taken over may put in its folder, and what of it is read (H6a)."""

import os
import socket
from pathlib import Path

import pytest

from worker.host.disk import NotPlain, open_below, open_plain, read_plain


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A spool beside a secret."""
    (tmp_path / "keys.json").write_text("secret")
    (spool := tmp_path / "spool").mkdir()
    (spool / "plain").write_bytes(b"0123456789")
    (spool / "inner").mkdir()
    (spool / "inner" / "plain").write_bytes(b"inner")
    os.symlink(tmp_path / "keys.json", spool / "link")
    os.symlink(spool / "plain", spool / "own link")
    os.symlink(tmp_path, spool / "inner" / "above")
    os.mkfifo(spool / "pipe")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(spool / "socket"))
    return spool


def test_a_plain_file_is_read(folder: Path) -> None:
    with open_plain(folder, "plain") as file:
        assert file.read() == b"0123456789"
    assert read_plain(folder / "plain", 4) == b"6789"
    with open_below(folder, "inner/plain") as file:
        assert file.read() == b"inner"
    with pytest.raises(FileNotFoundError):
        open_plain(folder, "missing")


@pytest.mark.parametrize(
    "name",
    [
        "link",
        "own link",
        "pipe",
        "socket",
        "inner",
        "inner/plain",
        "../keys.json",
        "..",
        ".",
        "",
        "a\0b",
        "/etc/passwd",
    ],
)
def test_h6a_what_is_no_plain_file_of_the_folder_is_refused_without_waiting(folder: Path, name: str) -> None:
    with pytest.raises(NotPlain):
        open_plain(folder, name)


@pytest.mark.parametrize(
    "path", ["inner/above/keys.json", "inner/../../keys.json", "/etc/passwd", "inner", ".."]
)
def test_h6a_no_folder_on_the_way_leads_elsewhere(folder: Path, path: str) -> None:
    with pytest.raises(NotPlain):
        open_below(folder, path)


def test_h6a_an_open_file_stays_what_it_was(folder: Path) -> None:
    with open_plain(folder, "plain") as file:
        (folder / "plain").unlink()
        os.symlink(folder.parent / "keys.json", folder / "plain")
        assert file.read() == b"0123456789"
