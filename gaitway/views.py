"""The client's forms of answers: pages of lists, and events."""

import json
from collections.abc import Iterator
from datetime import datetime
from typing import Any, Generic, TypeVar

from gaitway.schema import FINAL_STATUSES, View
from gaitway.sse import ServerSentEvent

Item = TypeVar("Item")


class Page(View, Generic[Item]):
    """Some items, and the cursor of the next page (None at the end)."""

    items: list[Item]
    next: str | None = None

    def __iter__(self) -> Iterator[Item]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)


class Event(View):
    """Something that happened to a job. kind: status, progress, metrics, artifact, phase, or line."""

    id: str = ""
    kind: str
    time: datetime | None = None
    data: dict[str, Any] = {}

    @property
    def is_end(self) -> bool:
        """Whether the job has ended with this."""
        return self.kind == "status" and self.data.get("status") in FINAL_STATUSES


def event_of(sent: ServerSentEvent) -> Event:
    """The entry of a feed that a server-sent event carries."""
    document: dict[str, Any] = json.loads(sent.data)
    return Event(id=sent.id, kind=sent.kind, time=document.get("time"), data=document.get("data", {}))
