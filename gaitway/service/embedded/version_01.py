"""What version 0.1 left in a folder of the embedded stack: its records, in Valkey's append-only file."""

import shlex
from collections.abc import Callable
from pathlib import Path

_RECORDS = Path("valkey") / "appendonlydir"
_IMPORTED = f"{_RECORDS.name}.imported"


def report_if_left(data_dir: Path, report: Callable[[str], None]) -> None:
    """Report whether there are records that are not imported yet."""
    if has_records(data_dir):
        report(
            f"{data_dir} has jobs of version 0.1, which are not listed until they are imported: end the "
            f"service, run `gaitway import-0.1 --data {shlex.quote(str(data_dir))}`, and start it again."
        )


def has_records(data_dir: Path) -> bool:
    """Whether there are records that are not imported yet."""
    return (data_dir / _RECORDS).is_dir()


def is_imported(data_dir: Path) -> bool:
    """Whether the records have been imported."""
    return not has_records(data_dir) and (data_dir / _RECORDS).with_name(_IMPORTED).exists()


def set_aside(data_dir: Path) -> Path:
    """Keep the records under another name, by which they count as imported; returns their new place."""
    records, number = data_dir / _RECORDS, 1
    target = records.with_name(_IMPORTED)
    while target.exists():  # Version 0.1 was used again after an import.
        number += 1
        target = records.with_name(f"{_IMPORTED}-{number}")
    return records.rename(target)
