"""The metrics of a feed without a model for each entry: a long run has hundreds of thousands."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import NamedTuple

import msgspec


class StepValues(msgspec.Struct, frozen=True, gc=False):
    """The data of an entry of the kind `metrics`. values: by name; None if a value is not finite."""

    step: int
    values: Mapping[str, float | None]


class Measured(NamedTuple):
    """time: seconds since 1970."""

    time: float
    said: StepValues


class _Line(msgspec.Struct, gc=False):
    id: str
    kind: str
    time: datetime
    data: msgspec.Raw


_lines = msgspec.json.Decoder(_Line)
_one = msgspec.json.Decoder(StepValues)
_several = msgspec.json.Decoder(list[StepValues])


def in_chunk(body: bytes, after: int = 0) -> Iterator[Measured]:
    """Those of the lines of a chunk, later than entry number `after`."""
    for line in _lines.decode_lines(body):
        if line.kind == "metrics" and int(line.id) > after:
            yield Measured(line.time.timestamp(), _one.decode(line.data))


def in_rows(times: Sequence[float], data: str) -> list[Measured]:
    """data: a JSON array of what the entries say."""
    return list(map(Measured, times, _several.decode(data)))
