"""For whom a request is made: the network that limits per client count by."""

from __future__ import annotations

from ipaddress import IPv6Address, ip_address

from starlette.types import Scope

_IPV6_PREFIX_BITS = 64  # whoever has one IPv6 address has 2^64


class ClientAddressError(ValueError):
    """What a proxy forwarded as the client is no address."""


def client_network(scope: Scope) -> str | None:
    """Return the client of a request: its IPv4 address or IPv6 /64; None for the host itself.

    uvicorn has put there what a proxy on loopback says in X-Forwarded-For, whatever it is.

    Raises
    ------
    ClientAddressError : it is no address.
    """
    host = scope["client"][0] if scope.get("client") else None
    if host is None:
        return None
    try:
        address = ip_address(host)
    except ValueError:
        raise ClientAddressError(f"{host[:64]!r} is no address") from None
    if isinstance(address, IPv6Address):
        address = address.ipv4_mapped or address
    if address.is_loopback:
        return None
    if isinstance(address, IPv6Address):
        return str(IPv6Address(int(address) >> _IPV6_PREFIX_BITS << _IPV6_PREFIX_BITS))
    return str(address)
