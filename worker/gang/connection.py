"""A connection between the workers of a gang: frames of bytes over TCP, of holders of a secret alone.

Each side proves that it knows the secret, which is never sent (HMAC-SHA-256 of both sides' random numbers).
Every frame has a tag of its content and its number, by a key of this connection and direction, so none can be
changed, repeated or left out. What is sent is not encrypted.
"""

import hmac
import secrets
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import suppress

# Bytes of a frame's content at most, and of what is read at once.
MOST_BYTES = 2**22
_NONCE, _TAG, _HEAD = 32, 32, 4
# How long a peer may take to prove that it knows the secret, and to take what is sent to it.
HANDSHAKE_S, SEND_S = 5.0, 15


class ConnectionLost(Exception):
    """The peer has gone, is silent, or does not know the secret; the message says which."""


class Connection:
    """Made by `Greeting` or `connect`. Not thread-safe."""

    def __init__(self, peer: socket.socket, secret: bytes, nonces: bytes, *, leads: bool) -> None:
        _keep_alive(peer)
        # Not Python's own timeout, with which MSG_DONTWAIT would wait.
        peer.settimeout(None)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", SEND_S, 0))
        self._socket = peer
        ours, theirs = (b"leader", b"member") if leads else (b"member", b"leader")
        self._write_key, self._read_key = (
            _tag(secret, b"frames of " + side, nonces) for side in (ours, theirs)
        )
        self._num_written = self._num_read = 0
        self._buffer = bytearray()
        self.heard_at = time.monotonic()

    @property
    def own_host(self) -> str:
        """The address of this machine at which the peer reaches it."""
        return self._socket.getsockname()[0]

    @property
    def peer_host(self) -> str:
        return self._socket.getpeername()[0]

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, content: bytes) -> None:
        """Raises ConnectionLost."""
        tag = _tag(self._write_key, struct.pack(">Q", self._num_written), content)
        self._num_written += 1
        try:
            self._socket.sendall(struct.pack(">I", len(content)) + tag + content)
        except OSError as error:
            raise ConnectionLost(f"the connection broke ({error})") from None

    def received(self) -> Iterator[bytes]:
        """The frames that have come, without waiting. Raises ConnectionLost."""
        is_open = True
        while True:
            while (frame := self._next_frame()) is not None:
                yield frame
            if not is_open:
                raise ConnectionLost("the connection was closed")
            try:
                piece = self._socket.recv(2**18, socket.MSG_DONTWAIT)
            except (BlockingIOError, InterruptedError):
                return
            except OSError as error:
                raise ConnectionLost(f"the connection broke ({error})") from None
            self._buffer += piece
            is_open = bool(piece)
            if piece:
                self.heard_at = time.monotonic()

    def close(self) -> None:
        with suppress(OSError):
            self._socket.close()

    def _next_frame(self) -> bytes | None:
        if len(self._buffer) < _HEAD:
            return None
        (size,) = struct.unpack_from(">I", self._buffer)
        if size > MOST_BYTES:
            raise ConnectionLost("a frame is too long")
        begin, end = _HEAD + _TAG, _HEAD + _TAG + size
        if len(self._buffer) < end:
            return None
        tag, content = bytes(self._buffer[_HEAD:begin]), bytes(self._buffer[begin:end])
        if not hmac.compare_digest(tag, _tag(self._read_key, struct.pack(">Q", self._num_read), content)):
            raise ConnectionLost("a frame was not written by a holder of the secret")
        del self._buffer[:end]
        self._num_read += 1
        return content


class Greeting:
    """The leader's side of a new connection, until the peer has proved that it knows the secret."""

    def __init__(self, peer: socket.socket, secret: bytes) -> None:
        peer.setblocking(False)
        self._socket, self._secret = peer, secret
        self._nonce = secrets.token_bytes(_NONCE)
        self._answer = b""
        self._deadline = time.monotonic() + HANDSHAKE_S
        self._is_asked = False

    def go_on(self) -> Connection | None:
        """The connection, once it is there; never waits. Raises ConnectionLost."""
        try:
            if not self._is_asked:
                self._socket.send(self._nonce)
                self._is_asked = True
            piece = self._socket.recv(_NONCE + _TAG - len(self._answer))
        except BlockingIOError:
            if time.monotonic() > self._deadline:
                raise ConnectionLost("the handshake was not finished in time") from None
            return None
        except OSError as error:
            raise ConnectionLost(f"the connection broke ({error})") from None
        if not piece:
            raise ConnectionLost("the connection was closed")
        self._answer += piece
        if len(self._answer) < _NONCE + _TAG:
            return None
        nonces, proof = self._nonce + self._answer[:_NONCE], self._answer[_NONCE:]
        if not hmac.compare_digest(proof, _tag(self._secret, b"member", nonces)):
            raise ConnectionLost("the peer has another secret")
        with suppress(OSError):
            self._socket.send(_tag(self._secret, b"leader", nonces))
        return Connection(self._socket, self._secret, nonces, leads=True)

    def close(self) -> None:
        self._socket.close()


def connect(host: str, port: int, secret: bytes) -> Connection:
    """A connection to the leader. Raises OSError where nobody listens, ConnectionLost for another secret."""
    peer = socket.create_connection((host, port), HANDSHAKE_S)
    try:
        nonces = _exactly(peer, _NONCE) + secrets.token_bytes(_NONCE)
        peer.sendall(nonces[_NONCE:] + _tag(secret, b"member", nonces))
        if not hmac.compare_digest(_exactly(peer, _TAG), _tag(secret, b"leader", nonces)):
            raise ConnectionLost("the peer has another secret")
        return Connection(peer, secret, nonces, leads=False)
    except BaseException:
        peer.close()
        raise


def _exactly(peer: socket.socket, num_bytes: int) -> bytes:
    content = b""
    while len(content) < num_bytes:
        piece = peer.recv(num_bytes - len(content))
        if not piece:
            raise ConnectionLost(
                "the leader has hung up: it has another secret, or this host's place is taken"
            )
        content += piece
    return content


def _tag(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


def _keep_alive(peer: socket.socket) -> None:
    """Have the kernel notice within some 15 s that the other machine is gone."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for name, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 3), ("TCP_KEEPCNT", 3)):
        if (option := getattr(socket, name, None)) is not None:  # macOS lacks some.
            peer.setsockopt(socket.IPPROTO_TCP, option, value)
