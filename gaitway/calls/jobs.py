"""Jobs: submitted, listed, cancelled, deleted."""

import uuid
from collections.abc import Mapping
from typing import Any

from gaitway.calls.asking import Asking, job_path, of_a_job, paged
from gaitway.steps import Call, Feed, Request
from gaitway.views import JobView, Page


class JobCalls(Asking):
    """Calls about whole jobs."""

    def submit(
        self, spec: Mapping[str, Any] | None, idempotency_key: str | None, fields: Mapping[str, Any]
    ) -> Call[JobView]:
        document = {"kind": "train", **(spec or {}), **fields}
        headers = {"Idempotency-Key": idempotency_key or uuid.uuid4().hex}
        return self._job(Request("POST", "/jobs", json=document, headers=headers))

    def list(self, limit: int | None, filters: Mapping[str, Any]) -> Feed:
        return paged(limit, lambda cursor, number: self.page(cursor, number, filters))

    def page(self, cursor: str | None, limit: int, filters: Mapping[str, Any]) -> Call[Page[JobView]]:
        labels: Mapping[str, str] = filters.get("labels") or {}
        params = {name: value for name, value in filters.items() if value is not None and name != "labels"}
        params |= {"label": [f"{name}={value}" for name, value in labels.items()], "limit": limit}
        response = yield from self._ask(
            "GET", "/jobs", params=params | ({"cursor": cursor} if cursor else {})
        )
        page = Page[JobView].model_validate_json(response.content)
        return page.model_copy(update={"items": [job.of(self.base_url) for job in page.items]})

    @of_a_job
    def cancel(self, job_id: str) -> Call[JobView]:
        return self._job(Request("POST", job_path(job_id, "cancel")))

    @of_a_job
    def delete(self, job_id: str) -> Call[None]:
        yield from self._ask("DELETE", job_path(job_id))

    @of_a_job
    def specification(self, job_id: str) -> Call[dict[str, Any]]:
        response = yield from self._ask("GET", job_path(job_id, "specification"))
        return response.json()
