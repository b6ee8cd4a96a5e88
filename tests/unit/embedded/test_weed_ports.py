"""Ports of an embedded SeaweedFS on a machine that several users share."""

import os
from pathlib import Path

import pytest

from gaitway.service.embedded import weed
from gaitway.service.embedded.weed import Weed


@pytest.fixture
def sockets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where it keeps its sockets, in place of /tmp."""
    folder = tmp_path / "sockets"
    folder.mkdir()
    monkeypatch.setattr(weed, "_sockets", lambda port="*": list(folder.glob(f"seaweedfs-*-{port}.sock")))
    return folder


def test_a_port_whose_socket_another_user_has_left_is_not_taken_again(
    tmp_path: Path, sockets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = Weed(tmp_path / "weed")._choose_ports()
    assert Weed(tmp_path / "weed")._choose_ports() == before
    (sockets / f"seaweedfs-filer-grpc-{before[3]}.sock").touch()
    assert Weed(tmp_path / "weed")._choose_ports() == before  # Our own: weed replaces it.
    monkeypatch.setattr(os, "getuid", lambda: -2)
    assert before[3] not in Weed(tmp_path / "weed")._choose_ports()
