"""Both servers of the embedded stack under one data folder."""

from pathlib import Path
from typing import Self

from gaitway.embedded.valkey import Valkey
from gaitway.embedded.weed import Weed


class EmbeddedServers:
    """Valkey and SeaweedFS, started together. They end with the thread that starts them."""

    def __init__(self, data_dir: Path) -> None:
        self.valkey = Valkey(data_dir / "valkey")
        self.weed = Weed(data_dir / "objects")

    def start(self) -> Self:
        """Return when both are ready. Raises ServerFailed, and leaves none behind then."""
        try:
            self.weed.launch()
            self.valkey.launch()
            self.valkey.wait_ready()
            self.weed.wait_ready()
        except BaseException:
            self.stop()
            raise
        return self

    def check(self) -> None:
        """Raises ServerFailed where one of them has ended."""
        self.valkey.process.check()
        self.weed.process.check()

    def stop(self) -> None:
        try:
            self.valkey.stop()
        finally:
            self.weed.stop()

    def environment(self) -> dict[str, str]:
        """The settings under which a process of the service finds both."""
        return {**self.valkey.environment(), **self.weed.environment()}

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()
