"""How a server of the embedded stack is started, awaited and stopped."""

from abc import ABC, abstractmethod
from typing import Self


class Server(ABC):
    """A private server: launched, awaited and stopped, or used as a context manager."""

    @abstractmethod
    def launch(self) -> Self:
        """Start it without waiting. Raises ServerFailed."""

    @abstractmethod
    def wait_ready(self) -> Self:
        """Return when it is ready. Raises ServerFailed."""

    @abstractmethod
    def stop(self) -> None:
        """End it; none of its processes is left."""

    def start(self) -> Self:
        """Return when it is ready. Raises ServerFailed, and leaves no process behind then."""
        try:
            return self.launch().wait_ready()
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
