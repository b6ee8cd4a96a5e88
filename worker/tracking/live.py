"""Shows a run at Weights & Biases while it is in progress."""

import json
import os
import queue
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from core.settings import WorkerSettings
from worker.host.disk import NotPlain, open_plain
from worker.protocol import FileReady, Measured, Message, Started
from worker.tracking.child import end, start
from worker.tracking.config import as_resolved
from worker.tracking.items import About, Configured, EndItem, Item, MetricsItem, PolicyItem, VideoItem

# How many items may wait for a slow process.
_MAX_WAITING = 10_000
# How long a job's end waits for the last items; and for them if the server has not even answered yet.
_FINISH_S, _OPEN_S = 10.0, 2.0


class Live:
    """Feeds a process that talks to the server. Only `finish` ever waits.

    note: called with the sentence that says why no more is sent; at most once, from another thread.
    """

    def __init__(
        self, about: About, spool: Path, settings: WorkerSettings, note: Callable[[str], None]
    ) -> None:
        self._spool, self._folder, self._note = spool, about.folder, note
        self._opened = threading.Event()
        self._failed = threading.Event()
        self._waiting: queue.Queue[bytes] = queue.Queue(_MAX_WAITING)
        self._child = start(["live"], about.folder, settings, with_key=True)
        self._put(about)
        self._listener = threading.Thread(target=self._listen, name="tracking_listen", daemon=True)
        self._listener.start()
        threading.Thread(target=self._feed, name="tracking_feed", daemon=True).start()

    def send(self, message: Message) -> None:
        """Send a message of the training process on; its files are still in the spool."""
        match message:
            case Started(device=device, engine=engine, details=details):
                self._put(Configured(values=as_resolved(device, engine, details)))
            case Measured(step=step, finite=values):
                self._put(MetricsItem(step=step, values=values))
            case FileReady(role="video" | "policy" as role, path=path, step=step, metadata=facts):
                kept = VideoItem if role == "video" else PolicyItem
                self._link(path, kept, step or 0, facts.get("seed"))
            case _:
                pass

    def _link(self, name: str, kept: type[VideoItem | PolicyItem], step: int, seed: int | None) -> None:
        """Have a file, if it is one: the outbox removes the spool's own as soon as it is stored."""
        own = self._folder / name
        with suppress(OSError):
            if Path(name).name != name:
                return
            # The link is checked, and not what it was made of, which the process could still exchange.
            os.link(self._spool / name, own, follow_symlinks=False)
            try:
                open_plain(self._folder, name).close()
            except NotPlain:
                own.unlink()
                return
            self._put(kept(step=step, path=own, seed=seed))

    def finish(self, exit_code: int) -> bool:
        """Send the rest, within a time limit, and end the process; returns whether the server has it all."""
        self._put(EndItem(exit_code=exit_code))
        try:
            status = self._child.wait(_FINISH_S if self._opened.is_set() else _OPEN_S)
        except subprocess.TimeoutExpired:
            status = None
            self._fail("Weights & Biases was too slow: the job has ended, and does not wait for it.")
        end(self._child)
        self._listener.join(1)  # It may still have a reason to report.
        is_complete = status == 0 and not self._failed.is_set()
        self._failed.set()
        return is_complete

    def kill(self) -> None:
        """End the process, whatever it still had to do."""
        self._failed.set()
        end(self._child)

    def _put(self, item: About | Item) -> None:
        if self._failed.is_set():
            return
        try:
            self._waiting.put_nowait(item.model_dump_json().encode() + b"\n")
        except queue.Full:
            self._fail("Weights & Biases was too slow for this run, and gets no more of it.")
            self._child.kill()

    def _feed(self) -> None:
        pipe = cast("IO[bytes]", self._child.stdin)
        with suppress(OSError), pipe:  # It has ended: _listen says why.
            while not self._failed.is_set():
                with suppress(queue.Empty):
                    pipe.write(self._waiting.get(timeout=1))
                    pipe.flush()

    def _listen(self) -> None:
        with cast("IO[bytes]", self._child.stdout) as words:
            for line in words:
                word = json.loads(line)
                if "opened" in word:
                    self._opened.set()
                else:
                    self._fail(word["note"])
        if self._child.wait() != 0:
            self._fail("The process that talks to Weights & Biases has ended.")

    def _fail(self, why: str) -> None:
        if not self._failed.is_set():
            self._failed.set()
            self._note(why)
