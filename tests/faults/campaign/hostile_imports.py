"""Imports that somebody has made to do harm: exports with parts that Hypothesis has put in their place.

`tests/api/test_hostile_imports.py` sends some, and the campaign's kind `imports` many.
"""

import io
import json
from collections.abc import Iterable
from typing import Any, cast
from zipfile import ZIP_DEFLATED, ZipFile

from hypothesis import strategies as st

_DOCUMENTS = ("job.json", "contents.json", "versions.json", "spec.json")
_LONG = 2**17
# Behind the job's path: all that can be read of one that was accepted.
PARTS = (
    *(
        "",
        "/metrics",
        "/metrics?points=100",
        "/metrics?format=csv",
        "/logs",
        "/events?follow=false",
    ),
    *("/specification", "/artifacts", "/checkpoints", "/export", "/report.html"),
)
_VALUES: st.SearchStrategy[Any] = st.one_of(
    st.sampled_from(
        [
            *(None, True, -1, 0, 2**63, 10**400, 1e308, float("inf"), float("nan"), "", "\0", "../x", "=1+1"),
            *("\ud800", "x" * _LONG, "\x1b[2J", "9999-12-31T23:59:59Z", "0001-01-01T00:00:00Z", "NaN"),
            *([], {}, [[]] * 3000, {f"k{n}": n for n in range(3000)}, [{"number": 1}] * 300),
        ]
    ),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=30),
        lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=10), inner, max_size=5),
        max_leaves=20,
    ),
    st.integers(1, 150).map(lambda depth: json.loads("[" * depth + "]" * depth)),
)


def _places(document: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to each part of the document."""
    inside: Iterable[tuple[Any, Any]] = ()
    if isinstance(document, dict):
        inside = cast("dict[str, Any]", document).items()
    elif isinstance(document, list):
        inside = enumerate(cast("list[Any]", document))
    return [place, *(one for name, value in inside for one in _places(value, (*place, name)))]


def _put(document: Any, place: tuple[Any, ...], value: Any) -> Any:
    if not place:
        return value
    here = document
    for name in place[:-1]:
        here = here[name]
    here[place[-1]] = value
    return document


@st.composite
def _rows(draw: st.DrawFn) -> bytes:
    """Metrics of any form: many names, long ones, numbers that are none, lines that are no JSON."""
    kind = draw(st.sampled_from(["names", "kinds", "lines", "values", "bytes"]))
    time, number = "2026-11-20T12:00:00Z", draw(st.integers(1, 3000))
    match kind:
        case "names":
            rows = [
                {"step": n, "time": time, "values": {f"m{n}/{k}": 0.5 for k in range(400)}}
                for n in range(number // 50)
            ]
        case "kinds":
            rows = [{"step": n, "time": time, "values": {f"m{n % 250}": n}} for n in range(number)]
        case "lines":
            rows = [{"step": number - n, "time": time, "values": {"a": n}} for n in range(number)]
        case "values":
            return (json.dumps(draw(_VALUES)) + "\n").encode("utf-8", "surrogatepass")
        case _:
            return draw(st.binary(max_size=2000))
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


@st.composite
def archives(draw: st.DrawFn, exported: bytes) -> bytes:
    """A zip made of a whole export, with one to three parts changed."""
    with ZipFile(io.BytesIO(exported)) as source:
        files = {name: source.read(name) for name in source.namelist()}
    for _ in range(draw(st.integers(1, 3))):
        match draw(st.sampled_from(["part", "part", "part", "part", "rows", "log", "file", "name"])):
            case "part":
                name = draw(st.sampled_from(_DOCUMENTS))
                try:
                    document = json.loads(files[name])
                except ValueError:  # It was changed to what is no JSON.
                    continue
                place = draw(st.sampled_from(_places(document)))
                changed = json.dumps(_put(document, place, draw(_VALUES)))
                files[name] = changed.encode("utf-8", "surrogatepass")
            case "rows":
                files["metrics.jsonl"] = draw(_rows())
            case "log":
                files["log.txt"] = draw(st.binary(max_size=5000)) + b"\n" * draw(st.integers(0, 3000))
            case "file":
                files[draw(st.sampled_from(sorted(files)))] = draw(st.binary(max_size=200))
            case _:
                files[draw(st.text(st.characters(codec="utf-8"), min_size=1, max_size=20))] = b""
    out = io.BytesIO()
    with ZipFile(out, "w", ZIP_DEFLATED) as target:
        for name, body in files.items():
            target.writestr(name, body)
    whole = out.getvalue()
    if draw(st.integers(0, 9)) == 0:  # The zip itself is damaged.
        at = draw(st.integers(0, len(whole) - 1))
        return whole[:at] + draw(st.sampled_from([b"", b"\xff"])) + whole[at + 1 :]
    return whole
