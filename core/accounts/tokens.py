"""API tokens, `gaitway_<id>_<secret>`, and sessions of the page, `gaitway-session_<id>_<secret>`.

The record has the id and a hash.

A secret has 256 random bits, so that a plain SHA-256 cannot be searched; a slow hash would only cost time.
The readable beginning lets scanners of repositories recognize a token.
"""

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass

TOKEN_ID = "[0-9a-f]{12}"  # noqa: S105 # Public, and a pattern.
TOKEN = "gaitway"  # noqa: S105 # The beginning of each, and no secret.
SESSION = "gaitway-session"
# A user has at most this many that are neither revoked nor expired.
MAX_TOKENS = 100
_AFTER_PREFIX = f"_({TOKEN_ID})_([A-Za-z0-9_-]{{43}})"


@dataclass(frozen=True, repr=False)
class Secret:
    """A token or a session as its holder has it. text: shown once; id: public."""

    id: str
    text: str

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.text.encode()).hexdigest()

    def matches(self, sha256: str) -> bool:
        """Whether this has that hash; takes the same time for any."""
        return hmac.compare_digest(self.sha256, sha256)


def new_secret(prefix: str = TOKEN) -> Secret:
    """A fresh token; with the prefix `SESSION`, a session."""
    public = secrets.token_hex(6)
    return Secret(public, f"{prefix}_{public}_{secrets.token_urlsafe(32)}")


def parse(text: str, prefix: str = TOKEN) -> Secret | None:
    """The token or session in a request; None where the text has not the form of one."""
    found = re.fullmatch(prefix + _AFTER_PREFIX, text)
    return None if found is None else Secret(found[1], text)
