"""A process that loads a user's model keeps to its own files: no secret on this machine's disks is readable.

This is weaker than the confinement in which a model is validated (`worker/confinement/confinement.py`): a
training needs its GPUs, threads, programs and signals. It imports only the standard library.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from worker.confinement import landlock, privileges
from worker.confinement.confinement import PACKAGES, plugin_folders

_CODE = Path(__file__).resolve().parents[2]
# Folders of sys.path that lie around this one are not ours: a checkout may hold an `.env`, and the folder
# around `site-packages` may be the user's home.
_AROUND_OURS = _CODE.parents[2] if _CODE.name == "_service" else _CODE
# Programs, libraries and drivers, and what they ask about the machine. Of /etc, what is no secret.
_SYSTEM = (
    *("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/nix/store", "/proc", "/sys"),
    *("/run/current-system", "/run/opengl-driver", "/run/udev", "/run/nvidia-persistenced"),
)
_ETC = (
    *("alternatives", "drirc", "fonts", "glvnd", "group", "host.conf", "hosts", "ld.so.cache", "ld.so.conf"),
    *("ld.so.conf.d", "localtime", "nccl.conf", "nsswitch.conf", "nvidia", "OpenCL", "os-release", "passwd"),
    *("resolv.conf", "vulkan"),
)
_DEVICES = (
    *("null", "zero", "full", "random", "urandom", "tty", "pts", "ptmx", "shm"),
    *("nvidia*", "dri", "kfd", "dxg", "infiniband"),
)
# Where libraries keep what they compiled or found, if they have kept any. What of it is new is lost.
_CACHES = (
    *(".nv", ".cache/fontconfig", ".cache/matplotlib", ".config/matplotlib"),
    *(".cache/mesa_shader_cache", ".cache/mesa_shader_cache_db", ".cache/nvidia"),
)
_NAMED_CACHES = ("CUDA_CACHE_PATH", "JAX_COMPILATION_CACHE_DIR", "MPLCONFIGDIR", "WARP_CACHE_PATH")
# Root keeps capabilities for files, which Landlock limits, for pinned memory and for threads'
# priorities. With others, it could read another process's memory.
_CAPABILITIES = (0, 1, 3, 4, 14, 23)
_NAMED_LIBRARIES = ("LD_LIBRARY_PATH", "CUDA_HOME", "CUDA_PATH")


def keep_to_own_files(folder: Path) -> bool:
    """Confine this process and all it starts, for good; False if the kernel has no Landlock.

    It reads programs, libraries and their caches, and what describes the machine, and uses devices. It writes
    to its folder alone, where its temporary files go from now on. GAITWAY_MODELS=unconfined leaves it free.
    """
    if os.environ.get("GAITWAY_MODELS") == "unconfined" or not landlock.version():
        return False
    scratch = folder / "tmp"
    scratch.mkdir(exist_ok=True)
    os.environ["TMPDIR"] = str(scratch)
    try:
        privileges.give_up(*_CAPABILITIES)
        landlock.restrict(
            # Others would run what it wrote into libraries' caches.
            readable=[*_readable(folder), *_caches()],
            listable=[Path("/")],
            writable=[],
            free=[folder, Path("/proc/self"), *_devices()],
            files_only=True,
        )
    except OSError as error:  # It was validated in full confinement: this is a second line.
        sys.stderr.write(f"This process could not be kept to its own files: {error}\n")
        return False
    return True


def _readable(folder: Path) -> Iterator[Path]:
    yield from map(Path, _SYSTEM)
    yield from (Path("/etc", name) for name in _ETC)
    yield from (_CODE / name for name in PACKAGES)
    yield from plugin_folders()
    named = [path for name in _NAMED_LIBRARIES for path in os.environ.get(name, "").split(":")]
    yield from (Path(path) for path in (sys.prefix, sys.base_prefix, sys.exec_prefix) if path != "/")
    for path in {*sys.path, *named} - {""}:
        found = Path(path).resolve()
        # One around the folder may hold all data.
        if not any(one.is_relative_to(found) for one in (folder, _AROUND_OURS)):
            yield found


def _devices() -> Iterator[Path]:
    for name in _DEVICES:
        yield from Path("/dev").glob(name)
    yield Path(os.environ.get("CUDA_MPS_PIPE_DIRECTORY", "/tmp/nvidia-mps"))  # noqa: S108 # Its default.


def _caches() -> Iterator[Path]:
    yield from (Path.home() / name for name in _CACHES)
    yield from (Path(os.environ[name]) for name in _NAMED_CACHES if os.environ.get(name))
