"""A process gives up its privileges, for good."""

import ctypes
import os
import stat
import sys
from pathlib import Path

_PR_SET_NO_NEW_PRIVS = 38
_CAPABILITIES_VERSION_3 = 0x20080522
# Users that nobody has: far above those of people and services. A process' id is never as large as this.
_FIRST_USER, _NUM_USERS = 2_000_000_000, 2**22


def give_up(*kept: int) -> None:
    """Keep no capability but these, and gain none by starting another program.

    kept: their numbers, as in capabilities(7), where the process has them. Raises OSError.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    header, words = (ctypes.c_uint32 * 2)(_CAPABILITIES_VERSION_3, 0), (ctypes.c_uint32 * 6)()
    if libc.capget(ctypes.byref(header), ctypes.byref(words)) != 0:
        _fail("capget")
    # Effective, permitted and inheritable, of capabilities 0 to 31; then of those from 32 on.
    for number in range(6):
        first = 32 * (number // 3)
        words[number] &= sum(1 << one - first for one in kept if first <= one < first + 32)
    if libc.capset(ctypes.byref(header), ctypes.byref(words)) != 0:
        _fail("capset")
    if libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        _fail("no_new_privs")


def become_nobody(folder: Path) -> bool:
    """If this is root, become a user of its own, who then owns the folder.

    False, and nothing is changed, if this is not root, or if such a user could not reach Python, these
    modules or the folder. Raises OSError.
    """
    needed = (folder, Path(__file__).parents[2], *map(Path, (sys.prefix, sys.base_prefix)))
    if os.geteuid() != 0 or not all(_is_open_to_all(path) for path in needed) or not _has_many_users():
        return False
    user = _FIRST_USER + os.getpid() % _NUM_USERS
    for path in (folder, *folder.iterdir()):
        os.chown(path, user, user, follow_symlinks=False)
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)
    return True


def _is_open_to_all(path: Path) -> bool:
    """Whether every user may pass through the folders above it."""
    above = path.resolve().parents
    return all(stat.S_IMODE(folder.stat().st_mode) & stat.S_IXOTH for folder in above)


def _has_many_users() -> bool:
    """Whether this user namespace is the machine's own: a smaller one has no user so high."""
    fields = Path("/proc/self/uid_map").read_text().split()
    return fields[:1] == ["0"] and int(fields[2]) > _FIRST_USER + _NUM_USERS


def _fail(what: str) -> None:
    code = ctypes.get_errno()
    raise OSError(code, f"{what}: {os.strerror(code)}")
