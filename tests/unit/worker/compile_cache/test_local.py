"""A machine's folder of compiled programs: lent by links, filled with whole files, kept within a bound."""

import errno
import os
import sys
import zlib
from pathlib import Path

import pytest

from worker.compile_cache import local
from worker.compile_cache.local import (
    is_whole,
    keep_within,
    lend,
    lend_copies,
    names,
    take_over,
    take_over_copies,
)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    return tmp_path / "kept"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    return tmp_path / "own"


def write(path: Path, body: bytes, used_at: float | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(body)
    if used_at is not None:
        os.utime(path, (used_at, used_at))


def test_a_job_is_lent_everything_without_a_copy(kept: Path, own: Path) -> None:
    write(kept / "warp" / "1" / "wp_a" / "a.meta", b"{}")
    lend(kept, own)
    assert (own / "warp/1/wp_a/a.meta").samefile(kept / "warp/1/wp_a/a.meta")


def test_a_job_may_be_the_first(kept: Path, own: Path) -> None:
    lend(kept, own)
    assert own.is_dir()


def test_what_is_new_is_taken_over_once(kept: Path, own: Path) -> None:
    write(kept / "jax" / "old", b"old")
    lend(kept, own)
    write(own / "jax" / "new-cache", zlib.compress(b"new"))
    assert take_over(own, kept) == ["jax/new-cache"]
    assert take_over(own, kept) == []
    assert names(kept) == {"jax/old", "jax/new-cache"}


def test_half_a_program_is_not_taken_over_until_it_is_whole(kept: Path, own: Path) -> None:
    body = zlib.compress(os.urandom(1000))
    write(own / "jax" / "f-cache", body[:-1])
    assert take_over(own, kept) == []
    write(own / "jax" / "f-cache", body)
    assert take_over(own, kept) == ["jax/f-cache"]


def test_what_warp_has_in_work_and_its_sources_stay_behind(kept: Path, own: Path) -> None:
    for name in ("wp_a/a.sm90.cubin", "wp_a/a.meta", "wp_a/wp_a.cu", "wp_b_p12_t3456/b.sm90.cubin"):
        write(own / "warp" / "1.18.0" / name, b"x")
    assert take_over(own, kept) == ["warp/1.18.0/wp_a/a.meta", "warp/1.18.0/wp_a/a.sm90.cubin"]


def test_code_that_is_still_being_written_stays_behind(kept: Path, own: Path) -> None:
    for name in ("3f1a", "tmpab_12"):
        write(own / "compiled" / name, b"x")
    assert take_over(own, kept) == ["compiled/3f1a"]


def test_a_zstandard_frame_without_its_library_is_not_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("zstandard", "compression.zstd"):
        monkeypatch.setitem(sys.modules, module, None)
    write(tmp_path / "f-cache", b"\x28\xb5\x2f\xfd....")
    assert not is_whole(tmp_path / "f-cache")


def test_what_was_not_used_for_longest_goes_first(kept: Path) -> None:
    for age, name in enumerate(["newest", "middle/deep/one", "oldest"]):
        write(kept / name, b"12345", used_at=1e9 - age)
    keep_within(kept, 15)
    assert names(kept) == {"newest", "middle/deep/one", "oldest"}
    keep_within(kept, 14)
    assert names(kept) == {"newest", "middle/deep/one"}
    keep_within(kept, 5)
    assert names(kept) == {"newest"}
    assert not (kept / "middle" / "deep").exists()


def test_being_read_counts_as_use(kept: Path) -> None:
    write(kept / "old, but read", b"12345")
    os.utime(kept / "old, but read", (2e9, 1e9))
    write(kept / "younger", b"12345", used_at=1.5e9)
    keep_within(kept, 5)
    assert names(kept) == {"old, but read"}


def test_a_disk_without_links_gets_copies(kept: Path, own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    write(kept / "jax" / "a", b"a")
    lend(kept, own)
    write(own / "jax" / "b", b"b")
    assert take_over(own, kept) == ["jax/b"]
    assert names(own) == names(kept) == {"jax/a", "jax/b"}


def test_h6b_a_job_with_a_users_model_changes_nothing_that_others_run(kept: Path, own: Path) -> None:
    """As the audit's cache_poison.py does it; and nothing that it adds reaches others' folder."""
    write(kept / "compiled" / "ant", b"machine code of the ant")
    models = kept.parent / "models"
    lent = lend_copies((models, kept), own)
    assert lent == {"compiled/ant"}
    (own / "compiled" / "ant").write_bytes(b"MACHINE CODE OF MALLORY")
    write(own / "compiled" / "planted", b"more of it")
    assert take_over_copies(own, models, lent) == ["compiled/planted"]
    assert (kept / "compiled" / "ant").read_bytes() == b"machine code of the ant"
    assert names(kept) == {"compiled/ant"}
    # The next job with this model starts with what this one left, and not through the same file.
    assert not (models / "compiled" / "planted").samefile(own / "compiled" / "planted")
    later = kept.parent / "later"
    assert lend_copies((models, kept), later) == {"compiled/ant", "compiled/planted"}


def test_h6b_nothing_is_taken_over_through_a_link(kept: Path, own: Path, tmp_path: Path) -> None:
    write(tmp_path / "secrets" / "keys.json", b"secret")
    write(own / "jax" / "plain", b"plain")
    (own / "jax" / "link").symlink_to(tmp_path / "secrets" / "keys.json")
    (own / "folder").symlink_to(tmp_path / "secrets")
    os.mkfifo(own / "pipe")
    kept.mkdir()
    assert take_over_copies(own, kept, set()) == ["jax/plain"]
    assert names(kept) == {"jax/plain"}


def test_h6b_copies_are_bounded_and_the_last_used_go_first(
    kept: Path, own: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "_MOST_COPIED_BYTES", 10)
    write(kept / "old", b"123456", used_at=1e9)
    write(kept / "new", b"123456", used_at=2e9)
    write(kept / "small", b"1234", used_at=1.5e9)
    assert lend_copies((kept,), own) == {"new", "small"}
    write(own / "made", b"123")
    write(own / "made-too", b"12345678")
    models = kept.parent / "models"
    models.mkdir()
    assert take_over_copies(own, models, {"new", "small"}) == ["made"]


def test_h6b_a_program_that_unpacks_without_end_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "_MOST_UNPACKED_BYTES", 1000)
    write(tmp_path / "bomb-cache", zlib.compress(bytes(10_000)))
    write(tmp_path / "small-cache", zlib.compress(bytes(900)))
    assert not is_whole(tmp_path / "bomb-cache")
    assert is_whole(tmp_path / "small-cache")


@pytest.mark.parametrize("can_share", [True, False])
def test_h6b_a_copy_is_whole_on_every_disk(
    can_share: bool, kept: Path, own: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.EOPNOTSUPP, "no")

    if not can_share:
        monkeypatch.setattr(os, "copy_file_range", refuse)
    body = os.urandom(3 * 2**20 + 17)
    write(kept / "large", body)
    lend_copies((kept,), own)
    assert (own / "large").read_bytes() == body
