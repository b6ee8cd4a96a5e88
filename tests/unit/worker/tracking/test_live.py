"""Which of a training's files the process with an account's key is shown (H6a)."""

from pathlib import Path
from typing import Any

import pytest

from worker.protocol import FileReady
from worker.tracking.items import VideoItem
from worker.tracking.live import Live


@pytest.mark.parametrize("name", ["link", "../keys.json", "folder", "/etc/hostname"])
def test_h6a_only_plain_files_of_the_spool_are_shown(name: str, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text("TOP SECRET")
    spool, folder = tmp_path / "spool", tmp_path / "private"
    for one in (spool, folder):
        one.mkdir()
    (spool / "link").symlink_to(tmp_path / "keys.json")
    (spool / "folder").mkdir()
    (spool / "video.mp4").write_bytes(b"video")
    live: Any = Live.__new__(Live)
    shown: list[VideoItem] = []
    live._spool, live._folder, live._put = spool, folder, shown.append
    for path in (name, "video.mp4"):
        live.send(FileReady(name=path, path=path, role="video", media_type="video/mp4", step=3))
    assert shown == [VideoItem(step=3, path=folder / "video.mp4")]
    assert [path.name for path in folder.iterdir()] == ["video.mp4"]
