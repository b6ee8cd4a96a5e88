import sys

# structlog would load rich, for tracebacks in a terminal: 4 MB, and the API logs lines of JSON.
if "rich" not in sys.modules:
    sys.modules["rich"] = None  # type: ignore[assignment] # An import finds nothing.
    import structlog as structlog

    del sys.modules["rich"]
