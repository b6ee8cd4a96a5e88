"""How a process that trains starts sooner; imports no numerical code."""

import ctypes
import gc
import importlib
import importlib.util
import sys
from contextlib import suppress
from typing import Any


def start_lean() -> None:
    """Load and collect less from now on; to be called before the numerical stack is imported.

    Imports, tracing and compiling make millions of objects, and hardly any garbage: under Python's own
    thresholds, looking for it took 0.9 of the 12 processor seconds of a robot's warm start.
    """
    gc.set_threshold(50_000, 20, 100)
    # MuJoCo imports it, and it starts processes to find its library. A training has no window.
    put_off("glfw")


def give_back_memory() -> None:
    """Let the system have what was freed: imports and documents leave some MiB."""
    gc.collect()
    with suppress(OSError, AttributeError):  # glibc alone has it.
        ctypes.CDLL(None).malloc_trim(0)


def put_off(name: str) -> None:
    """Make a package's modules importable without running its `__init__`, until a name of its own is used."""
    spec = importlib.util.find_spec(name) if name not in sys.modules else None
    if spec is None or spec.loader is None:
        return
    package, loader = importlib.util.module_from_spec(spec), spec.loader

    def load(wanted: str) -> Any:
        if wanted.startswith("__"):  # Python looks for some that a package may lack
            raise AttributeError(wanted)
        if importlib.util.find_spec(f"{name}.{wanted}") is not None:
            return importlib.import_module(f"{name}.{wanted}")
        if package.__dict__.pop("__getattr__", None) is not None:
            loader.exec_module(package)
        return getattr(package, wanted)

    package.__dict__["__getattr__"] = load
    sys.modules[name] = package
