"""Small disks in memory, which can be full: mounted where nobody outside this process sees them.

A mount namespace of one's own is a matter of root, or of a kernel that lets users have namespaces.
"""

import ctypes
import os
from contextlib import suppress
from pathlib import Path

_CLONE_NEWNS, _CLONE_NEWUSER = 0x20000, 0x10000000
_MS_REMOUNT, _MS_REC, _MS_PRIVATE = 0x20, 0x4000, 0x40000
_PAGE = 4096


def take_own_mounts() -> bool:
    """From now on this process, of one thread still, may mount disks that go with it; whether that worked."""
    user, group = os.geteuid(), os.getegid()
    try:
        _call("unshare", _CLONE_NEWNS if user == 0 else _CLONE_NEWUSER | _CLONE_NEWNS)
        if user != 0:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
            Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
        _call("mount", b"none", b"/", None, _MS_REC | _MS_PRIVATE, None)
    except OSError:
        return False
    return True


class Disk:
    """A disk of so many MiB at a folder that is there."""

    def __init__(self, folder: Path, size_mib: int) -> None:
        self._folder = folder
        self._size = size_mib * 2**20
        self._mount(0, self._size)

    def fill(self) -> None:
        """Leave no room: it becomes as small as what it holds."""
        for _ in range(20):  # Somebody may be just writing to it.
            facts = os.statvfs(self._folder)
            with suppress(OSError):
                self._mount(_MS_REMOUNT, max(_PAGE, (facts.f_blocks - facts.f_bfree) * facts.f_frsize))
                return

    def free(self) -> None:
        self._mount(_MS_REMOUNT, self._size)

    def _mount(self, flags: int, size: int) -> None:
        _call("mount", b"tmpfs", os.fsencode(self._folder), b"tmpfs", flags, f"size={size}".encode())


def _call(name: str, *arguments: object) -> None:
    if getattr(ctypes.CDLL(None, use_errno=True), name)(*arguments) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
