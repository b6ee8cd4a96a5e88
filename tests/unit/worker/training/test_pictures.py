"""Numbers that a job keeps, and their pictures by a real process."""

import io
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.environments import trajectory
from core.environments.trajectory import Trajectory
from tests.unit.rendering.conftest import rolling_ball
from worker.training import pictures
from worker.training.event_writer import EventWriter


class Heard:
    """A channel, and what was said through it by now."""

    def __init__(self, spool: Path) -> None:
        self._read, write = os.pipe()
        os.set_blocking(self._read, False)
        self.events = EventWriter(spool, write)

    def messages(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in os.read(self._read, 65536).splitlines()]


@pytest.fixture
def heard(tmp_path: Path) -> Iterator[Heard]:
    yield (heard := Heard(tmp_path))
    heard.events._pipe.close()
    os.close(heard._read)


@pytest.mark.extra
def test_a_trajectory_is_kept_at_once_and_its_picture_when_the_block_is_over(
    heard: Heard, tmp_path: Path
) -> None:
    shown = Trajectory(
        [rolling_ball(1.0), rolling_ball(2.0)], {"arrays": {}, "format": trajectory.FORMAT, "version": 1}
    )
    with pictures.kept_with_path(heard.events, shown, "-7", 7, "ball"):
        [first] = heard.messages()
        (tmp_path / first["path"]).unlink()  # as the supervisor does, once it is stored
    [second] = heard.messages()
    assert (first["name"], first["role"], first["step"]) == ("trajectory-7.npz", "trajectory", 7)
    assert (second["name"], second["role"], second["metadata"]) == ("path-7.png", "picture", {"episodes": 2})
    assert [path.name for path in tmp_path.iterdir()] == ["path-7.png"]


def test_tables_are_kept_with_a_picture_of_each_that_is_known(heard: Heard, tmp_path: Path) -> None:
    tables = {"q_table": np.eye(3), "visits": np.ones((3, 3), int), "history": np.zeros(5)}
    with pictures.kept_with_tables(heard.events, tables, 40, "ball"):
        pass
    said = heard.messages()
    assert [(file["name"], file["role"], file["step"]) for file in said] == [
        ("tables.npz", "tables", 40),
        ("q_table.png", "picture", 40),
        ("visits.png", "picture", 40),
    ]
    with np.load(io.BytesIO((tmp_path / "tables.npz").read_bytes()), allow_pickle=False) as back:
        assert set(back) == set(tables)
        np.testing.assert_array_equal(back["q_table"], np.eye(3))


def test_what_cannot_be_drawn_costs_a_note_and_no_more(
    heard: Heard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pictures.kept_with_tables(heard.events, {"q_table": np.zeros(3)}, 1, ""):
        pass
    kept, note = heard.messages()
    assert kept["name"] == "tables.npz"
    assert note["text"].startswith("There is no picture of the tables: ValueError: A table has the axes")
    monkeypatch.setattr(pictures, "find_spec", lambda name: None)
    with pictures.kept_with_tables(heard.events, {"q_table": np.eye(3)}, 1, ""):
        pass
    assert "uv sync --inexact --extra plots" in heard.messages()[1]["text"]
