"""What a short test compiles runs for moments: most of the time would go into compiling it well."""

import functools
import os

import jax
import pytest
from jax._src.interpreters import mlir
from jaxlib import xla_client

# Before JAX 0.11: a process ends at a flag that it does not know, and newer ones do not know the first.
_FLAGS = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
_KNOWN_FLAGS = _FLAGS if jax.__version_info__ < (0, 11) else ""


def compile_quickly() -> None:
    """From here on, in this process alone: what it starts is compiled as users have it."""
    jax.config.update("jax_disable_most_optimizations", True)
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("XLA_FLAGS", _KNOWN_FLAGS, prepend=" ")
        xla_client.CompileOptions()  # XLA reads its flags once: here.


def lower_in_one_context() -> None:
    """JAX makes a context of MLIR for each program, which is more than half of a small program's time."""
    mlir.make_ir_context = functools.cache(mlir.make_ir_context)


def compiling_quickly(xla_flags: str = "") -> dict[str, str]:
    """Variables for a process that is to do so, too."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} {xla_flags} {_KNOWN_FLAGS}"
    return {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "XLA_FLAGS": flags}
