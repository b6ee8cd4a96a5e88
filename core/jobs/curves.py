"""A job's metrics as columns, in memory and as bytes."""

import hashlib
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from math import nan
from typing import Self

import msgspec

from core.bounds import MOST_METRICS
from core.jobs.measured import Measured

_DIGEST_BYTES = 32


@dataclass
class Curve:
    """One metric of a job: values over rising steps. times: seconds since 1970; nan: not finite."""

    steps: "array[int]" = field(default_factory=lambda: array("q"))
    times: "array[float]" = field(default_factory=lambda: array("d"))
    values: "array[float]" = field(default_factory=lambda: array("d"))

    def __len__(self) -> int:
        return len(self.steps)

    def add(self, step: int, time: float, value: float) -> None:
        """Append a value. One of an earlier step comes from an attempt that began again at a checkpoint: it
        replaces what followed that checkpoint."""
        self._cut(step)
        self.steps.append(step)
        self.times.append(time)
        self.values.append(value)

    def extend(self, later: "Curve") -> None:
        """Append what was measured later, with the effect of `add` for each of its values in their order.

        The first step of `later` is the least that its values ever had, so it replaces all that `add` would.
        """
        if later.steps:
            self._cut(later.steps[0])
            self.steps += later.steps
            self.times += later.times
            self.values += later.values

    def _cut(self, step: int) -> None:
        if self.steps and step <= self.steps[-1]:
            kept = bisect_left(self.steps, step)
            del self.steps[kept:], self.times[kept:], self.values[kept:]

    def between(self, first_step: int | None, last_step: int | None) -> range:
        """The places of the values of these steps, both included."""
        start = 0 if first_step is None else bisect_left(self.steps, first_step)
        end = len(self) if last_step is None else bisect_right(self.steps, last_step)
        return range(start, max(start, end))


class Curves(dict[str, Curve]):
    """Metrics by name."""

    @classmethod
    def of(cls, measured: Iterable[Measured]) -> Self:
        """All of their metrics."""
        curves = cls()
        curves.add(measured)
        return curves

    def add(self, measured: Iterable[Measured], names: Collection[str] | None = None) -> None:
        """Append values. names: only these metrics; None: all, up to `MOST_METRICS`."""
        for time, said in measured:
            for name, value in said.values.items():
                if names is None or name in names:
                    if (curve := self.get(name)) is None:
                        if len(self) >= MOST_METRICS:
                            continue
                        curve = self[name] = Curve()
                    curve.add(said.step, time, nan if value is None else value)

    def extend(self, later: "Curves") -> None:
        """Append what was measured later."""
        for name, curve in later.items():
            self.setdefault(name, Curve()).extend(curve)

    @property
    def num_values(self) -> int:
        return sum(map(len, self.values()))


class _Columns(msgspec.Struct):
    """Numbers of 8 bytes, little-endian as every machine that this runs on.

    axes: steps and times, once for all metrics that are measured together. curves: by name, a place in
    `axes`, and values.
    """

    axes: list[tuple[bytes, bytes]]
    curves: dict[str, tuple[int, bytes]]


_decoder = msgspec.msgpack.Decoder(_Columns)


def encode(curves: Curves) -> bytes:
    """The columns in msgpack, behind their SHA-256."""
    places = dict[tuple[bytes, bytes], int]()
    stored = dict[str, tuple[int, bytes]]()
    for name, curve in curves.items():
        place = places.setdefault((curve.steps.tobytes(), curve.times.tobytes()), len(places))
        stored[name] = (place, curve.values.tobytes())
    packed = msgspec.msgpack.encode(_Columns(list(places), stored))
    return hashlib.sha256(packed).digest() + packed


def decode(body: bytes, names: Collection[str] | None = None) -> Curves | None:
    """What `encode` wrote, or of it these metrics alone; None if the bytes are damaged."""
    packed = memoryview(body)[_DIGEST_BYTES:]
    if hashlib.sha256(packed).digest() != body[:_DIGEST_BYTES]:
        return None
    columns = _decoder.decode(packed)
    curves = Curves()
    for name, (place, values) in columns.curves.items():
        if names is None or name in names:
            steps, times = columns.axes[place]
            curves[name] = Curve(array("q", steps), array("d", times), array("d", values))
    return curves
