"""Sweeps."""

import time
import uuid
from collections.abc import AsyncIterator, Mapping
from typing import Any

from gaitway.addresses import POLL_S, path_of
from gaitway.async_client.connection import AsyncConnection
from gaitway.concurrency import async_sleep
from gaitway.errors import WaitTimeout
from gaitway.schema import SweepDetails


class AsyncSweeps(AsyncConnection):
    """The methods about sweeps."""

    async def sweep(
        self, spec: Mapping[str, Any] | None = None, *, idempotency_key: str | None = None, **fields: Any
    ) -> SweepDetails:
        """Start a sweep, whose trials are jobs (docs/sweeps.md).

        `sweep(job={"environment": "ant"}, method="grid", parameters={"seed": [1, 2]})`; fields override those
        of `spec`, and the job's `kind` is `train` by default. Retries of the request make only one sweep.
        """
        document = {**(spec or {}), **fields}
        if isinstance(job := document.get("job"), Mapping):
            document["job"] = {"kind": "train", **job}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return await self._post("/sweeps", SweepDetails, json=document, headers=headers)

    async def get_sweep(self, sweep_id: str) -> SweepDetails:
        """The sweep as it is now, with its trials, the best so far and the importance of its axes."""
        return await self._get(path_of("sweeps", sweep_id), SweepDetails)

    def sweeps(self, *, limit: int | None = None, status: str | None = None) -> AsyncIterator[SweepDetails]:
        """Sweeps, newest first, without their trials; at most `limit`."""
        return self._all("/sweeps", SweepDetails, limit, {"status": status} if status is not None else {})

    async def change_sweep(self, sweep_id: str, **changes: Any) -> SweepDetails:
        """Change its name, labels and note, as a job's by `change`; its next trials get the labels."""
        answer = await self._request("PATCH", path_of("sweeps", sweep_id), json=changes)
        return SweepDetails.model_validate_json(answer.content, context=self)

    async def cancel_sweep(self, sweep_id: str) -> SweepDetails:
        """Start no more trials, and cancel those that run; they keep their work."""
        return await self._post(path_of("sweeps", sweep_id, "cancel"), SweepDetails)

    async def resume_sweep(self, sweep_id: str, **budget: Any) -> SweepDetails:
        """Continue under another budget, which counts the trials so far: `resume_sweep(id, jobs=40)`."""
        path = path_of("sweeps", sweep_id, "resume")
        return await self._post(path, SweepDetails, json={"budget": budget})

    async def delete_sweep(self, sweep_id: str) -> None:
        """Remove the record of an ended sweep; its jobs stay."""
        await self._request("DELETE", path_of("sweeps", sweep_id))

    async def wait_for_sweep(self, sweep_id: str, timeout: float | None = None) -> SweepDetails:
        """The sweep once it has ended. timeout: seconds; then it raises WaitTimeout."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not (sweep := await self.get_sweep(sweep_id)).is_final:
            if deadline is not None and time.monotonic() > deadline:
                raise WaitTimeout(
                    f"Sweep {sweep_id} is still {sweep.status} after {timeout:g} s; it continues."
                )
            await async_sleep(POLL_S)
        return sweep
