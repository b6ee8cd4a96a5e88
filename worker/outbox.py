"""From what the training process says to stored facts, in order, whatever the network does meanwhile."""

import contextlib
import hashlib
import queue
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import Thread

from core.jobs.attempts import Holding
from core.jobs.job import Artifact, Progress, utc_now
from core.jobs.store import Entry
from core.patience import through_outages
from core.storage import keys
from worker.measurements import measurements
from worker.messages import Advanced, FileReady, Hello, Measured, Message, Noted, PhaseEnded, Started


class Outbox:
    """A thread that stores messages and log lines. An outage makes it wait, never the training."""

    def __init__(self, holding: Holding, spool: Path, keep_checkpoints: int) -> None:
        self._failure: Exception | None = None
        self._holding = holding
        self._spool = spool
        self._keep_checkpoints = keep_checkpoints
        self._waiting: queue.SimpleQueue[Message | str | None] = queue.SimpleQueue()
        self._thread = Thread(target=self._work, name="outbox", daemon=True)
        self._thread.start()

    def put(self, item: Message | str) -> None:
        """Take a message, or a line of the log."""
        self._waiting.put(item)

    def close(self, patience_s: float) -> bool:
        """Wait until all is stored, at most so long; whether it is. Raises what `check` raises."""
        self._waiting.put(None)
        self._thread.join(patience_s)
        self.check()
        return not self._thread.is_alive()

    def check(self) -> None:
        """Raises what ended the storing before its time: LeaseLost, where the attempt's job is not ours."""
        if self._failure is not None:
            raise self._failure

    def _work(self) -> None:
        while True:
            items = self._take()
            lines = [item for item in items if isinstance(item, str)]
            messages = [item for item in items if item is not None and not isinstance(item, str)]
            steps = [partial(self._store_lines, lines)] if lines else []
            steps += [partial(self._store, message) for message in messages]
            for step in steps:
                if not self._insist(step):
                    return
            if None in items:
                return

    def _take(self) -> list[Message | str | None]:
        """At least one item; and, so that a flood of lines is one write, what else waits already."""
        items = [self._waiting.get()]
        with contextlib.suppress(queue.Empty):
            while len(items) < 500:
                items.append(self._waiting.get_nowait())
        return items

    def _insist(self, step: Callable[[], None]) -> bool:
        """Do it, through any outage; whether it was possible at all."""
        try:
            through_outages(step)
        except Exception as error:  # Whatever it is, the job must not seem done.
            self._failure = error
            return False
        return True

    def _store_lines(self, lines: Sequence[str]) -> None:
        now = utc_now()
        entries = [Entry(kind="line", time=now, data={"text": line}) for line in lines]
        self._holding.store.record(self._holding.job_id, self._holding.token, "logs", entries)

    def _store(self, message: Message) -> None:
        match message:
            case Started(device=device, engine=engine, details=details):
                self._holding.start(device=device, engine=engine, details=details)
            case PhaseEnded(name=name, seconds=seconds):
                self._record("phase", {"name": name, "seconds": seconds})
            case Advanced():
                progress = Progress.model_validate(message.model_dump(exclude={"type"}))
                self._record("progress", message.model_dump(exclude={"type"}), progress)
            case Measured(step=step, values=values):
                self._record("metrics", {"step": step, "values": values})
            case FileReady():
                self._publish(message)
            case Noted(text=text):
                self._record("note", {"text": text})
            case Hello(pid=pid):
                self._record("phase", {"name": "process", "pid": pid})
            case _:  # Failed and Finished are the supervisor's to weigh.
                pass

    def _record(self, kind: str, data: dict[str, object], progress: Progress | None = None) -> None:
        entry = Entry(kind=kind, time=utc_now(), data=data)
        self._holding.store.record(self._holding.job_id, self._holding.token, "events", [entry], progress)

    def _publish(self, message: FileReady) -> None:
        path = self._spool / message.path
        published = [self._upload(message, path)]
        if message.role == "checkpoint":
            published.append(self._upload_metrics())
        self._holding.publish(tuple(published), self._keep_checkpoints)
        self._record("artifact", {"name": message.name, "role": message.role, "step": message.step})
        path.unlink(missing_ok=True)

    def _upload(self, message: FileReady, path: Path) -> Artifact:
        artifact = Artifact(
            **message.model_dump(exclude={"type", "path"}),
            size=path.stat().st_size,
            sha256=_sha256(path),
            key=self._key(message.name),
        )
        self._holding.objects.put_file(artifact.key, path, media_type=artifact.media_type)
        return artifact

    def _upload_metrics(self) -> Artifact:
        body = self._metrics_so_far()
        artifact = Artifact(
            name="metrics.jsonl",
            role="metrics",
            media_type="application/jsonl",
            size=len(body),
            sha256=hashlib.sha256(body).hexdigest(),
            key=self._key("metrics.jsonl"),
        )
        self._holding.objects.put(artifact.key, body, media_type=artifact.media_type)
        return artifact

    def _key(self, name: str) -> str:
        return keys.artifact(self._holding.job_id, self._holding.number, name)

    def _metrics_so_far(self) -> bytes:
        rows = measurements(self._holding.store, self._holding.job_id)
        return "".join(f"{row}\n" for row in rows).encode()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
