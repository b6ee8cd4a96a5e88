import sys
from contextlib import suppress

# structlog would load rich, for tracebacks in a terminal: 4 MB, and the API logs lines of JSON.
if "rich" not in sys.modules:
    sys.modules["rich"] = None  # type: ignore[assignment] # An import finds nothing.
    with suppress(ImportError):  # A bare client has neither.
        import structlog as structlog
    del sys.modules["rich"]
