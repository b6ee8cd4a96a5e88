"""Imports a part of the service, and runs it once its servers are ready.

`python -m gaitway.service.embedded.preload -m worker.main` imports that module, waits for the end of
standard input, and calls the module's `main`. The input is a JSON object: settings that are added to the
environment.
"""

import gc
import json
import os
import sys
from collections.abc import Sequence
from importlib import import_module

# The API itself imports the clients of the stores only when it connects.
_CLIENTS = "core.adapters.startup"


def main(arguments: Sequence[str]) -> None:
    """arguments: `-m`, the module's name, and its own arguments. Exits with 1 if the input is empty."""
    _, name, *rest = arguments
    # Objects made by imports stay. Collecting garbage among them would slow the imports down.
    gc.disable()
    import_module(_CLIENTS)
    module = import_module(name)
    gc.freeze()
    gc.enable()
    settings = sys.stdin.read()
    if not settings:  # The launcher has gone.
        sys.exit(1)
    os.environ.update(json.loads(settings))
    sys.argv = [name, *rest]
    module.main()


if __name__ == "__main__":
    main(sys.argv[1:])
