"""Episodes in processes of their own, several worlds side by side; the seeds are shared out among them."""

import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Self

_ROOT = __file__.rpartition("/tests/")[0]
# No world runs on what hundreds of episodes have left.
_EPISODES_OF_A_WORLD = 50
_TRIES = 3
_EPISODES = (sys.executable, "-m", "tests.faults.campaign.episode")
# What a process says once its world is there.
READY = "ready\n"


@dataclass(frozen=True)
class Outcome:
    """seed: it draws jobs and faults. faults: as they began. broken: sentences of the checker."""

    seed: int
    faults: tuple[str, ...]
    broken: tuple[str, ...]
    seconds: float

    def line(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def of_line(cls, line: str) -> "Outcome":
        said = json.loads(line)
        return cls(said["seed"], tuple(said["faults"]), tuple(said["broken"]), said["seconds"])


@dataclass
class Runner:
    """A world in a process that ends with the thread that entered this, and all in it with that process.

    kinds: the module that draws the faults.
    """

    kinds: str = "faults"

    def __enter__(self) -> Self:
        for _ in range(_TRIES):
            self._start()
            assert self._child.stdout is not None
            if self._child.stdout.readline() == READY:
                return self
            self.__exit__()  # Somebody took a port between the look and the start; stderr says what it was.
        raise RuntimeError(f"No world could be started, {_TRIES} times.")

    def _start(self) -> None:
        self._folder = tempfile.mkdtemp(prefix="gw-")
        self._child = subprocess.Popen(
            [*_EPISODES, "--kinds", self.kinds, "--serve", self._folder],
            cwd=_ROOT,
            env={**os.environ, "GAITWAY_PARENT": str(os.getpid())},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __exit__(self, *_: object) -> None:
        self._child.communicate()  # It ends when there are no more seeds.
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def pid(self) -> int:
        return self._child.pid

    def run(self, seed: int) -> Outcome:
        """The episode's result. Raises RuntimeError where its process has ended."""
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(f"{seed}\n")
        self._child.stdin.flush()
        line = self._child.stdout.readline()
        if not line:
            raise RuntimeError(f"The process of the world of seed {seed} ended.")
        return Outcome.of_line(line)


# The kinds of faults, and a seed that draws some.
Episode = tuple[str, int]


def run_all(episodes: Iterable[Episode], worlds: int) -> Iterator[tuple[str, Outcome]]:
    """The kinds and the outcomes as they come."""
    todo: queue.SimpleQueue[Episode | None] = queue.SimpleQueue()
    for episode in episodes:
        todo.put(episode)
    for _ in range(worlds):
        todo.put(None)
    done: queue.SimpleQueue[tuple[str, Outcome] | BaseException | None] = queue.SimpleQueue()
    threads = [threading.Thread(target=_work, args=(todo, done), daemon=True) for _ in range(worlds)]
    for thread in threads:
        thread.start()
    at_work = worlds
    while at_work:
        outcome = done.get()
        if isinstance(outcome, BaseException):
            raise outcome
        if outcome is None:
            at_work -= 1
        else:
            yield outcome


def _work(
    todo: "queue.SimpleQueue[Episode | None]",
    done: "queue.SimpleQueue[tuple[str, Outcome] | BaseException | None]",
) -> None:
    try:
        episode = todo.get()
        while episode is not None:
            kinds, seed = episode
            with Runner(kinds) as runner:
                for _ in range(_EPISODES_OF_A_WORLD):
                    outcome = runner.run(seed)
                    done.put((kinds, outcome))
                    episode = todo.get()
                    # After a broken promise, the next one shall not suffer for it.
                    if episode is None or episode[0] != kinds or outcome.broken:
                        break
                    seed = episode[1]
        done.put(None)
    except BaseException as error:
        done.put(error)
