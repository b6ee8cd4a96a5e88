"""What stands between two parts, and misbehaves when it is asked to."""

import asyncio
import random
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path


class Mode(StrEnum):
    """The behaviour of a proxy.

    open: nothing. refuse: connections are reset. silent: nothing comes through, and nothing ends. slow: each
    piece takes a while. lose_answers: what is asked arrives, and the connection is reset before the answer.
    truncate: half of an answer arrives, and the connection is reset. flip: one bit of each piece is flipped,
    on its way there and on its way back. lose_claims: as lose_answers, of the commits of claims alone.
    """

    OPEN = "open"
    REFUSE = "refuse"
    SILENT = "silent"
    SLOW = "slow"
    LOSE_ANSWERS = "lose_answers"
    TRUNCATE = "truncate"
    FLIP = "flip"
    LOSE_CLAIMS = "lose_claims"


# This marks the statement that claims an attempt: no other one starts a lease with a new version of a job.
_CLAIM, _COMMIT = (b"UPDATE jobs SET version", b"lease_until=(clock_timestamp()"), b"COMMIT"
Place = Path | int  # A unix socket, or a port of the loopback interface.
_PIECE = 65_536
_POLL_S = 0.02
_DAWDLE_S = 0.15


@dataclass
class _Said:
    """The last statement on a connection to PostgreSQL."""

    claims: bool = False
    commits_a_claim: bool = False

    def hear(self, piece: bytes) -> None:
        self.commits_a_claim = self.claims and _COMMIT in piece
        self.claims = all(words in piece for words in _CLAIM) or (self.claims and _COMMIT not in piece)


@dataclass
class Proxy:
    """From `here` to `there`; `mode` may be set from any thread at any time."""

    here: Place
    there: Place
    mode: Mode = Mode.OPEN
    num_lost_claims: int = 0
    _rng: random.Random = field(default_factory=lambda: random.Random(0))
    _server: asyncio.Server | None = None
    _open: set[asyncio.Task[None]] = field(default_factory=set[asyncio.Task[None]])

    async def serve(self) -> None:
        if isinstance(self.here, Path):
            self._server = await asyncio.start_unix_server(self._accept, self.here)
        else:
            self._server = await asyncio.start_server(self._accept, "127.0.0.1", self.here)

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.ensure_future(self._connected(reader, writer))
        self._open.add(task)
        task.add_done_callback(self._open.discard)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.mode is Mode.REFUSE:
            _reset(writer)
            return
        try:
            if isinstance(self.there, Path):
                to_reader, to_writer = await asyncio.open_unix_connection(self.there)
            else:
                to_reader, to_writer = await asyncio.open_connection("127.0.0.1", self.there)
        except OSError:
            _reset(writer)
            return
        said = _Said()
        ways = [
            asyncio.create_task(self._pass_on(reader, to_writer, said, is_answer=False)),
            asyncio.create_task(self._pass_on(to_reader, writer, said, is_answer=True)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            for end in (writer, to_writer):
                _reset(end)

    async def _pass_on(
        self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, said: "_Said", *, is_answer: bool
    ) -> None:
        with suppress(OSError):
            while piece := await self._next(source):
                if is_answer and self.mode is Mode.LOSE_ANSWERS:
                    return
                if not is_answer:
                    said.hear(piece)
                elif said.commits_a_claim and self.mode is Mode.LOSE_CLAIMS:
                    self.num_lost_claims += 1
                    return
                if is_answer and self.mode is Mode.TRUNCATE:
                    sink.write(piece[: len(piece) // 2])
                    await sink.drain()
                    return
                if self.mode is Mode.FLIP:
                    piece = self._flipped(piece)
                if self.mode is Mode.SLOW:
                    await asyncio.sleep(_DAWDLE_S)
                while self.mode is Mode.SILENT:
                    await asyncio.sleep(_POLL_S)
                sink.write(piece)
                await sink.drain()

    def _flipped(self, piece: bytes) -> bytes:
        flipped = bytearray(piece)
        flipped[self._rng.randrange(len(piece))] ^= 1 << self._rng.randrange(8)
        return bytes(flipped)

    async def _next(self, source: asyncio.StreamReader) -> bytes:
        """The next piece; nothing at the end, and as soon as connections are refused."""
        reading = asyncio.ensure_future(source.read(_PIECE))
        try:
            while not reading.done():
                if self.mode is Mode.REFUSE:
                    return b""
                await asyncio.wait([reading], timeout=_POLL_S)
            return reading.result()
        finally:
            reading.cancel()


def _reset(writer: asyncio.StreamWriter) -> None:
    with suppress(OSError, RuntimeError):
        writer.transport.abort()


class Proxies:
    """All proxies of a world, in one thread."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxies", daemon=True)
        self._thread.start()
        self.all: dict[str, Proxy] = {}

    def add(self, name: str, here: Place, there: Place) -> Proxy:
        """One more, which listens when this returns."""
        proxy = self.all[name] = Proxy(here, there)
        asyncio.run_coroutine_threadsafe(proxy.serve(), self._loop).result(5)
        return proxy

    def heal(self) -> None:
        for proxy in self.all.values():
            proxy.mode = Mode.OPEN

    def close(self) -> None:
        for proxy in self.all.values():
            asyncio.run_coroutine_threadsafe(proxy.close(), self._loop).result(5)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)
        self._loop.close()
