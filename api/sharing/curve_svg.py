"""Curves as SVG, in light and dark, without a script or a font of their own."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import isfinite, log10

from gaitway.schema import MetricsRow

RETURNS = ("eval/episode_reward", "training/episode_reward")
# Distinguishable by colour-blind readers, too (Okabe and Ito, 2008), on white and on black.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_WIDTH, _HEIGHT = 640, 240
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 28, 30
_STYLE = (
    "text{font:12px system-ui,sans-serif;fill:#57606a}.axis{stroke:#d0d7de}"
    "@media(prefers-color-scheme:dark){text{fill:#9aa5b1}.axis{stroke:#3d444d}}"
)


@dataclass(frozen=True)
class Line:
    """A metric's finite values over rising steps."""

    name: str
    steps: Sequence[int]
    values: Sequence[float]


@dataclass(frozen=True)
class _Axis:
    """Maps numbers from `low` to `high` to pixels from `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    def place(self, value: float) -> float:
        share = (value - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 1)

    def ticks(self) -> list[float]:
        """A few round numbers."""
        raw = (self.high - self.low) / 4
        size = 10.0 ** int(log10(raw) // 1)
        step = next(factor * size for factor in (1, 2, 5, 10) if factor * size >= raw)
        first = int(-(-self.low // step))
        return [number * step for number in range(first, int(self.high // step) + 1)]


def lines_of(rows: Sequence[MetricsRow], names: Sequence[str]) -> list[Line]:
    """The lines of these metrics; one that was never finite is left out."""
    found: list[Line] = []
    for name in names:
        points = [(row.step, row.values[name]) for row in rows if row.values.get(name) is not None]
        finite = [(step, value) for step, value in points if value is not None and isfinite(value)]
        if finite:
            found.append(Line(name, [step for step, _ in finite], [value for _, value in finite]))
    return found


def curve_svg(lines: Sequence[Line], title: str) -> str:
    """The lines over environment steps. Without any, a picture that says so."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" '
        f'role="img" aria-label="{escape(_label(lines, title))}"><style>{_STYLE}</style>'
    ]
    parts += _drawn(lines) if lines else [_text(_WIDTH / 2, _HEIGHT / 2, "nothing measured yet", "middle")]
    return "".join([*parts, "</svg>"])


def _label(lines: Sequence[Line], title: str) -> str:
    told = [f"{line.name}: last {line.values[-1]:.4g} at {line.steps[-1]:,}" for line in lines]
    return f"{title}. {'; '.join(told) or 'nothing measured yet'}"


def _drawn(lines: Sequence[Line]) -> list[str]:
    x = _axis([step for line in lines for step in line.steps], _LEFT, _WIDTH - _RIGHT)
    y = _axis([value for line in lines for value in line.values], _HEIGHT - _BOTTOM, _TOP)
    parts: list[str] = []
    for tick in y.ticks():
        at = y.place(tick)
        parts.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{at}" y2="{at}"/>')
        parts.append(_text(_LEFT - 6, at + 4, compact(tick), "end"))
    parts += [_text(x.place(tick), _HEIGHT - _BOTTOM + 16, compact(tick), "middle") for tick in x.ticks()]
    parts.append(_text(_WIDTH - _RIGHT, _HEIGHT - 2, "environment steps", "end"))
    left = _LEFT
    for number, line in enumerate(lines):
        colour = _COLOURS[number % len(_COLOURS)]
        path = " ".join(
            f"{x.place(step)},{y.place(value)}" for step, value in zip(line.steps, line.values, strict=True)
        )
        parts.append(f'<polyline fill="none" stroke="{colour}" stroke-width="1.6" points="{path}"/>')
        if len(line.steps) == 1:
            at = f'cx="{x.place(line.steps[0])}" cy="{y.place(line.values[0])}"'
            parts.append(f'<circle r="3" fill="{colour}" {at}/>')
        parts.append(f'<rect x="{left}" y="10" width="14" height="3" fill="{colour}"/>')
        parts.append(_text(left + 18, 16, line.name, "start"))
        left += 40 + 7 * len(line.name)
    return parts


def _axis(numbers: Sequence[float], start: float, end: float) -> _Axis:
    low, high = float(min(numbers)), float(max(numbers))
    if low == high:
        margin = abs(low) / 10 or 1.0
        low, high = low - margin, high + margin
    return _Axis(low, high, start, end)


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}">{escape(text)}</text>'


def compact(value: float) -> str:
    """3000000 as `3 M`, 250000 as `250 k`."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g} {letter}"
    return f"{value:.6g}"
