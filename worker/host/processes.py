"""The processes of this machine, as Linux shows them."""

from collections.abc import Iterator
from pathlib import Path


def processes(proc: Path, name: str = "[0-9]*") -> Iterator[tuple[int, str, int]]:
    """Id, state and process group of every process (proc(5))."""
    for path in proc.glob(f"{name}/stat"):
        try:
            # The name, in parentheses, may hold anything; the fields behind it are plain.
            state, _, group = path.read_text().rpartition(")")[2].split()[:3]
        except (OSError, ValueError):  # It has just ended.
            continue
        yield int(path.parent.name), state, int(group)
