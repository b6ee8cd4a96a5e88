"""Starts the processes of this package, and ends them for certain."""

import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import psutil

from core.settings import WorkerSettings
from worker.host.child import environment, launch

# How long wandb's uploader may take to notice that its parent is gone.
_GONE_S = 5.0


def start(
    arguments: Sequence[str], folder: Path, settings: WorkerSettings, *, with_key: bool
) -> subprocess.Popen[bytes]:
    """Start `python -m worker.tracking ...`; it dies with the calling thread.

    folder: its working directory and home, without settings of the user who runs the worker. with_key: it may
    talk to Weights & Biases.
    """
    return launch(
        [sys.executable, "-m", "worker.tracking", *arguments],
        _surroundings(folder, settings, with_key=with_key),
        stdin=subprocess.PIPE if with_key else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=folder,
    )


def end(child: subprocess.Popen[bytes]) -> None:
    """Kill it and all that it started, if they still run; returns when they are gone."""
    family: list[psutil.Process] = []
    with suppress(psutil.NoSuchProcess):
        family = psutil.Process(child.pid).children(recursive=True)
    with suppress(OSError):
        child.kill()
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    child.wait()
    psutil.wait_procs(family, _GONE_S)


def _matplotlibs_own() -> str:
    """The folder of its list of fonts, which takes seconds to make, so it is not among this job's files."""
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return os.environ.get("MPLCONFIGDIR") or str(Path(caches) / "matplotlib")


def _surroundings(folder: Path, settings: WorkerSettings, *, with_key: bool) -> dict[str, str]:
    base = environment("cpu", settings.data_dir.absolute(), os.environ)
    kept = {name: value for name, value in base.items() if not name.startswith("WANDB_")}
    kept |= {
        "HOME": str(folder),
        "TMPDIR": str(folder),
        "MPLCONFIGDIR": _matplotlibs_own(),
        "WANDB_DIR": str(folder),
        "WANDB_CACHE_DIR": str(folder),
        "WANDB_CONFIG_DIR": str(folder),
        "WANDB_DATA_DIR": str(folder),
        "WANDB_ERROR_REPORTING": "false",
    }
    if with_key and settings.wandb_api_key is not None:
        kept["WANDB_API_KEY"] = settings.wandb_api_key.get_secret_value()
    if with_key and settings.wandb_base_url is not None:
        kept["WANDB_BASE_URL"] = settings.wandb_base_url
    return kept
