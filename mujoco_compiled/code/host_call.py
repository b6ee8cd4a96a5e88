"""A NumPy function as a node of a compiled program that JAX can still cache on disk.

JAX caches no program with one of its own callbacks, because the program holds an address of this process.
Here, on a CPU, the program holds a name instead: XLA's foreign function interface calls one C function, made
by ctypes, for all host functions, and passes it the name of the one to run.
"""

import ctypes
import logging
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.code.xla_ffi import CallFrame, arrays_of, claim_version, error_of, string_of

Floats = NDArray[np.float32]
HostFunction = Callable[..., Sequence[Floats]]

_TARGET = "mujoco_compiled_host_call"
# Never emptied: nothing tells when the last compiled program that uses a name is gone.
_functions: dict[str, HostFunction] = {}


def host_call(
    function: HostFunction, name: str, shapes: Sequence[tuple[int, ...]], *arguments: jax.Array
) -> tuple[jax.Array, ...]:
    """Call `function` on the host; it returns arrays of these shapes; everything is float32.

    Under `jax.vmap` it is called once, and all arrays have the mapped axes in front. It must not call JAX or
    keep its arguments (they are JAX's memory), and must depend on nothing else, so that it does not matter
    how often it is called. An exception ends the program with a JaxRuntimeError that contains it.

    name: identifies what the function does, in every process: a program that was cached on disk runs the
    function that the loading process has under that name. Of two functions with one name the first is called.
    """
    results = tuple(jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes)
    inputs = [jnp.asarray(argument, jnp.float32) for argument in arguments]
    if _runs_on_a_cpu() and _is_registered():
        _functions.setdefault(name, function)
        call = jax.ffi.ffi_call(_TARGET, results, vmap_method="broadcast_all")
        return tuple(call(*inputs, name=name))

    def on_the_host(*arrays: Any) -> Sequence[Floats]:
        # JAX's arrays become NumPy's at once, because JAX must not be called in here.
        return tuple(function(*map(np.asarray, arrays)))

    return jax.pure_callback(on_the_host, results, *inputs, vmap_method="broadcast_all")


def _runs_on_a_cpu() -> bool:
    """Whether the program is for a CPU, also where it is compiled inside `jax.default_device` of one."""
    config: Any = jax.config
    device = config.jax_default_device
    return (jax.default_backend() if device is None else device.platform) == "cpu"


@cache
def _is_registered() -> bool:
    """Whether XLA accepts the handler; a version of XLA with another interface refuses it."""
    try:
        jax.ffi.register_ffi_target(_TARGET, jax.ffi.pycapsule(_handle), platform="cpu")
    except RuntimeError as error:
        warnings.warn(f"Compiled programs are not cached between processes: {error}", stacklevel=2)
        return False
    return True


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(CallFrame))
def _handle(frame: Any) -> int | None:
    """XLA's call. Returns NULL, or an error that XLA then owns; no exception may leave it."""
    try:
        if claim_version(frame.contents):
            return None
        _call(frame.contents)
    except BaseException as error:
        logging.getLogger(__name__).exception("A call out of a compiled program failed.")
        return error_of(frame.contents, error)
    return None


def _call(frame: CallFrame) -> None:
    name = string_of(frame.attributes)
    if name not in _functions:
        raise LookupError(f"This process has no host function named {name}.")
    results = arrays_of(frame.results)
    values = _functions[name](*arrays_of(frame.arguments))
    for result, value in zip(results, values, strict=True):
        if value.shape != result.shape:
            raise ValueError(f"A result has the shape {value.shape}, but should have {result.shape}.")
        result[...] = value
