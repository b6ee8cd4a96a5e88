"""The part of XLA's foreign function interface that `host_call` needs, in ctypes.

Source: `xla/ffi/api/c_api.h`, which comes with jaxlib (`jax.ffi.include_dir()`). The fields named here are
the same in its versions 0.1 to 0.5 (jax 0.10 to 0.12).
"""

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_int64, c_size_t, c_void_p

import numpy as np
from numpy.typing import NDArray

# The oldest version that XLA accepts, because nothing newer is used.
_VERSION = (0, 1)
_METADATA_EXTENSION = 1
_FLOAT32 = 11
_RESOURCE_EXHAUSTED, _INTERNAL = 8, 13


class _Version(ctypes.Structure):
    _fields_ = (("size", c_size_t), ("extension", c_void_p), ("major", c_int), ("minor", c_int))


class _Metadata(ctypes.Structure):
    _fields_ = (("size", c_size_t), ("version", _Version))  # and more fields, which stay untouched


class _Extension(ctypes.Structure):
    """The head of any extension, and the field that follows it if it asks for metadata."""

    _fields_ = (("size", c_size_t), ("type", c_int), ("next", c_void_p), ("metadata", POINTER(_Metadata)))


class _Buffer(ctypes.Structure):
    _fields_ = (
        ("size", c_size_t),
        ("extension", c_void_p),
        ("dtype", c_int),
        ("data", c_void_p),
        ("rank", c_int64),
        ("dims", POINTER(c_int64)),
    )


class _Buffers(ctypes.Structure):
    """A call's arguments or results."""

    _fields_ = (
        ("size", c_size_t),
        ("extension", c_void_p),
        ("count", c_int64),
        ("types", POINTER(c_int)),
        ("values", POINTER(POINTER(_Buffer))),
    )


class _String(ctypes.Structure):
    _fields_ = (("start", c_void_p), ("length", c_size_t))


class _Attributes(ctypes.Structure):
    """A call's constants; ours has one, a string."""

    _fields_ = (
        ("size", c_size_t),
        ("extension", c_void_p),
        ("count", c_int64),
        ("types", POINTER(c_int)),
        ("names", POINTER(POINTER(_String))),
        ("values", POINTER(POINTER(_String))),
    )


class _Error(ctypes.Structure):
    _fields_ = (("size", c_size_t), ("extension", c_void_p), ("message", c_char_p), ("code", c_int))


class _Api(ctypes.Structure):
    _fields_ = (
        ("size", c_size_t),
        ("extension", c_void_p),
        ("version", _Version),
        ("internal", c_void_p),
        ("create_error", ctypes.CFUNCTYPE(c_void_p, POINTER(_Error))),
    )


class CallFrame(ctypes.Structure):
    """One call of a handler."""

    _fields_ = (
        ("size", c_size_t),
        ("extension", POINTER(_Extension)),
        ("api", POINTER(_Api)),
        ("context", c_void_p),
        ("stage", c_int),
        ("arguments", _Buffers),
        ("results", _Buffers),
        ("attributes", _Attributes),
    )

    arguments: _Buffers
    results: _Buffers
    attributes: _Attributes


def claim_version(frame: CallFrame) -> bool:
    """Whether XLA only asks which version of the interface the handler implements; if so, sets it."""
    if not frame.extension or frame.extension.contents.type != _METADATA_EXTENSION:
        return False
    version = frame.extension.contents.metadata.contents.version
    version.major, version.minor = _VERSION
    return True


def arrays_of(buffers: _Buffers) -> list[NDArray[np.float32]]:
    """The buffers themselves, not copies; they are gone when the handler returns."""
    return [_array(buffers.values[index].contents) for index in range(buffers.count)]


def _array(buffer: _Buffer) -> NDArray[np.float32]:
    if buffer.dtype != _FLOAT32:
        raise TypeError(f"A buffer has XLA's type {buffer.dtype}; only float32 ({_FLOAT32}) is accepted.")
    shape = tuple(buffer.dims[: buffer.rank])
    if not buffer.data:  # it is empty
        return np.empty(shape, np.float32)
    memory = (ctypes.c_float * int(np.prod(shape))).from_address(buffer.data)
    return np.ndarray(shape, np.float32, memory)  # pyright: ignore[reportArgumentType] - numpy takes it


def string_of(attributes: _Attributes) -> str:
    """The value of the only attribute."""
    text = attributes.values[0].contents
    return ctypes.string_at(text.start, text.length).decode()


def error_of(frame: CallFrame, error: BaseException) -> int | None:
    """The exception as an XLA error, which XLA frees."""
    code = _RESOURCE_EXHAUSTED if isinstance(error, MemoryError) else _INTERNAL
    message = f"{type(error).__name__}: {error}".encode()
    return frame.api.contents.create_error(_Error(ctypes.sizeof(_Error), None, message, code))
