"""Address of a client behind reverse proxies: ``X-Forwarded-For``, from the right, from trusted proxies only."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterable

from starlette.datastructures import Headers
from starlette.types import Scope

from drivebus.service.auth.client_address import IpAddress, parse_address

_WITH_PORT = re.compile(r"\[([^\[\]]*)\](?::\d+)?|(\d+\.\d+\.\d+\.\d+):\d+", re.ASCII)


class TrustedProxies:
    """Proxies whose ``X-Forwarded-For`` is used. Any other client could write what it likes there."""

    def __init__(self, networks: Iterable[str]) -> None:
        self._networks = [ipaddress.ip_network(network) for network in networks]

    def resolve(self, scope: Scope, headers: Headers) -> None:
        """Replace the client of a request by the one for which the trusted proxies sent it."""
        if self._networks and scope.get("client"):
            scope["client"] = (self.client_address(scope["client"][0], headers), scope["client"][1])

    def client_address(self, peer: str, headers: Headers) -> str:
        """Return the last address that no trusted proxy has, beginning with the connection's own.

        Each proxy appends the address that it sees; what stands left of an untrusted one can be invented.
        """
        hops = [hop for line in headers.getlist("x-forwarded-for") for hop in line.split(",")]
        found, address = peer, _parse(peer)
        while hops and address is not None and self._trusts(address):
            hop = hops.pop().strip()
            address = None if "%" in hop else _parse(hop)  # the scope of an IPv6 address may be any text
            found = str(address) if address is not None else found
        return found

    def trusts_peer(self, peer: str) -> bool:
        """Return whether the peer of a connection is a trusted proxy."""
        address = _parse(peer)
        return address is not None and self._trusts(address)

    def _trusts(self, address: IpAddress) -> bool:
        return any(address in network for network in self._networks)


def _parse(text: str) -> IpAddress | None:
    """Return an address, with or without port; None for anything else."""
    match = _WITH_PORT.fullmatch(text)
    try:
        return parse_address((match[1] or match[2]) if match else text)
    except ValueError:
        return None
