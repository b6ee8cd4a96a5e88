"""Which addresses news may be sent to: public ones, and those that the administrator allows.

A name is resolved once, and the connection goes to the address that was checked: a name that means another
address a moment later (DNS rebinding) leads nowhere else.
"""

import socket
from collections.abc import Awaitable, Callable, Sequence
from ipaddress import IPv4Address, IPv6Address, IPv6Network, ip_address

import anyio

from core.settings import Networks

Address = IPv4Address | IPv6Address
Resolve = Callable[[str, int], Awaitable[Sequence[str]]]

SETTING = "GAITWAY_NEWS_NETWORKS"
# IPv6 addresses that a translator turns into the IPv4 address in their last 32 bits.
_NAT64 = IPv6Network("64:ff9b::/96")


class AddressRefused(Exception):
    """News may not be sent there; its text is a sentence."""


class NameUnknown(Exception):
    """The name has no address now; its text is a sentence."""


async def resolve(host: str, port: int) -> Sequence[str]:
    """The addresses of a name, in the system's order. Raises OSError."""
    found = await anyio.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [str(sockaddr[0]) for *_, sockaddr in found]


async def checked_address(
    host: str, port: int, allowed: Networks, resolver: Resolve = resolve, timeout_s: float = 5.0
) -> str:
    """An address of the host to connect to. Raises AddressRefused, NameUnknown."""
    try:
        with anyio.fail_after(timeout_s):
            found = await resolver(host, port)
    except (OSError, UnicodeError, TimeoutError) as error:
        why = "no answer in time" if isinstance(error, TimeoutError) else "no such name"
        raise NameUnknown(f"The host {host} cannot be resolved: {why}.") from None
    for text in found:
        if is_allowed(text, allowed):
            return text
    raise AddressRefused(
        f"{host} is at {found[0] if found else 'no address'}, which is not public: an administrator allows "
        f"it by {SETTING}."
    )


def is_allowed(text: str, allowed: Networks) -> bool:
    """Whether the address is public, or in one of these networks."""
    try:
        address = _meant(ip_address(text))
    except ValueError:
        return False
    if any(address.version == network.version and address in network for network in allowed):
        return True
    return address.is_global and not (address.is_multicast or address.is_reserved or address.is_unspecified)


def _meant(address: Address) -> Address:
    """The IPv4 address inside one of IPv6 that leads there."""
    if isinstance(address, IPv4Address):
        return address
    if address in _NAT64:
        return IPv4Address(int(address) & 0xFFFF_FFFF)
    teredo = address.teredo
    return address.ipv4_mapped or address.sixtofour or (teredo[1] if teredo else None) or address
