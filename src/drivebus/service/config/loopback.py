"""Which hosts are this machine itself: what is said to them passes nobody on the way (S15)."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Reached from this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
