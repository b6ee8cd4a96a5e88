"""The runs a bench is made of, each stored in a file as soon as it has ended.

So a bench may be spread over several calls, and a call that is cut off loses only its present run.
"""

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from bench.measure.child import ChildFailed, TookTooLong, run_child
from bench.measure.machine import Machine, this_machine
from bench.measure.result import Options
from bench.measure.turn import TURN

Run = dict[str, Any]

_ALIKE = ("processor", "cores", "accelerator", "python", "packages", "commit")


@dataclass(frozen=True)
class Work:
    """One run in its own process.

    about_s: roughly how long it takes; it is not started with less time left. cache: the name of a folder for
    compiled programs; cold: it is empty at the start. after: the run that fills the cache; it is made again
    if this machine lacks the cache.
    """

    name: str
    module: str
    request: dict[str, Any]
    timeout_s: float = 560.0
    about_s: float = 60.0
    cache: str | None = None
    cold: bool = False
    after: "Work | None" = None


class Runs:
    """done: answers by the run's name. failed: one line per failed run. left: runs without time."""

    def __init__(self, bench: str, options: Options) -> None:
        self.done: dict[str, Run] = {}
        self.failed: dict[str, str] = {}
        self.left: list[str] = []
        self._in_turns = False
        self.machine = this_machine()
        self._folder = options.out / "runs" / (f"{bench}-quick" if options.quick else bench)
        # Compiled programs are large and useful only on this machine: they stay out of the results.
        self._caches = Path(tempfile.gettempdir(), "gaitway-bench-caches", bench)
        self._only, self._machines = options.only, dict[str, Machine]()
        self._ends_at = time.monotonic() + options.seconds if options.seconds else float("inf")
        if not options.resume:
            for folder in (self._folder, self._caches):
                shutil.rmtree(folder, ignore_errors=True)

    def make(self, works: Iterable[Work]) -> None:
        """Make the missing runs in their order; a failure is stored like an answer."""
        for work in works:
            self._take(work, self._record(work))

    def make_together(self, works: Iterable[Work], at_once: int, *, in_turns: bool = False) -> None:
        """Make several missing runs at a time, for runs that do not measure how long they take.

        in_turns: they compile side by side and time their work one after another (bench.measure.turn); a
        run's time limit covers its waiting.
        """
        wanted = list(works)
        self._in_turns = in_turns
        if in_turns:
            os.environ.setdefault(TURN, str(self._caches / "turn"))
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # One would take the card.
        with ThreadPoolExecutor(at_once) as pool:
            for work, record in zip(wanted, pool.map(self._record, wanted), strict=True):
                self._take(work, record)

    def _record(self, work: Work) -> Run | None:
        record = self._kept(work)
        if record is None and fnmatchcase(work.name, self._only) and self._has_its_cache(work):
            record = self._made(work)
        return record

    def _take(self, work: Work, record: Run | None) -> None:
        if record is None:
            self.left.append(work.name)
            return
        self._machines[work.name] = Machine.model_validate(record["machine"])
        if "failure" in record:
            self.failed[work.name] = record["failure"]
        else:
            self.done[work.name] = record["answer"]

    def _has_its_cache(self, work: Work) -> bool:
        """Whether the cache that the run needs is on this machine; a missing one is made if time allows."""
        before = work.after
        if before is None or self._marker(before).exists():
            return True
        if not fnmatchcase(before.name, self._only):
            return False
        self._path(before).unlink(missing_ok=True)
        self.done.pop(before.name, None)
        self.make([before])
        return before.name in self.done

    def notes(self) -> list[str]:
        """Facts about how the runs were made, for the reader."""
        seen = [{name: getattr(machine, name) for name in _ALIKE} for machine in self._machines.values()]
        differing = [name for name in _ALIKE if any(one[name] != seen[0][name] for one in seen)]
        notes = [f"Failed: {name} ({reason})." for name, reason in self.failed.items()]
        if self._in_turns:
            notes.append(
                "Runs were compiled side by side and timed one after the other: a run's wall time includes "
                "its wait."
            )
        for name in differing:
            values = dict.fromkeys(json.dumps(one[name]) for one in seen)
            notes.append(f"The runs differ in {name}: {', '.join(values)}.")
        return notes

    def where(self) -> Machine:
        """The machine of the first run; this machine if there is none."""
        return next(iter(self._machines.values()), self.machine)

    def _kept(self, work: Work) -> Run | None:
        """The answer of an earlier call to this same request."""
        path = self._path(work)
        if not path.exists():
            return None
        record = json.loads(path.read_bytes())
        return record if record["request"] == work.request else None

    def _made(self, work: Work) -> Run | None:
        """None if this call's time ends before the run's own limit."""
        left_s = self._ends_at - time.monotonic()
        if left_s < work.about_s:
            return None
        timeout_s = min(work.timeout_s, left_s)
        record: Run = {"request": work.request, "machine": this_machine().model_dump()}
        print(f"{work.name} …", file=sys.stderr, flush=True)
        began = time.perf_counter()
        try:
            answer = run_child(work.module, self._with_cache(work), timeout_s=timeout_s)
            record["answer"] = answer
        except TookTooLong as slow:
            if timeout_s < work.timeout_s:
                print(f"{work.name}: no time left", file=sys.stderr)
                return None
            record["failure"] = slow.reason
        except ChildFailed as failure:
            print(failure, file=sys.stderr)
            record["failure"] = failure.reason
        else:
            self._marker(work).parent.mkdir(parents=True, exist_ok=True)
            self._marker(work).touch()
        print(
            f"{work.name}: {record.get('failure', 'done')}, {time.perf_counter() - began:.0f} s",
            file=sys.stderr,
        )
        self._folder.mkdir(parents=True, exist_ok=True)
        self._path(work).write_text(json.dumps(record, indent=1) + "\n")
        return record

    def _with_cache(self, work: Work) -> Run:
        if work.cache is None:
            return {"cache": None, **work.request}
        folder = self._caches / work.cache
        if work.cold:
            shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        return {**work.request, "cache": str(folder)}

    def _path(self, work: Work) -> Path:
        return self._folder / f"{work.name}.json"

    def _marker(self, work: Work) -> Path:
        """A file that exists if the run filled a cache that is still on this machine."""
        return self._caches / f"{work.name}.made"
