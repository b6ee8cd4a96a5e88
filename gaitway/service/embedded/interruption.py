"""Ctrl-C and similar signals, handled where it is safe to stop."""

import signal
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, Self

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(BaseException):
    """The user, or the system, wants everything to end."""

    def __init__(self, signal_number: int) -> None:
        super().__init__(signal.Signals(signal_number).name)
        self.exit_status = 128 + signal_number


class Interruption:
    """Counts SIGINT, SIGTERM and SIGHUP; raises Interrupted only where that is allowed.

    So a child that is just being started is never lost before its process id is stored.
    Only the main thread may enter it.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last = signal.SIGINT
        self._is_allowed = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._arrived) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def allowed(self) -> Generator[None]:
        """Within this, a signal raises Interrupted; one that came before does so at once."""
        self._is_allowed = True
        try:
            if self.count:
                raise Interrupted(self._last)
            yield
        finally:
            self._is_allowed = False

    def _arrived(self, number: int, _frame: FrameType | None) -> None:
        self.count += 1
        self._last = signal.Signals(number)
        if self._is_allowed:
            # Once is enough: a second signal must not interrupt what the exception unwinds.
            self._is_allowed = False
            raise Interrupted(number)
