"""The file of a replay: a header in JSON, then the numbers of each episode; `docs/replay.md` describes it.

8 bytes  `GWREPLAY`
uint32   the version, 1 (little-endian, as all numbers)
uint32   the length of the header in bytes; with these 16 bytes it is a multiple of 8
header   JSON in UTF-8, followed by spaces
numbers  each array begins at a multiple of 8; the header says where
"""

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.rendering.replay.poses import EpisodePoses

MAGIC, VERSION = b"GWREPLAY", 1
_START = len(MAGIC) + 8


@dataclass(frozen=True)
class ReplayEpisode:
    """An episode of a replay. facts: for the header; returns: [N], the return until each frame."""

    poses: EpisodePoses
    returns: NDArray[np.floating[Any]]
    facts: Mapping[str, Any]


def replay_bytes(about: Mapping[str, Any], episodes: Iterable[ReplayEpisode]) -> bytes:
    """The file. about: the header's other fields."""
    numbers = bytearray()
    entries: list[dict[str, Any]] = []
    for episode in episodes:
        arrays = {**episode.poses.arrays, "return": episode.returns.astype(np.float32)}
        start = len(numbers)
        places = {name: _append(numbers, values, start) for name, values in arrays.items()}
        entries.append(
            {
                **episode.facts,
                "scale_m": episode.poses.scale_m,
                "parts": episode.poses.parts,
                "start": start,
                "length": len(numbers) - start,
                "arrays": places,
            }
        )
    header = json.dumps({**about, "episodes": entries}, separators=(",", ":")).encode()
    header += b" " * (-(_START + len(header)) % 8)
    return MAGIC + struct.pack("<II", VERSION, len(header)) + header + bytes(numbers)


def _append(numbers: bytearray, values: NDArray[Any], start: int) -> dict[str, Any]:
    """Append an array; returns its place, from the episode's start."""
    place = len(numbers) - start
    numbers += np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    numbers += b"\0" * (-len(numbers) % 8)
    return {"type": values.dtype.name, "shape": list(values.shape), "start": place}


def read_replay(content: bytes) -> tuple[dict[str, Any], list[dict[str, NDArray[Any]]]]:
    """The header, and the arrays of each episode. Raises ValueError if it is something else."""
    if content[: len(MAGIC)] != MAGIC:
        raise ValueError("This is not a replay: it does not begin with GWREPLAY.")
    version, length = struct.unpack_from("<II", content, len(MAGIC))
    if version != VERSION:
        raise ValueError(f"This replay has the version {version}; known is {VERSION}.")
    header = json.loads(content[_START : _START + length])
    first = _START + length
    return header, [
        {
            name: np.frombuffer(
                content, place["type"], int(np.prod(place["shape"])), first + entry["start"] + place["start"]
            ).reshape(place["shape"])
            for name, place in entry["arrays"].items()
        }
        for entry in header["episodes"]
    ]
