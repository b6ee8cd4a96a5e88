"""The service's environments and workers."""

import json
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from gaitway.calls.asking import Asking
from gaitway.steps import Call, Feed
from gaitway.views import EnvironmentView, WorkerView


class ServiceCalls(Asking):
    """Calls about the service itself."""

    def environments(self, family: str | None) -> Call[Sequence[EnvironmentView]]:
        query = f"?family={quote(family)}" if family else ""
        return self._items(f"/environments{query}", EnvironmentView)

    def environment(self, environment: str, options: Mapping[str, Any] | None) -> Call[EnvironmentView]:
        asked = {"options": json.dumps(options)} if options else None
        answer = yield from self._ask("GET", f"/environments/{quote(environment)}", params=asked)
        return EnvironmentView.model_validate_json(answer.content)

    def workers(self, limit: int | None) -> Feed:
        return self._all("/workers", WorkerView, limit)

    def health(self) -> Call[Mapping[str, Any]]:
        return (yield from self._ask("GET", "/readyz")).json()
