"""Whether a worker of this machine can confine the processes that load a user's model."""

import json
import os
import tempfile
from pathlib import Path

from gaitway.service.doctor.check import Check, ProbeFailed, probe

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
