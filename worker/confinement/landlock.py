"""Landlock: this process, and all that it starts, may use the files that are named and no others.

A part of Linux since 5.13 that needs no privilege; docs.kernel.org, "Landlock: unprivileged access control".
"""

import ctypes
import os
import stat
import sys
from collections.abc import Iterable
from pathlib import Path

# The same on every processor.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_TELL_VERSION, _PATH_BENEATH = 1, 1
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_REMOVE_DIR, _REMOVE_FILE, _MAKE_DIR, _MAKE_REG = 1 << 4, 1 << 5, 1 << 7, 1 << 8
_REFER, _TRUNCATE, _IOCTL_DEVICE = 1 << 13, 1 << 14, 1 << 15
_OF_A_FILE = _EXECUTE | _WRITE_FILE | _READ_FILE | _TRUNCATE | _IOCTL_DEVICE
_READ = _EXECUTE | _READ_FILE | _READ_DIR
_WRITE = _WRITE_FILE | _REMOVE_DIR | _REMOVE_FILE | _MAKE_DIR | _MAKE_REG | _REFER | _TRUNCATE
# How many rights each version knows; and from which on it knows TCP, and other processes.
_NUM_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15}
_NUM_RIGHTS_NOW = 16
_BIND_AND_CONNECT, _WITH_NETWORK = 0b11, 4
_SOCKETS_AND_SIGNALS, _WITH_SCOPES = 0b11, 6


class _Ruleset(ctypes.Structure):
    _fields_ = (
        ("handled_access_fs", ctypes.c_uint64),
        ("handled_access_net", ctypes.c_uint64),
        ("scoped", ctypes.c_uint64),
    )


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32))


def version() -> int:
    """The version of Landlock that this kernel has; 0 if it has none, or if Landlock is switched off."""
    if sys.platform != "linux":
        return 0
    try:
        return _call(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(_TELL_VERSION))
    except OSError:
        return 0


def restrict(
    *,
    readable: Iterable[Path],
    listable: Iterable[Path],
    writable: Iterable[Path],
    free: Iterable[Path] = (),
    files_only: bool = False,
) -> None:
    """Allow only these files and folders, with all below them, for good; missing ones are skipped.

    listable: folders that may be listed, all below them, too. writable: may be read as well. free: anything
    may be done there, as a device needs it.
    No TCP, no signal to others, no abstract socket of others, as far as the kernel's version knows these;
    files_only leaves them alone. The process must have given up new privileges. Raises OSError.
    """
    known = version()
    rights = (1 << _NUM_RIGHTS.get(known, _NUM_RIGHTS_NOW)) - 1
    ruleset = _Ruleset(
        rights,
        _BIND_AND_CONNECT if known >= _WITH_NETWORK and not files_only else 0,
        _SOCKETS_AND_SIGNALS if known >= _WITH_SCOPES and not files_only else 0,
    )
    descriptor = _call(
        _CREATE_RULESET, ctypes.byref(ruleset), ctypes.c_size_t(ctypes.sizeof(ruleset)), ctypes.c_uint32(0)
    )
    try:
        granted = ((readable, _READ), (listable, _READ_DIR), (writable, _READ | _WRITE), (free, rights))
        for paths, access in granted:
            for path in paths:
                _allow(descriptor, path, access & rights)
        _call(_RESTRICT_SELF, ctypes.c_int(descriptor), ctypes.c_uint32(0))
    finally:
        os.close(descriptor)


def _allow(ruleset: int, path: Path, access: int) -> None:
    try:
        parent = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except (FileNotFoundError, PermissionError):
        return
    try:
        if not stat.S_ISDIR(os.fstat(parent).st_mode):
            access &= _OF_A_FILE
        rule = _PathBeneath(access, parent)
        _call(
            _ADD_RULE,
            ctypes.c_int(ruleset),
            ctypes.c_int(_PATH_BENEATH),
            ctypes.byref(rule),
            ctypes.c_uint32(0),
        )
    finally:
        os.close(parent)


def _call(number: int, *arguments: object) -> int:
    result: int = ctypes.CDLL(None, use_errno=True).syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"Landlock: {os.strerror(code)}")
    return result
