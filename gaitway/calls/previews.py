"""Stills of bodies."""

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx

from gaitway.calls.asking import POLL_S, Asking
from gaitway.errors import WaitTimeout
from gaitway.steps import Call, Sleep
from gaitway.views import PreviewView


class PreviewCalls(Asking):
    """The call for stills."""

    def preview(
        self,
        environment: str,
        folder: str | Path | None,
        camera: str | int | None,
        asked: Mapping[str, Any],
        timeout: float,
    ) -> Call[Mapping[str | int, Path]]:
        path = f"/environments/{quote(environment)}/preview"
        bodies: dict[str | int, bytes] = {}
        if camera is None:
            drawn = yield from self._drawn(path, asked, timeout)
            for still in PreviewView.model_validate_json(drawn.content).stills:
                bodies[still.camera] = (yield from self._ask("GET", still.href)).content
        else:
            bodies[camera] = (yield from self._drawn(path, {**asked, "camera": camera}, timeout)).content
        target = Path(folder or ".")
        target.mkdir(parents=True, exist_ok=True)
        pictures = {seen: target / f"{environment}-{seen}.png".replace("/", "-") for seen in bodies}
        for seen, file in pictures.items():
            file.write_bytes(bodies[seen])
        return pictures

    def _drawn(self, path: str, asked: Mapping[str, Any], timeout: float) -> Call[httpx.Response]:
        """The answer once a worker has rendered."""
        deadline = time.monotonic() + timeout
        while (answer := (yield from self._ask("GET", path, params=asked))).status_code == 202:
            if time.monotonic() > deadline:
                raise WaitTimeout(
                    f"No worker has rendered it after {timeout:g} s; all may be busy with jobs."
                )
            yield Sleep(POLL_S)
        return answer


def preview_query(
    options: Mapping[str, Any] | None, show: Sequence[str], size: tuple[int, int]
) -> dict[str, Any]:
    return {
        "options": json.dumps(options or {}),
        "show": list(show),
        "width": size[0],
        "height": size[1],
    }
