"""The tokens of this user for services: that of GAITWAY_TOKEN, or the one that `gaitway login` has stored.

The file has a token for each address, and nobody else may read it.
"""

import json
import os
import secrets
import sys
from pathlib import Path
from typing import Any, cast

from gaitway.errors import UnsafeFile

VARIABLE = "GAITWAY_TOKEN"
_FILE = "tokens.json"
_OF_OTHERS = 0o077


def token_for(url: str) -> str | None:
    """The token for the service at this address, if there is one. Raises UnsafeFile."""
    return os.environ.get(VARIABLE, "").strip() or stored().get(url)


def stored() -> dict[str, str]:
    """The stored tokens by address. Raises UnsafeFile where others can read them."""
    try:
        path = file()
    except RuntimeError:  # This user has no home.
        return {}
    try:
        with path.open() as opened:
            if os.name == "posix" and os.fstat(opened.fileno()).st_mode & _OF_OTHERS:
                raise UnsafeFile(f"Others can read {path}, which has tokens: `chmod 600 {path}`.")
            found: Any = json.load(opened)
    except FileNotFoundError:
        return {}
    except ValueError:
        raise UnsafeFile(f"{path} is damaged: remove it, and log in again.") from None
    return cast("dict[str, str]", found) if isinstance(found, dict) else {}


def store(url: str, token: str) -> Path:
    """Keep the token for this address; the file. Raises UnsafeFile, OSError."""
    return _write({**stored(), url: token})


def forget(url: str) -> bool:
    """Whether there was a token for this address. Raises UnsafeFile, OSError."""
    known = stored()
    if url not in known:
        return False
    del known[url]
    _write(known)
    return True


def file() -> Path:
    """As platformdirs' `user_config_path("gaitway")`. Raises RuntimeError without a home."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "gaitway" / _FILE
    named = os.environ.get("XDG_CONFIG_HOME", "").strip()
    return (Path(named) if named else Path.home() / ".config") / "gaitway" / _FILE


def _write(tokens: dict[str, str]) -> Path:
    """Replace the file as a whole."""
    path = file()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    partial = path.with_suffix(f".{secrets.token_hex(4)}")
    # With O_EXCL, a link that somebody else has put there is not followed.
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as opened:
        json.dump(tokens, opened)
    partial.replace(path)
    return path
