"""Finds an OpenGL back-end that draws. Each is tried in its own process: a failed one spoils its process.

`python -m core.rendering.gl` prints the name that the back-end in MUJOCO_GL reports.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from core.errors import GaitwayError

REMEDY = "install Debian's packages libegl1, libgl1-mesa-dri and libopengl0 (software rendering needs no GPU)"
_TRIAL_TIMEOUT_S = 60.0
# The signals that end a process when its driver crashes.
DRIVER_CRASHES = (signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGILL)


class RenderingFailed(GaitwayError):
    """There is no video. reason: `no_gl`, `bad_request`, `crashed` or `timeout`."""

    code = "rendering-failed"
    title = "No video could be made"

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(detail, reason=reason)
        self.reason = reason


@dataclass(frozen=True)
class Backend:
    """A way to OpenGL: its name, and the environment variables of a process that uses it."""

    name: str
    environ: Mapping[str, str]


def no_gl(reasons: Mapping[str, str]) -> RenderingFailed:
    """The error when no back-end works. reasons: why, by back-end."""
    tried = "; ".join(f"{name}: {reason}" for name, reason in reasons.items())
    return RenderingFailed("no_gl", f"No OpenGL back-end can draw here ({tried}). Remedy: {REMEDY}.")


def backends(environ: Mapping[str, str], platform: str = sys.platform) -> list[Backend]:
    """The back-ends to try, best first; only the one in MUJOCO_GL if that is set.

    A job that may see one GPU draws on that one if EGL numbers GPUs the same way, and otherwise on the one
    that EGL chooses.
    """
    chosen = environ.get("MUJOCO_GL", "").lower()
    if chosen:
        return [Backend(chosen, {"MUJOCO_GL": chosen})]
    if platform == "darwin":
        return [Backend("cgl", {"MUJOCO_GL": "cgl"})]
    found = [Backend("egl", {"MUJOCO_GL": "egl"}), Backend("osmesa", {"MUJOCO_GL": "osmesa"})]
    gpu = environ.get("CUDA_VISIBLE_DEVICES", "").split(",")[0].strip()
    if gpu.isdecimal() and "MUJOCO_EGL_DEVICE_ID" not in environ:
        found.insert(0, Backend("egl", {"MUJOCO_GL": "egl", "MUJOCO_EGL_DEVICE_ID": gpu}))
    return found


def probe(environ: Mapping[str, str] | None = None) -> tuple[str, str]:
    """The first back-end that draws, and its renderer's name. Raises RenderingFailed("no_gl", ...)."""
    surroundings = dict(os.environ if environ is None else environ)
    reasons: dict[str, str] = {}
    for backend in backends(surroundings):
        try:
            done = subprocess.run(
                [sys.executable, "-m", "core.rendering.gl"],
                env={**surroundings, **backend.environ},
                capture_output=True,
                text=True,
                check=False,
                timeout=_TRIAL_TIMEOUT_S,
            )
        except subprocess.TimeoutExpired:
            reasons[backend.name] = f"no answer within {_TRIAL_TIMEOUT_S:.0f} s"
            continue
        if done.returncode == 0 and done.stdout.strip():
            return backend.name, done.stdout.strip().splitlines()[-1]
        reasons[backend.name] = last_line(done.stderr) or f"exit status {done.returncode}"
    raise no_gl(reasons)


def last_line(text: str) -> str:
    """The last line with anything on it; empty when there is none."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")


def context_works() -> str:
    """The name that the driver of a fresh GL context reports; `llvmpipe` means software.

    Raises whatever the back-end in MUJOCO_GL raises; after that the process cannot try another.
    """
    import mujoco

    context = mujoco.GLContext(64, 64)
    try:
        context.make_current()
        from OpenGL import GL  # Its import picks the platform from MUJOCO_GL.

        name: Any = GL.glGetString(GL.GL_RENDERER)  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    finally:
        context.free()
    if not name:
        raise RuntimeError("the driver does not say what it is")
    return name.decode() if isinstance(name, bytes) else str(name)


if __name__ == "__main__":
    sys.stdout.write(context_works() + "\n")
