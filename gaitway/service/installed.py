"""The difference between a clone and the wheel, which has the service's packages in `gaitway/_service`.

There, only processes of the service import `api`, `core` and `worker`: a user's own code may have modules of
these names.
"""

import os
import sys
from pathlib import Path

from gaitway.local import user_data_folder

CODE = Path(__file__).parents[1] / "_service"
IS_WHEEL = CODE.is_dir()
# uvx runs a program from its cache, where no shell finds it.
_IN_CACHE = any((folder / "CACHEDIR.TAG").exists() for folder in Path(sys.prefix).parents)
_WHEELS_PROGRAM = "uvx --from 'gaitway[up]' gaitway" if _IN_CACHE else "gaitway"
# How a user starts `up` and `demo`.
PROGRAM = _WHEELS_PROGRAM if IS_WHEEL else "./run"


def use_code() -> None:
    """Let this process, and all that it starts, import the service's packages; in a clone it can already."""
    if IS_WHEEL and str(CODE) not in sys.path:
        sys.path.insert(0, str(CODE))
        named = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(CODE), named)))
        # A folder that a user starts it in may have modules of the same names.
        os.environ["PYTHONSAFEPATH"] = "1"


def data_folder() -> Path:
    """Where `up` keeps everything unless the user names a folder."""
    return user_data_folder() if IS_WHEEL else Path("gaitway-data")
