import sys
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace
from typing import Any

# What these would load, and the API never uses: rich for tracebacks in a terminal, where the API logs lines
# of JSON; measurements for OpenTelemetry; ciphers for administrators of MinIO. They take 4, 2 and 4 MB.
_UNUSED: dict[str, tuple[str, Any]] = {
    "structlog": ("rich", None),  # An import finds nothing.
    "redis": ("opentelemetry.sdk", None),
    "minio": ("minio.crypto", SimpleNamespace(decrypt=None, encrypt=None)),
}
for package, (unused, instead) in _UNUSED.items():
    if unused not in sys.modules:
        sys.modules[unused] = instead
        with suppress(ImportError):  # A bare client has none of them.
            import_module(package)
        del sys.modules[unused]
