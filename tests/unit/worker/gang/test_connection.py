"""Frames between the hosts of a gang: whole, in order, and only by holders of the secret."""

import socket
import threading
from collections.abc import Iterator

import pytest

from worker.gang.connection import Connection, ConnectionLost, Greeting, connect

SECRET = b"a secret of both"


@pytest.fixture
def ends() -> Iterator[tuple[Connection, Connection]]:
    """The leader's and the member's."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        made: list[Connection] = []
        port = listener.getsockname()[1]
        thread = threading.Thread(target=lambda: made.append(connect("127.0.0.1", port, SECRET)))
        thread.start()
        greeting = Greeting(listener.accept()[0], SECRET)
        while (leader := greeting.go_on()) is None:
            pass
        thread.join()
    yield leader, made[0]
    leader.close()
    made[0].close()


def received(connection: Connection, number: int) -> list[bytes]:
    frames: list[bytes] = []
    while len(frames) < number:
        frames += connection.received()
    return frames


def test_frames_arrive_whole_and_in_order_both_ways(ends: tuple[Connection, Connection]) -> None:
    leader, member = ends
    sent = [b"", b"one", bytes(10**6)]
    for content in sent:
        leader.send(content)
    assert received(member, 3) == sent
    member.send(b"back")
    assert received(leader, 1) == [b"back"]
    assert list(leader.received()) == []


def test_a_changed_frame_ends_the_connection(ends: tuple[Connection, Connection]) -> None:
    leader, member = ends
    with socket.socket(fileno=socket.dup(leader.fileno())) as raw:
        raw.sendall(b"\0\0\0\1" + bytes(32) + b"x")
        with pytest.raises(ConnectionLost, match="not written by a holder of the secret"):
            received(member, 1)


def test_a_closed_connection_is_told_after_what_came_before(ends: tuple[Connection, Connection]) -> None:
    leader, member = ends
    leader.send(b"the last")
    leader.close()
    frames = member.received()
    assert next(frames) == b"the last"
    with pytest.raises(ConnectionLost, match="closed"):
        next(frames)
