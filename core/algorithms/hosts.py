"""Processes, one on each host, that share a run by `jax.distributed`.

All of them start the same programs of JAX in the same order, or each waits for the others. What comes next
depends on clocks and signals, so the first process leads: it decides, and tells the others.
"""

from itertools import count
from typing import Any

import jax

from core.errors import JobFailed
from core.reasons import Reason

# For what the leader does alone, such as drawing a video; a leader that ends is noticed at once.
_TIMEOUT_MS = 7 * 24 * 3600 * 1000
# Commands that no process can still need are removed from the coordinator.
_KEPT = 100
# Every process makes the same ones in the same order.
_numbers = count()


class Hosts:
    """This process among those that share a run; alone, it tells nobody anything."""

    def __init__(self) -> None:
        self.number, self.rank = jax.process_count(), jax.process_index()
        self._number = next(_numbers)
        self._num_commands = 0

    def meet(self, where: str) -> None:
        """Wait until every process has come to this place."""
        if self.number > 1:
            _coordinator().wait_at_barrier(self._name(where), _TIMEOUT_MS)

    def tell(self, command: str) -> None:
        """Tell the other processes what comes next. Only the first process does."""
        if self.number > 1:
            if self._num_commands >= _KEPT:
                _coordinator().key_value_delete(self._name(str(self._num_commands - _KEPT)))
            _coordinator().key_value_set(self._name(str(self._num_commands)), command)
            self._num_commands += 1

    def next_command(self) -> str:
        """Wait for the next command of the first process."""
        name = self._name(str(self._num_commands))
        command = _coordinator().blocking_key_value_get(name, _TIMEOUT_MS)
        self._num_commands += 1
        return command

    def agree(self, facts: str) -> None:
        """Check that every process has the same facts as the first one: they would compile other programs.

        Raises JobFailed in a process that differs.
        """
        if self.number == 1:
            return
        if self.rank == 0:
            _coordinator().key_value_set(self._name("facts"), facts)
        first = _coordinator().blocking_key_value_get(self._name("facts"), _TIMEOUT_MS)
        if facts != first:
            detail = f"The machines that share the job differ: the first has {first}, and this one {facts}."
            raise JobFailed(Reason.TRAINING_CRASHED, detail)

    def _name(self, what: str) -> str:
        return f"gaitway/{self._number}/{what}"


def _coordinator() -> Any:
    """The client of JAX's coordinator; JAX has no public name for it."""
    from jax._src.distributed import global_state

    return global_state.client
