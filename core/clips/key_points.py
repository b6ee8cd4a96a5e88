"""A clip from a recording of key points: which points of the body they are, their unit, and how well the
clip follows them."""

import json
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from core.clips.clip import Clip
from core.clips.formats.key_points import KeyPoints
from core.clips.formats.recording import DAMAGED_ZIP, MOST_NUMBERS, check_text
from core.clips.inverse_kinematics import FITTED_FRAMES, BodyPoint, Solution, solve, spreads
from core.clips.quaternions import Array
from core.clips.record import MOST_SOLVING_S, KeyPointFacts
from core.clips.skeleton import listed, skeleton_of
from core.documents import Strict
from core.errors import BadClips

# The file beside the recording in a ZIP.
OPTIONS = "points.json"
# The processor time that solving may take for each frame, each of its points, and the square of the body's
# degrees of freedom: two to six times what it takes.
_SECONDS_A_FRAME, _SECONDS_A_POINT, _SECONDS_A_SQUARE = 5e-3, 5e-5, 1.2e-6
# A frame that offsets are fitted to takes as long as so many others: the search begins far from its pose.
_OF_FITTED = 5
# Bytes in a ZIP, unpacked.
_LARGEST_OPTIONS, _LARGEST_RECORDING = 2**20, 8 * MOST_NUMBERS
# The units that a file may have, each in metres.
_UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "metres": 1.0}
# In the right unit, the key points are less than three times as far apart as the body's points, and more than
# a third.
_MOST_APART = 3.0
# The highest coordinate of a point, in m.
_FARTHEST = 1000.0
# Fewer frames a second than a motion has: perhaps NWB's times are numbers of frames, not seconds.
_FEW_FRAMES = 5.0
# Warn of key points that are on average farther from the body than this share of the body's size,
_FAR = 0.05
# of a body whose points are farther apart, or nearer together, than the key points by this share,
_OTHER_SIZE = 0.05
# and of key points that are seen in less than this share of the frames.
_SELDOM = 0.5
_READY = TypeAdapter(dict[str, BodyPoint])


class KeyPointOptions(Strict):
    """What `points.json` says of a recording.

    points: which point of which body each key point is; None: those of stac-mjx's rat, if the file has its
    key points. names: of the key points, in the file's order; None: the file's own, or for a file without
    names those of `points` in their order. scale: metres of one of the file's units; None: guessed from the
    body's size. lift: how far the recording is raised, in m. fit_offsets: `rounds` of `solve`.
    """

    points: dict[str, BodyPoint] | None = Field(None, max_length=1000)
    names: list[str] | None = None
    scale: float | None = Field(None, gt=0)
    lift: float = Field(0.0, ge=-_FARTHEST, le=_FARTHEST)
    fit_offsets: int = Field(2, ge=0, le=20)


@dataclass(frozen=True, eq=False)
class Solved:
    """clip: without velocities. key_points: those that are used. warnings: sentences on what may be wrong."""

    clip: Clip
    key_points: Sequence[KeyPointFacts]
    warnings: Sequence[str]


def unpacked(path: Path) -> tuple[Path, KeyPointOptions | None]:
    """The recording of a ZIP that has `points.json`, unpacked beside the ZIP; any other file as it is.

    Raises BadClips.
    """
    if not zipfile.is_zipfile(path):
        return path, None
    try:
        with zipfile.ZipFile(path) as packed:
            # A ZIP made on a Mac has files of the Mac's own, which all begin with a dot.
            members = [
                one
                for one in packed.infolist()
                if not one.is_dir() and not Path(one.filename).name.startswith(".")
            ]
            said = [one for one in members if Path(one.filename).name == OPTIONS]
            others = [one for one in members if one not in said]
            if not said:
                return path, None
            if (len(said), len(others)) != (1, 1):
                raise BadClips(
                    f"A ZIP with `{OPTIONS}` has one recording beside it; this one has {len(said)} such and "
                    f"{len(others)} other files."
                )
            if said[0].file_size > _LARGEST_OPTIONS or others[0].file_size > _LARGEST_RECORDING:
                raise BadClips(f"The ZIP is too large: its recording may have {_LARGEST_RECORDING:,} bytes.")
            options = options_of(packed.read(said[0]))
            recording = path.with_name(f"{path.name}.recording")
            recording.write_bytes(packed.read(others[0]))
    except DAMAGED_ZIP as error:
        raise BadClips(f"The ZIP is not whole: {error}.") from None
    return recording, options


def options_of(content: bytes) -> KeyPointOptions:
    """The options in a `points.json`. Raises BadClips, which names the field."""
    try:
        json.loads(content, object_pairs_hook=_unique)
        options = KeyPointOptions.model_validate_json(content)
    except ValidationError as error:
        found = error.errors()[0]
        place = ".".join(str(part) for part in found["loc"])
        raise BadClips(f"`{OPTIONS}`{f' at `{place}`' if place else ''}: {found['msg']}.") from None
    except (ValueError, RecursionError) as error:
        raise BadClips(f"`{OPTIONS}` is no JSON: {error}.") from None
    points = options.points or {}
    for name in (*points, *(point.body for point in points.values()), *(options.names or ())):
        check_text(name)
    return options


def seconds_for(found: KeyPoints, options: KeyPointOptions, model: mujoco.MjModel) -> int:
    """The processor time that solving may take. Raises BadClips for a recording that is too long."""
    num_frames, num_points = found.points.shape[:2]
    num_points = len(options.points) if options.points else num_points
    of_a_frame = _SECONDS_A_FRAME + num_points * _SECONDS_A_POINT + model.nv**2 * _SECONDS_A_SQUARE
    fitted = _OF_FITTED * options.fit_offsets * min(num_frames, FITTED_FRAMES)
    seconds = round((num_frames + fitted) * of_a_frame)
    if seconds > MOST_SOLVING_S:
        most = max(0, int(MOST_SOLVING_S / of_a_frame) - fitted)
        raise BadClips(
            f"The recording has {num_frames:,} frames; for this body, with {num_points} key points and "
            f"`fit_offsets` {options.fit_offsets}, {most:,} are solved at most. Cut it into several files."
        )
    return seconds


def solved(  # As `solve`.
    found: KeyPoints,
    options: KeyPointOptions,
    model: mujoco.MjModel,
    *,
    rate: float,
    name: str,
    begin: Callable[[int, int], object] = lambda frame, num_frames: None,
) -> Solved:
    """The clip that follows the recording. rate: frames per second. name: the clip's. begin: as of `solve`.

    Raises BadClips.
    """
    said = options.names or found.names
    mapping = options.points or _ready(said, found.points.shape[1], model)
    names = _names(said or tuple(mapping), found)
    scale, warnings = _scale(found.points, names, mapping, model, options)
    if (farthest := np.nanmax(np.abs(found.points)) * scale) > _FARTHEST:
        raise BadClips(
            f"A key point is {farthest:,.3g} m from the origin; at most {_FARTHEST:,.0f} m is read."
        )
    points = found.points * scale + np.array([0.0, 0.0, options.lift])
    solution = solve(
        points, names, mapping, model, rate=rate, name=name, rounds=options.fit_offsets, begin=begin
    )
    facts = [
        _facts(one, point, solution, solution.distances[:, names.index(one)])
        for one, point in mapping.items()
    ]
    if said is None:
        warnings.append(f"The file has no names: its key points are taken to be {', '.join(names)}.")
    if left := [one for one in names if one not in mapping]:
        warnings.append(f"The key points {listed(left)} are not used: `points` does not name them.")
    return Solved(solution.clip, facts, [*warnings, *_misfits(facts, solution, scale, model)])


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object's members. Raises ValueError where two have the same name: the parser keeps the last."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"it has {next(name for name in names if names.count(name) > 1)!r} twice")
    return found


@cache
def _rodent() -> Mapping[str, BodyPoint]:
    """The key points of DANNCE's rat as points of dm_control's rat.

    Their bodies are those of stac-mjx's `rodent.yaml`. The offsets of joints are read off the model; those of
    the head and the spine are estimates.
    """
    return _READY.validate_json(Path(__file__).with_name("rodent_points.json").read_bytes())


def _ready(names: Sequence[str] | None, number: int, model: mujoco.MjModel) -> Mapping[str, BodyPoint]:
    """The rat's points. Raises BadClips where the model is not the rat's, or the key points are not.

    names: of the key points; None: the file has none, and their number decides.
    """
    ready = _rodent()
    bodies = {str(model.body(body).name) for body in range(model.nbody)}
    fits = len(ready) == number if names is None else ready.keys() <= set(names)
    if fits and {point.body for point in ready.values()} <= bodies:
        return ready
    has = f"{number} key points without names" if names is None else f"the key points {listed(names)}"
    raise BadClips(
        f"The file has {has}, and does not say which points of the body they are: send it in a ZIP with "
        f"`{OPTIONS}`, as docs/imitation.md says."
    )


def _names(names: Sequence[str], found: KeyPoints) -> Sequence[str]:
    """The names. Raises BadClips where there are not as many as key points, or two are the same."""
    if len(names) != found.points.shape[1]:
        raise BadClips(
            f"The file has {found.points.shape[1]} key points and {len(names)} names: give `names` in "
            f"`{OPTIONS}`."
        )
    if len(set(names)) < len(names):
        twice = next(name for name, number in Counter(names).items() if number > 1)
        raise BadClips(f"Two key points are called {twice!r}.")
    return names


def _scale(
    points: Array,
    names: Sequence[str],
    mapping: Mapping[str, BodyPoint],
    model: mujoco.MjModel,
    options: KeyPointOptions,
) -> tuple[float, list[str]]:
    """Metres of one of the file's units, and a warning where the unit was guessed and is not the metre.

    Raises BadClips where no unit makes the key points about as large as the body.
    """
    theirs, ours = spreads(points, names, mapping, model)
    if not ours:
        raise BadClips("The points of the body are all in one place.")
    units = _UNITS if options.scale is None else {"given": options.scale}
    for unit, scale in units.items():
        if 1 / _MOST_APART < theirs * scale / ours < _MOST_APART:
            told = (
                f"The key points are read as {unit}: in metres they are {theirs / ours:,.0f} times the body."
            )
            return scale, [told] if unit in ("millimetres", "centimetres") else []
    raise BadClips(
        f"The key points are {theirs * (options.scale or 1.0) / ours:.3g} times as far apart as the body's: "
        f"give `scale` in `{OPTIONS}`, metres of one of the file's units."
    )


def _facts(name: str, point: BodyPoint, solution: Solution, distances: Array) -> KeyPointFacts:
    """The facts that the record keeps of a key point. distances: [T] m, NaN in frames that do not show it."""
    seen = distances[np.isfinite(distances)]
    x, y, z = solution.offsets[name].round(6).tolist()
    return KeyPointFacts(
        name=name,
        body=point.body,
        offset=(x, y, z),
        num_seen=len(seen),
        mean_distance=float(seen.mean()) if len(seen) else None,
        worst_distance=float(seen.max()) if len(seen) else None,
    )


def _misfits(
    facts: Sequence[KeyPointFacts], solution: Solution, scale: float, model: mujoco.MjModel
) -> Iterator[str]:
    """Warnings of a poor fit. scale: metres of one of the file's units."""
    size, num_frames = skeleton_of(model).size, solution.clip.num_frames
    if (rate := solution.clip.rate) < _FEW_FRAMES:
        yield f"The recording has {rate:g} frames a second, which are few: the rate may be wrong."
    if far := [one.name for one in facts if (one.mean_distance or 0) > _FAR * size]:
        worst = max(one.mean_distance or 0 for one in facts)
        yield (
            f"The key points {listed(far)} are on average up to {worst * 1000:.0f} mm from the body's: "
            "they may be others than `points` says."
        )
    if abs(solution.spread - 1) > _OTHER_SIZE:
        yield (
            f"The body's points are {solution.spread:.2f} times as far apart as the key points: a `scale` of "
            f"{scale * solution.spread:.3g} fits better."
        )
    if seldom := [one.name for one in facts if one.num_seen < _SELDOM * num_frames]:
        yield f"The key points {listed(seldom)} are seen in less than half of the frames."
