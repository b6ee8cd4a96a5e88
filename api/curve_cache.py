"""Curves that were asked for lately, so that only new entries of a feed are read again."""

from collections import OrderedDict
from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from threading import Lock

from core.jobs import columns, feeds
from core.jobs.curves import Curves
from core.jobs.store import JobStore
from core.storage.objects import ObjectStore

# 24 bytes each: 64 MB. A name takes as much as so many values.
_MAX_VALUES = 2_700_000
_VALUES_OF_A_NAME = 33


@dataclass
class _Known:
    """What was read of a feed. names: the metrics that were kept; None: all. last: an entry's number."""

    names: frozenset[str] | None = frozenset()
    last: int = 0
    curves: Curves = field(default_factory=Curves)
    lock: Lock = field(default_factory=Lock)

    @property
    def size(self) -> int:
        """In values."""
        return self.curves.num_values + _VALUES_OF_A_NAME * len(self.curves)

    def has(self, names: frozenset[str] | None) -> bool:
        return self.names is None or (names is not None and names <= self.names)


class CurveCache:
    """The curves of the jobs that were asked for last. Feeds only grow: only what came since is read."""

    def __init__(self, store: JobStore, objects: ObjectStore) -> None:
        self._store = store
        self._objects = objects
        self._known = OrderedDict[str, _Known]()
        self._lock = Lock()
        # Long feeds are read in turn. Parsing holds the interpreter, so side by side it is no faster, and the
        # rest of this process, streams above all, would wait behind each of the threads.
        self._turn = Lock()

    @contextmanager
    def curves(self, job_id: str, names: frozenset[str] | None) -> Generator[tuple[Curves, int]]:
        """The job's curves, at least those of these names (None: all), and the last entry's number.

        They are the caller's alone within this context. Raises the errors of `feeds.read_metrics`.
        """
        with self._lock:
            known = self._known.setdefault(job_id, _Known())
            self._known.move_to_end(job_id)
        with known.lock:
            try:
                self._read_on(job_id, known, names)
            except BaseException:
                self._forget(job_id)
                raise
            yield known.curves, known.last
        self._make_room()

    def _read_on(self, job_id: str, known: _Known, names: frozenset[str] | None) -> None:
        """Read the entries that came since, or the whole feed if it has metrics that were not kept.

        Columns are read first where they exist: decoding them is cheap, so it waits for no turn.
        """
        if not known.has(names):
            known.names = None if names is None or known.names is None else known.names | names
            known.last, known.curves = 0, Curves()
        if not known.last:
            parts = columns.read(job_id, known.names, store=self._store, objects=self._objects)
            for part, last in parts:
                known.curves.extend(part)
                known.last = last
        turn: AbstractContextManager[object] = nullcontext()  # The news of a feed are one page.
        is_end = False
        while not is_end:
            with turn:
                is_end = self._read_page(job_id, known)
            turn = self._turn

    def _read_page(self, job_id: str, known: _Known) -> bool:
        """Whether it was the last page."""
        page = feeds.read_metrics(
            job_id, known.last, feeds.METRICS_PAGE, store=self._store, objects=self._objects
        )
        known.curves.add(page.measured, known.names)
        known.last = page.last
        return page.is_end

    def _forget(self, job_id: str) -> None:
        with self._lock:
            self._known.pop(job_id, None)

    def _make_room(self) -> None:
        """Forget the jobs that were asked for longest ago; the last one, too, if it is too large alone."""
        with self._lock:
            sizes = {job_id: known.size for job_id, known in self._known.items()}
            total = sum(sizes.values())
            while total > _MAX_VALUES and self._known:
                job_id, _ = self._known.popitem(last=False)
                total -= sizes[job_id]
