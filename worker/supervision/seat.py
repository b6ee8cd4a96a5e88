"""A member's place in a cohort: its end of the connection to the process that trains it."""

import os
from collections.abc import Generator
from concurrent.futures import Future
from contextlib import contextmanager


class Seat:
    """descriptor: ours to close, as soon as the member's training process has inherited it. ready: done once
    the cohort's process runs; its exception says why it never will. num_members: of the cohort."""

    def __init__(self, descriptor: int, ready: Future[None], num_members: int) -> None:
        self.num_members = num_members
        self._descriptor = descriptor
        self._ready = ready
        self._is_taken = True

    @contextmanager
    def taken(self) -> Generator[int]:
        """The descriptor, once the cohort's process runs. Raises what kept that from starting."""
        try:
            self._ready.result()
            yield self._descriptor
        finally:
            self.leave()

    def leave(self) -> None:
        """Close the descriptor; the cohort then waits for this member no longer than its process lives."""
        if self._is_taken:
            self._is_taken = False
            os.close(self._descriptor)
