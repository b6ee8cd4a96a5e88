"""Stills by the real process: what they show, and what becomes of those that cannot be drawn."""

from pathlib import Path

import av
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from core.environments.catalog import find, parse_options
from core.errors import ObjectNotFound
from core.previews import library
from core.previews.record import Preview, PreviewRequest
from core.rendering.gl import probe
from core.storage import keys
from tests.in_memory import MemoryObjectStore
from tests.models import identity
from tests.unit.environments.mjcf.probe import XML
from worker.preview import drawing
from worker.preview.drawing import draw

# Red, so that it can be told from the floor.
MODEL = XML.replace(b'name="sphere" size="0.1"', b'name="sphere" size="0.1" rgba="1 0 0 1"')


def request(**changes: object) -> PreviewRequest:
    model = identity(MODEL)
    return PreviewRequest.model_validate(
        {
            "environment": "mjcf",
            "options": {"model": model, "reset": {"position_noise": 0.0}},
            "model": model,
            "cameras": ["track", "above"],
            "width": 64,
            "height": 48,
            **changes,
        }
    )


def drawn(folder: Path, objects: MemoryObjectStore, timeout_s: float = 60.0) -> Preview:
    draw(request(), objects, folder, folder, timeout_s)
    found = library.find(request(), objects)
    assert found is not None
    assert not [child for child in psutil.Process().children() if "worker.preview" in child.cmdline()]
    return found


@pytest.fixture
def objects() -> MemoryObjectStore:
    store = MemoryObjectStore()
    store.put(keys.model_source(identity(MODEL)), MODEL)
    return store


def pixels(body: bytes, folder: Path) -> NDArray[np.int64]:
    (folder / "picture.png").write_bytes(body)
    with av.open(str(folder / "picture.png")) as picture:
        return next(picture.decode(video=0)).to_ndarray(format="rgb24").astype(int)


@pytest.mark.extra
def test_each_camera_shows_the_body_and_nobody_draws_it_twice(
    tmp_path: Path, objects: MemoryObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", probe()[0])
    found = drawn(tmp_path, objects)
    assert found.failure is None, found.failure
    assert [still.camera for still in found.stills] == ["track", "above"]
    pictures = [pixels(objects.get(still.key), tmp_path) for still in found.stills]
    for picture in pictures:
        assert picture.shape == (48, 64, 3)
    shares = [np.mean((p[..., 0] > 100) & (p[..., 1] < 60) & (p[..., 2] < 60)) for p in pictures]
    # `track` stands near the ball; `above` 4.5 m over one of 0.1 m: a thousandth of its picture at most.
    assert shares[0] > 0.005
    assert 0 <= shares[1] < 0.002
    assert drawn(tmp_path, objects, timeout_s=0.0) == found


@pytest.mark.slow  # JAX is started, and their resets are compiled
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "environment", ["playground/PointMass", "brax/reacher", "brittle_star", "inverted_pendulum"]
)
def test_environments_of_every_family_are_drawn(
    environment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", probe()[0])
    store, info = MemoryObjectStore(), find(environment)
    defaults = parse_options(info, {}).model_dump(mode="json")
    wanted = request(environment=environment, options=defaults, model=None, cameras=["track"])
    draw(wanted, store, tmp_path, tmp_path)
    found = library.find(wanted, store)
    assert found is not None
    assert found.failure is None
    picture = pixels(store.get(found.stills[0].key), tmp_path)
    assert picture.shape == (48, 64, 3)
    assert picture.std() > 10


def test_where_nothing_draws_the_remedy_is_kept(
    tmp_path: Path, objects: MemoryObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    failure = drawn(tmp_path, objects).failure
    assert failure is not None
    assert failure.reason == "no_gl"
    assert "Remedy: install" in failure.message


def test_what_takes_too_long_is_ended_and_said(tmp_path: Path, objects: MemoryObjectStore) -> None:
    failure = drawn(tmp_path, objects, timeout_s=0.05).failure
    assert failure is not None
    assert (failure.reason, failure.message) == ("timeout", "It was not drawn within 0.05 s.")


def test_a_model_that_was_deleted_meanwhile_is_not_drawn(tmp_path: Path) -> None:
    with pytest.raises(ObjectNotFound):
        draw(request(), MemoryObjectStore(), tmp_path, tmp_path)


def test_h6a_a_link_that_drawing_leaves_is_not_followed(
    tmp_path: Path, objects: MemoryObjectStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret, folder = tmp_path / "keys.json", tmp_path / "preview"
    secret.write_bytes(b"TOP SECRET")
    folder.mkdir()

    def leave_links(*_: object) -> None:
        for number in range(2):
            (folder / f"{number}.png").symlink_to(secret)

    monkeypatch.setattr(drawing, "_attempt", leave_links)
    found = drawn(folder, objects)
    assert found.failure is not None
    assert "something else than its pictures" in found.failure.message
    assert all(objects.get(info.key) != b"TOP SECRET" for info in objects.list(""))


def test_h6a_a_reason_behind_a_link_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text('{"reason": "bad_request", "message": "TOP SECRET"}')
    (tmp_path / "failure.json").symlink_to(tmp_path / "keys.json")
    with (tmp_path / "log").open("w+b") as text:
        assert "TOP SECRET" not in drawing._why(1, tmp_path, text).message
