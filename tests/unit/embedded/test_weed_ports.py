"""Ports of an embedded SeaweedFS on a machine that several users share, or several tests."""

import json
import os
from pathlib import Path

import pytest

from gaitway.service.embedded import weed
from gaitway.service.embedded.weed import Weed


def ports_of(folder: Path) -> list[int]:
    """Those that it would take, given up again."""
    ports, claims = Weed(folder)._claimed_ports()
    for claim in claims:
        claim.close()
    return ports


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
    before = ports_of(tmp_path)
    assert ports_of(tmp_path) == before
    (sockets / f"seaweedfs-filer-grpc-{before[3]}.sock").touch()
    assert ports_of(tmp_path) == before  # Our own: weed replaces it.
    monkeypatch.setattr(os, "getuid", lambda: -2)
    assert before[3] not in ports_of(tmp_path)


def test_two_that_start_at_the_same_moment_do_not_share_a_port(tmp_path: Path) -> None:
    one, other = Weed(tmp_path / "one"), Weed(tmp_path / "other")
    (tmp_path / "other" / "ports.json").write_text(json.dumps(ports_of(tmp_path / "one")))
    try:
        one.launch()
        other.launch()
        assert one.endpoint != other.endpoint
        one.wait_ready()
        other.wait_ready()
    finally:
        one.stop()
        other.stop()
