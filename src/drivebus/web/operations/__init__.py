"""Operations of the web gateway itself, each declared once: sessions, users, tokens, description, metrics.

Their state is in this process; every other operation is forwarded to the service.
"""

from __future__ import annotations

from drivebus.service.api.operations import Operation, collect_operations
from drivebus.web.operations import account, description, users

WEB_OPERATIONS: dict[str, Operation] = collect_operations(description, account, users)
"""Every operation of the web gateway by name."""

__all__ = ["WEB_OPERATIONS"]
