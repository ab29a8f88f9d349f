"""The rights table: every address of the service and what it needs (S02). The door lets nothing through that is not
here, so a new route without a line is unreachable, and a test fails.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from drivebus.service.auth.rights import Right


class AccessLevel(StrEnum):
    """What is not a right."""

    PUBLIC = "public"
    """Anybody, also before the set-up."""
    SESSION = "session"
    """Whoever is logged in with a browser, idle or not."""


RequiredAccess = Right | AccessLevel
WEBSOCKET = "WEBSOCKET"
READ_METHODS = ("GET", WEBSOCKET)


@dataclass(frozen=True, slots=True)
class RoutePolicy:
    """One method of one address."""

    method: str
    path: str
    access: RequiredAccess
    is_user_activity: bool = True
    """A person does this; what a page does by itself keeps no session from becoming idle (S07)."""

    @property
    def yields(self) -> bool:
        """Its turn (``plant.turns``): questions and strangers. Commands keep the order in which they were given: a stop
        voids what was asked before it (6.5)."""
        return self.method in READ_METHODS or self.access is AccessLevel.PUBLIC

    @property
    def pattern(self) -> re.Pattern[str]:
        parts = re.split(r"({\w+(?::path)?})", self.path)
        return re.compile(
            "".join(_segment_pattern(part) if part.startswith("{") else re.escape(part) for part in parts)
        )


def _segment_pattern(part: str) -> str:
    return ".+" if part.endswith(":path}") else "[^/]+"


def _policies(need: RequiredAccess, *lines: str) -> tuple[RoutePolicy, ...]:
    pairs = (line.split() for line in lines)
    return tuple(RoutePolicy(method, f"/api/v1{path}", need) for method, path in pairs)


ROUTE_POLICIES: tuple[RoutePolicy, ...] = (
    RoutePolicy("GET", "/", AccessLevel.PUBLIC),
    RoutePolicy("GET", "/static/{path:path}", AccessLevel.PUBLIC),
    RoutePolicy("GET", "/vendor/{path:path}", AccessLevel.PUBLIC),
    RoutePolicy("GET", "/i18n/{language}.json", AccessLevel.PUBLIC),
    *_policies(
        AccessLevel.PUBLIC,
        "GET /health",
        "GET /session",
        "POST /login",
        "POST /login-once",
        "POST /setup",
    ),
    *_policies(
        AccessLevel.SESSION,
        "POST /logout",
        "POST /logout-everywhere",
        "POST /session/active",
        "POST /session/wake",
        "POST /password",
        "GET /tokens",
        "POST /tokens",
        "DELETE /tokens/{token}",
    ),
    *_policies(Right.ADMINISTER, "GET /users", "POST /users", "PATCH /users/{user}", "DELETE /users/{user}"),
    *_policies(
        Right.VIEW,
        f"{WEBSOCKET} /live",
        "GET /openapi.json",
        "GET /plant",
        "GET /statistics",
        "GET /drives",
        "GET /drives/{drive}",
        "GET /drives/{drive}/profile",
        "GET /drives/{drive}/statistics",
        "GET /groups",
        "GET /buses",
        "GET /buses/{bus}",
        "GET /buses/{bus}/frames",
        "GET /history/tags",
        "GET /history/trend",
        "GET /history/export",
        "GET /history/markers",
        "GET /alarms",
        "GET /alarms/history",
        "GET /cases",
        "GET /cases/{case}",
    ),
    RoutePolicy("GET", "/metrics", Right.VIEW),
    *_policies(
        Right.STOP,
        "POST /stop",
        "POST /drives/{drive}/stop",
        "POST /drives/{drive}/jog/end",
        "POST /groups/{group}/stop",
    ),
    RoutePolicy("POST", "/api/v1/drives/{drive}/lease/renew", Right.STOP, is_user_activity=False),
    *_policies(
        Right.OPERATE,
        "POST /drives/{drive}/parameters/read",
        "POST /drives/{drive}/lease",
        "DELETE /drives/{drive}/lease",
        "POST /drives/{drive}/arm",
        "POST /drives/{drive}/run",
        "POST /drives/{drive}/set-frequency",
        "POST /drives/{drive}/jog",
        "POST /drives/{drive}/jog/renew",
        "POST /drives/{drive}/reset",
        "POST /drives/{drive}/release",
        "POST /groups/{group}/arm",
        "POST /groups/{group}/start",
        "POST /groups/{group}/set-frequency",
        "POST /alarms/{alarm}/acknowledge",
        "POST /alarms/{alarm}/shelve",
        "POST /alarms/{alarm}/unshelve",
    ),
    *_policies(Right.WRITE_PARAMETERS, "POST /drives/{drive}/parameters/write"),
    *_policies(
        Right.LIMIT, "POST /drives/{drive}/waiver", "DELETE /drives/{drive}/waiver", "PUT /drives/{drive}/limits"
    ),
    *_policies(Right.AUDIT, "GET /audit", "GET /audit/verify"),
    *_policies(Right.CONFIGURE, "GET /configuration", "POST /configuration/check", "POST /configuration/reload"),
)

_PATTERNS = [(entry, entry.pattern) for entry in ROUTE_POLICIES]


def policies_for(path: str) -> list[RoutePolicy]:
    """Every method of the address that ``path`` is."""
    return [entry for entry, pattern in _PATTERNS if pattern.fullmatch(path)]
