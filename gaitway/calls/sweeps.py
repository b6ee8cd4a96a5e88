"""Sweeps."""

import time
import uuid
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from gaitway.calls.asking import POLL_S, Asking
from gaitway.errors import WaitTimeout
from gaitway.steps import Call, Feed, Sleep
from gaitway.sweep_views import SweepView


class SweepCalls(Asking):
    """Calls about sweeps."""

    def sweep(
        self, spec: Mapping[str, Any] | None, idempotency_key: str | None, fields: Mapping[str, Any]
    ) -> Call[SweepView]:
        document = {**(spec or {}), **fields}
        if isinstance(job := document.get("job"), Mapping):
            document["job"] = {"kind": "train", **job}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._sweep("POST", "/sweeps", json=document, headers=headers)

    def get_sweep(self, sweep_id: str) -> Call[SweepView]:
        return self._sweep("GET", _sweep_path(sweep_id))

    def sweeps(self, limit: int | None, status: str | None) -> Feed:
        return self._all("/sweeps", SweepView, limit, {"status": status} if status is not None else {})

    def cancel_sweep(self, sweep_id: str) -> Call[SweepView]:
        return self._sweep("POST", _sweep_path(sweep_id, "cancel"))

    def resume_sweep(self, sweep_id: str, budget: Mapping[str, Any]) -> Call[SweepView]:
        return self._sweep("POST", _sweep_path(sweep_id, "resume"), json={"budget": budget})

    def delete_sweep(self, sweep_id: str) -> Call[None]:
        yield from self._ask("DELETE", _sweep_path(sweep_id))

    def wait_for_sweep(self, sweep_id: str, timeout: float | None) -> Call[SweepView]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while not (sweep := (yield from self.get_sweep(sweep_id))).is_final:
            if deadline is not None and time.monotonic() > deadline:
                raise WaitTimeout(
                    f"Sweep {sweep_id} is still {sweep.status} after {timeout:g} s; it continues."
                )
            yield Sleep(POLL_S)
        return sweep

    def _sweep(self, method: str, path: str, **content: Any) -> Call[SweepView]:
        answer = yield from self._ask(method, path, **content)
        return SweepView.model_validate_json(answer.content)


def _sweep_path(sweep_id: str, *parts: str) -> str:
    return "/".join(["/sweeps", *(quote(part, safe="") for part in (sweep_id, *parts))])
