"""One finding of the doctor."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

State = Literal["pass", "warn", "fail", "skip"]


@dataclass(frozen=True)
class Check:
    """state: `skip` where there was nothing to check. remedy: what to do, unless the detail says it."""

    name: str
    state: State
    detail: str
    remedy: str = ""

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class ProbeFailed(Exception):
    """A probe's last line of output, or that it took too long."""


def probe(code: str, *, timeout_s: float, environ: Mapping[str, str] | None = None) -> str:
    """The output of this code in an interpreter of its own, so that a hang or crash stays outside.

    Raises ProbeFailed.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout_s,
            env=environ,
        )
    except subprocess.TimeoutExpired:
        raise ProbeFailed(f"no answer within {timeout_s:.0f} s") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        raise ProbeFailed(lines[-1] if lines else f"ended with {done.returncode}")
    return done.stdout.strip()
