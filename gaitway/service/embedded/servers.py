"""The servers of the embedded stack under one data folder."""

from contextlib import ExitStack
from pathlib import Path
from typing import Self

from gaitway.service.embedded.postgres import Postgres
from gaitway.service.embedded.valkey import Valkey
from gaitway.service.embedded.weed import Weed


class EmbeddedServers:
    """PostgreSQL, Valkey and SeaweedFS, started together. They end with the thread that starts them."""

    def __init__(self, data_dir: Path) -> None:
        self.postgres = Postgres(data_dir / "postgres")
        self.valkey = Valkey(data_dir / "valkey")
        self.weed = Weed(data_dir / "objects")
        self.all = (self.postgres, self.valkey, self.weed)

    def start(self) -> Self:
        """Return when all are ready. Raises ServerFailed, and leaves none behind then."""
        try:
            # PostgreSQL last: its first launch returns only after it has made its files.
            for server in reversed(self.all):
                server.launch()
            return self.wait_ready()
        except BaseException:
            self.stop()
            raise

    def wait_ready(self) -> Self:
        """Return when all that were launched are ready. Raises ServerFailed."""
        for server in self.all:
            server.wait_ready()
        return self

    def check(self) -> None:
        """Raises ServerFailed where one of them has ended."""
        for server in self.all:
            server.process.check()

    def stop(self) -> None:
        with ExitStack() as stopping:  # If one cannot be stopped, the others still are.
            for server in self.all:
                stopping.callback(server.stop)

    def environment(self) -> dict[str, str]:
        """The settings under which a process of the service finds all of them."""
        return {name: value for server in self.all for name, value in server.environment().items()}

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
