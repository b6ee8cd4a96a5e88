import sys
from contextlib import suppress
from importlib import import_module

# What these would load, and the API never uses: rich for tracebacks in a terminal, where the API logs lines
# of JSON; measurements for OpenTelemetry. They take 4 and 2 MB.
for package, unused in (("structlog", "rich"), ("redis", "opentelemetry.sdk")):
    if unused not in sys.modules:
        sys.modules[unused] = None  # type: ignore[assignment] # An import finds nothing.
        with suppress(ImportError):  # A bare client has neither.
            import_module(package)
        del sys.modules[unused]
