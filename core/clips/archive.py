"""Our own file of clips: one .npz without pickled objects, whose `about` is JSON text. NumPy alone."""

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from core.clips.clip import Clip, arrays

FORMAT = "gaitway-clips"
VERSION = 1


def to_bytes(clips: Sequence[Clip]) -> bytes:
    """The file's content; equal clips give equal bytes. Numbers are float32: angles keep 1e-7 rad.

    `about` names each clip, its rate and its joints; `clip_<i>/<field>` are the arrays of `Clip`.
    """
    about = {
        "format": FORMAT,
        "version": VERSION,
        "clips": [{"name": clip.name, "rate": clip.rate, "joints": list(clip.joints)} for clip in clips],
    }
    contents: dict[str, Any] = {"about": np.array(json.dumps(about, sort_keys=True))}
    for number, clip in enumerate(clips):
        contents |= {
            f"clip_{number}/{name}": value.astype(np.float32) for name, value in arrays(clip).items()
        }
    file = io.BytesIO()
    np.savez_compressed(file, **contents)
    return file.getvalue()


def from_file(path: Path) -> list[Clip]:
    """The clips of a file that `to_bytes` made. Raises ValueError if it is something else, or damaged."""
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path.name} is not a whole file of clips.")
    try:
        with np.load(path, allow_pickle=False) as file:
            return _clips({name: file[name] for name in file.files})
    except (zipfile.BadZipFile, EOFError, OSError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path.name} is not a whole file of clips: {error}") from None


def _clips(contents: dict[str, Any]) -> list[Clip]:
    about: dict[str, Any] = json.loads(str(contents["about"]))
    if (about.get("format"), about.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"This is not a {FORMAT} of version {VERSION}.")
    return [
        Clip(
            name=str(described["name"]),
            rate=float(described["rate"]),
            joints=tuple(str(name) for name in described["joints"]),
            **_arrays(contents, f"clip_{number}/"),
        )
        for number, described in enumerate(about["clips"])
    ]


def _arrays(contents: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {
        name.removeprefix(prefix): values.astype(np.float64)
        for name, values in contents.items()
        if name.startswith(prefix)
    }
