"""Network addresses of clients: their normal form, and the network that counts as one client. Pure."""

from __future__ import annotations

import ipaddress

IpAddress = ipaddress.IPv4Address | ipaddress.IPv6Address
IPV6_NETWORK_BITS = 64  # a host chooses its addresses freely within its network


def parse_address(text: str) -> IpAddress:
    """Return an address; an IPv4 address that an IPv6 socket reports as ``::ffff:10.0.0.9`` as IPv4.

    Raises ValueError.
    """
    address = ipaddress.ip_address(text)
    return getattr(address, "ipv4_mapped", None) or address


def client_network(address: IpAddress) -> str:
    """Return the network that counts as one client: an IPv4 address, or the /64 of an IPv6 address."""
    if address.version == 4:
        return str(address)
    return str(ipaddress.IPv6Network((int(address), IPV6_NETWORK_BITS), strict=False))
