from pathlib import Path

import numpy as np
import pytest

from core.clips import archive
from core.clips.clip import arrays, with_velocities
from tests.unit.clips.test_clip import turning


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "clips.npz"
    path.write_bytes(archive.to_bytes([turning(), with_velocities(turning(30.0, name="walk"))]))
    plain, moving = archive.from_file(path)
    assert (plain.name, plain.rate, plain.joints, plain.has_velocities) == ("turn", 10.0, ("knee",), False)
    assert (moving.name, moving.rate, moving.has_velocities) == ("walk", 30.0, True)
    for name, values in arrays(with_velocities(turning(30.0))).items():
        np.testing.assert_allclose(getattr(moving, name), values, atol=1e-6, err_msg=name)
        assert getattr(moving, name).dtype == np.float64


def test_equal_clips_give_equal_bytes() -> None:
    assert archive.to_bytes([turning()]) == archive.to_bytes([turning()])


@pytest.mark.parametrize("content", [b"", b"PK nothing", archive.to_bytes([turning()])[:300]])
def test_a_damaged_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "clips.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"clips\.npz is not a whole file of clips"):
        archive.from_file(tmp_path / "clips.npz")


def test_another_npz_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", about=np.array('{"format": "gaitway-trajectory", "version": 1}'))
    with pytest.raises(ValueError, match="not a gaitway-clips of version 1"):
        archive.from_file(tmp_path / "other.npz")


def test_pickled_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "objects.npz", about=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        archive.from_file(tmp_path / "objects.npz")
