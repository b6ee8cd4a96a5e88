"""Stills that are kept: for equal requests, and no more of them than there is room for."""

from datetime import UTC, datetime, timedelta

from core.previews import library
from core.previews.record import PreviewRequest
from tests.in_memory import MemoryObjectStore

NOON = datetime(2026, 11, 20, 12, tzinfo=UTC)


def request(environment: str = "ant", **changes: object) -> PreviewRequest:
    return PreviewRequest.model_validate(
        {
            "environment": environment,
            "options": {},
            "cameras": ["track", 0],
            "width": 64,
            "height": 48,
            **changes,
        }
    )


def test_a_request_is_known_by_everything_that_its_stills_depend_on() -> None:
    others = [request("hopper"), request(width=65), request(options={"a": 1}), request(cameras=["track"])]
    others.append(request(show=["joints"]))
    assert len({one.id for one in [request(), request(), *others]}) == 6


def test_the_newest_that_was_drawn_is_found() -> None:
    objects = MemoryObjectStore()
    assert library.find(request(), objects) is None
    library.keep(request(), [b"new", b"new too"], objects, NOON + timedelta(seconds=0.5))
    library.keep(request(), [b"old", b"old too"], objects, NOON)
    found = library.find(request(), objects)
    assert found is not None
    assert [objects.get(still.key) for still in found.stills] == [b"new", b"new too"]
    assert library.find(request("hopper"), objects) is None


def test_the_oldest_go_first_and_whole() -> None:
    objects = MemoryObjectStore()
    for number, environment in enumerate(["walker2d", "a/b", "ant"]):
        pictures = [bytes(1000), bytes(1000)]
        library.keep(request(environment), pictures, objects, NOON + timedelta(hours=number))
    library.keep_within(5500, objects)  # Two have 4000 bytes and their records, three 6000.
    assert library.find(request("walker2d"), objects) is None
    assert {info.key.split("/")[1] for info in objects.list("previews/")} == {"a", "ant"}
    assert library.find(request("a/b"), objects) is not None
    library.keep_within(0, objects)
    assert list(objects.list("")) == []
