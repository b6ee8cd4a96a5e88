"""`python -m core.news.apprise_process`: sends one message by Apprise, or only looks at its address.

Reads `{"url", "title", "body", "networks"}` as JSON from stdin, without a title only to look; prints
`{"problem": null or a sentence}`. A hook of the interpreter refuses each connection to an address that is not
allowed, at the moment when it is made: also after a redirect, and whatever a name meant before.
"""

import json
import signal
import sys
from importlib import import_module
from ipaddress import ip_network
from typing import Any, cast

from core.news.addresses import SETTING, is_allowed
from core.news.channels import APPRISE, PARAMETERS
from core.settings import Networks

_LONGEST_S = 30
_STARTS_PROGRAMS = ("subprocess.", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "os.system", "pty.")
_CONNECTS = ("socket.connect", "socket.sendto", "socket.sendmsg")
_refused: list[str] = []


def guard(allowed: Networks) -> None:
    """From now on, this process reaches allowed addresses alone, and starts no program."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event.startswith(_STARTS_PROGRAMS):
            raise PermissionError(f"{event} is not allowed here.")
        if event in _CONNECTS:
            address = arguments[1]
            is_local = not isinstance(address, tuple)
            host = "a local socket" if is_local else str(cast("tuple[Any, ...]", address)[0])
            if not is_allowed(host, allowed):
                _refused.append(host)
                raise PermissionError(f"{host} is not allowed.")

    sys.addaudithook(hook)


def main() -> None:
    signal.alarm(_LONGEST_S)
    order = json.load(sys.stdin)
    url = str(order["url"])
    apprise: Any = import_module("apprise")
    module, name = APPRISE[url.partition(":")[0].lower()]
    kind: Any = getattr(import_module(f"apprise.plugins.{module}"), name)
    guard(tuple(ip_network(text) for text in order.get("networks", ())))
    asset = apprise.AppriseAsset(storage_mode=apprise.PersistentStoreMode.MEMORY)
    sys.stdout.write(json.dumps({"problem": problem_of(kind, url, asset, order)}) + "\n")


def problem_of(kind: Any, url: str, asset: Any, order: dict[str, str]) -> str | None:
    """What is wrong with the address, or why the message could not be sent."""
    parts: dict[str, Any] = kind.parse_url(url) or {}
    for name in cast(
        "dict[str, str]", parts.get("qsd", {})
    ):  # As Apprise reads them, which is not as `check_url` does.
        if name.lower() not in PARAMETERS:
            return f"it has the parameter `{name[:40]}`, which is not allowed here"
    try:
        plugin = kind(asset=asset, **parts) if parts else None
    except TypeError:  # Apprise's word for an address that lacks something; its text may hold a secret.
        plugin = None
    if plugin is None:
        return f"https://appriseit.com/services/ has the form that Apprise knows for {kind.service_name}"
    if "title" not in order or plugin.notify(title=order["title"], body=order["body"]):
        return None
    if _refused:
        return f"it is at {_refused[0]}, which is not public: an administrator allows it by {SETTING}"
    return f"{kind.service_name} did not take it"


if __name__ == "__main__":
    main()
