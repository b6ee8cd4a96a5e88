"""API tokens: `gaitway_<id>_<secret>`. The record has the id and a hash.

A secret has 256 random bits, so that a plain SHA-256 cannot be searched; a slow hash would only cost time.
The readable beginning lets scanners of repositories recognize a token.
"""

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass

_PREFIX = "gaitway"
TOKEN_ID = "[0-9a-f]{12}"  # noqa: S105 # Public, and a pattern.
_TOKEN = re.compile(rf"{_PREFIX}_({TOKEN_ID})_([A-Za-z0-9_-]{{43}})")


@dataclass(frozen=True, repr=False)
class Secret:
    """A token as its holder has it. text: shown once; id: public."""

    id: str
    text: str

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.text.encode()).hexdigest()

    def matches(self, sha256: str) -> bool:
        """Whether this is the token of that hash; takes the same time for any."""
        return hmac.compare_digest(self.sha256, sha256)


def new_secret() -> Secret:
    """A fresh token."""
    token_id = secrets.token_hex(6)
    return Secret(token_id, f"{_PREFIX}_{token_id}_{secrets.token_urlsafe(32)}")


def parse(text: str) -> Secret | None:
    """The token in a request; None where the text has not the form of one."""
    found = _TOKEN.fullmatch(text)
    return None if found is None else Secret(found[1], text)
