"""What a webhook's address may be: an HTTP receiver, or a service that Apprise knows and that is listed here.

Apprise also knows kinds that run programs, write files or speak to this machine's desktop, and parameters
that read local files. None of these is listed. Sending happens in a process of its own
(`core.news.apprise_process`), which connects to allowed addresses alone and starts no program.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from core.errors import AddressesWait
from core.installation import to_install
from core.settings import Networks

LONGEST_URL = 2000
# The module and the class of Apprise behind each kind.
APPRISE: Mapping[str, tuple[str, str]] = {
    "discord": ("discord", "NotifyDiscord"),
    "gchat": ("google_chat", "NotifyGoogleChat"),
    "gotify": ("gotify", "NotifyGotify"),
    "gotifys": ("gotify", "NotifyGotify"),
    "mailto": ("email", "NotifyEmail"),
    "mailtos": ("email", "NotifyEmail"),
    "matrix": ("matrix", "NotifyMatrix"),
    "matrixs": ("matrix", "NotifyMatrix"),
    "mmost": ("mattermost", "NotifyMattermost"),
    "mmosts": ("mattermost", "NotifyMattermost"),
    "ntfy": ("ntfy", "NotifyNtfy"),
    "ntfys": ("ntfy", "NotifyNtfy"),
    "pover": ("pushover", "NotifyPushover"),
    "rocket": ("rocketchat", "NotifyRocketChat"),
    "rockets": ("rocketchat", "NotifyRocketChat"),
    "slack": ("slack", "NotifySlack"),
    "tgram": ("telegram", "NotifyTelegram"),
    "workflows": ("workflows", "NotifyWorkflows"),
    "zulip": ("zulip", "NotifyZulip"),
}
# Others read files (`template`, `pgppub`), turn checks of certificates off, or store something.
PARAMETERS = frozenset(
    [
        "api-version",
        "auth",
        "bcc",
        "botname",
        "cc",
        "channel",
        "channels",
        "footer",
        "format",
        "from",
        "id",
        "image",
        "key",
        "mode",
        "name",
        "pass",
        "port",
        "priority",
        "reply",
        "route",
        "routeid",
        "sig",
        "silent",
        "smtp",
        "sound",
        "subject",
        "team",
        "thread",
        "to",
        "token",
        "topic",
        "user",
        "ver",
        "webhook",
        "workspace",
    ]
)
_ROOT = Path(__file__).resolve().parents[2]
# To import Apprise takes a second, and a silent mail server is given up after ten.
_APPRISE_S = 25.0
# Each look takes a process of 70 MB, and who waits for his turn a thread of the API.
_looking, _WAIT_S = BoundedSemaphore(2), 2.0


class BadAddress(ValueError):
    """The address cannot be a webhook's; its text continues a sentence about it."""


def check_url(url: str) -> str:
    """The same address. Raises BadAddress, AddressesWait.

    Apprise itself looks at an address of its own: that takes a second.
    """
    if len(url) > LONGEST_URL or not url.isprintable() or " " in url:
        raise BadAddress(f"has to be an address of at most {LONGEST_URL:,} characters without spaces")
    import httpx  # The API is smaller without it.

    try:
        parts = urlsplit(url)
        scheme, host, user = parts.scheme, parts.hostname, parts.username
        parsed = httpx.URL(url) if scheme in ("http", "https") else None
    except (ValueError, httpx.InvalidURL) as error:
        raise BadAddress(f"is not an address: {error}") from None
    if parsed is not None:
        if not host or not parsed.host:
            raise BadAddress("names no host")
        if user is not None:
            raise BadAddress("has a user name or a password, which are not sent: put a secret into its path")
        return url
    if scheme not in APPRISE:
        kinds = ", ".join(sorted(APPRISE))
        raise BadAddress(f"begins with {scheme[:20] or 'no scheme'}; allowed are http, https, and {kinds}")
    # Apprise takes what follows either of them for parameters, too.
    if "#" in url or ";" in url:
        raise BadAddress("has '#' or ';', which are not allowed here: write %23 or %3B")
    for name, _ in parse_qsl(parts.query, keep_blank_values=True):
        if name.lower() not in PARAMETERS:
            raise BadAddress(f"has the parameter `{name[:40]}`, which is not allowed here")
    check_apprise(url)
    return url


def check_apprise(url: str) -> None:
    """Raises BadAddress where Apprise does not understand the address; AddressesWait."""
    if not _looking.acquire(timeout=_WAIT_S):
        raise AddressesWait
    try:
        problem = _ask(url)
    finally:
        _looking.release()
    if problem is not None:
        raise BadAddress(f"cannot be used: {problem}")


def send_by_apprise(url: str, title: str, body: str, networks: Networks) -> str | None:
    """Why it could not be sent; None if it was. Blocks for some seconds."""
    return _ask(url, title=title, body=body, networks=[str(network) for network in networks])


def _ask(url: str, **message: Any) -> str | None:
    if find_spec("apprise") is None:
        return f"this service lacks Apprise ({to_install('news')}, for API and reconciler)"
    try:
        child = subprocess.run(  # A program of our own.
            [sys.executable, "-m", "core.news.apprise_process"],
            input=json.dumps({"url": url, **message}),
            capture_output=True,
            text=True,
            timeout=_APPRISE_S,
            env=_environment(),
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"it did not answer within {_APPRISE_S:.0f} s"
    if child.returncode != 0:  # Its traceback may hold the address.
        return "Apprise has failed on this address"
    return json.loads(child.stdout.splitlines()[-1])["problem"]


def _environment() -> dict[str, str]:
    """The child's: no setting of ours, and so no secret."""
    kept = ("PATH", "HOME", "LANG", "SSL_CERT_FILE", "SSL_CERT_DIR", "REQUESTS_CA_BUNDLE", "VIRTUAL_ENV")
    modules = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
    return {name: os.environ[name] for name in kept if name in os.environ} | {"PYTHONPATH": modules}
