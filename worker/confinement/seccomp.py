"""Seccomp: the kernel refuses system calls that a reader of models does not need.

A program in classic BPF checks each call's number; seccomp(2) and bpf(4) describe it.
"""

import ctypes
import errno
import os
import platform
from typing import NamedTuple

_PR_SET_SECCOMP, _MODE_FILTER = 22, 2
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
# Codes of BPF: load a word; jump where equal, at least, or a bit is set; return.
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
# The offsets of the call's number, its processor, and its first argument.
_NUMBER, _PROCESSOR, _FIRST_ARGUMENT = 0, 4, 16
# x86 has a second set of numbers for the same calls, from here on.
_X32 = 0x40000000
# Flags of clone() that make namespaces, in which a process would have every capability.
_NAMESPACES = 0x7E020000


class _Processor(NamedTuple):
    audit: int
    column: int


_PROCESSORS = {"x86_64": _Processor(0xC000003E, 0), "aarch64": _Processor(0xC00000B7, 1)}

# Numbers on x86_64 and on aarch64.
_REFUSED = {
    # The network, and every socket of this machine's services.
    "socket": (41, 198),
    "connect": (42, 203),
    "bind": (49, 200),
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
    # Other processes.
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "tkill": (200, 130),
    "rt_sigqueueinfo": (129, 138),
    "rt_tgsigqueueinfo": (297, 240),
    "pidfd_send_signal": (424, 424),
    "pidfd_open": (434, 434),
    "pidfd_getfd": (438, 438),
    # A group of its own, in which the worker would not find it to end it.
    "setpgid": (109, 154),
    "setsid": (112, 157),
    # Namespaces and mounts.
    "unshare": (272, 97),
    "setns": (308, 268),
    "mount": (165, 40),
    "umount2": (166, 39),
    "pivot_root": (155, 41),
    "chroot": (161, 51),
    "open_tree": (428, 428),
    "move_mount": (429, 429),
    "fsopen": (430, 430),
    "fsmount": (432, 432),
    "mount_setattr": (442, 442),
    # Calls through which kernels have been broken.
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "userfaultfd": (323, 282),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "keyctl": (250, 219),
    "init_module": (175, 105),
    "finit_module": (313, 273),
    "kexec_load": (246, 104),
}
# Allowed if the first argument is this process, or 0: a crashing process signals itself.
_OWN_PROCESS_ONLY = {"kill": (62, 129), "tgkill": (234, 131), "prlimit64": (302, 261)}
_CLONE, _CLONE3 = (56, 220), 435


class _Instruction(ctypes.Structure):
    _fields_ = (
        ("code", ctypes.c_uint16),
        ("if_true", ctypes.c_uint8),
        ("if_false", ctypes.c_uint8),
        ("value", ctypes.c_uint32),
    )


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_uint16), ("first", ctypes.POINTER(_Instruction)))


def refuse_calls() -> None:
    """Confine this process and all it starts, for good. It must have given up new privileges.

    Raises OSError.
    """
    processor = _PROCESSORS.get(platform.machine())
    if processor is None:
        raise OSError(errno.ENOSYS, f"Seccomp: the system calls of {platform.machine()} are not known here")
    instructions = [_Instruction(*one) for one in _program(processor, os.getpid())]
    array = (_Instruction * len(instructions))(*instructions)
    program = _Program(len(instructions), array)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(program), 0, 0) != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"Seccomp: {os.strerror(code)}")


def _program(processor: _Processor, pid: int) -> list[tuple[int, int, int, int]]:
    """The filter. A jump holds how many instructions to skip if its test is true, and if it is false."""
    refuse = (_RETURN, 0, 0, _REFUSE | errno.EPERM)
    # Reported as missing, so that glibc makes threads by clone(), whose flags a filter can see.
    absent = (_RETURN, 0, 0, _REFUSE | errno.ENOSYS)
    allow = (_RETURN, 0, 0, _ALLOW)
    lines = [
        (_LOAD, 0, 0, _PROCESSOR),
        (_EQUAL, 1, 0, processor.audit),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, _NUMBER),
        (_AT_LEAST, 0, 1, _X32),
        absent,
        (_EQUAL, 0, 1, _CLONE3),
        absent,
        (_EQUAL, 0, 4, _CLONE[processor.column]),
        (_LOAD, 0, 0, _FIRST_ARGUMENT),
        (_ANY_BIT, 0, 1, _NAMESPACES),
        refuse,
        allow,
    ]
    for numbers in _OWN_PROCESS_ONLY.values():
        lines += [
            (_EQUAL, 0, 5, numbers[processor.column]),
            (_LOAD, 0, 0, _FIRST_ARGUMENT),
            (_EQUAL, 1, 0, 0),
            (_EQUAL, 0, 1, pid),
            allow,
            refuse,
        ]
    for numbers in _REFUSED.values():
        lines += [(_EQUAL, 0, 1, numbers[processor.column]), refuse]
    return [*lines, allow]
