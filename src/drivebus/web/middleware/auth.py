"""The door: who comes, from where, to which address, with which right. Nothing behind it runs before it said yes."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential, SessionCredential, TokenCredential
from drivebus.service.auth.errors import AccessDenied, AuthError, Conflict, NotAuthenticated, ResourceNotFound
from drivebus.service.auth.rights import Right
from drivebus.service.auth.service import AuthService
from drivebus.service.runtime.fairness import yield_to_loop
from drivebus.web import route_policy
from drivebus.web.error_response import send_error
from drivebus.web.error_status import RequestError, http_status
from drivebus.web.middleware import request_body
from drivebus.web.middleware.denial_log import DenialLog
from drivebus.web.middleware.host_check import HostCheck
from drivebus.web.middleware.session_expiry import run_until_credential_ends
from drivebus.web.route_policy import AccessLevel, RoutePolicy

COOKIE_NAMES = ("__Host-drivebus", "drivebus_session")
"""The first over TLS, where the browser itself guards it; the second on this machine."""
CSRF_HEADER = "x-drivebus-csrf"


class MethodNotAllowed(RequestError):
    """The address exists, the method does not."""

    status = 405


class AuthMiddleware:
    """Middleware. A request goes on with ``state.visitor``, or is refused and told to the audit trail."""

    def __init__(self, app: ASGIApp, access: AuthService, hosts: HostCheck, refusals: DenialLog) -> None:
        self.app = app
        self.access = access
        self.hosts = hosts
        self.denials = refusals

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers, entry, visitor = Headers(scope=scope), None, None
        try:
            self._check_origin(scope, headers)
            entry = _match(scope)
            if entry.yields:
                await yield_to_loop()
            visitor = self._authenticate(entry, headers, scope)
            self._check_right(entry, visitor)
            if entry.method not in route_policy.READ_METHODS:
                largest = (
                    request_body.MAX_PUBLIC_BODY_BYTES
                    if isinstance(entry.access, AccessLevel)
                    else request_body.MAX_BODY_BYTES
                )
                receive = request_body.replay_body(await request_body.read_body(receive, headers, largest), receive)
        except AuthError as error:
            await self._deny(error, scope, entry, visitor, send)
            return
        await self._forward(entry, visitor, scope, receive, send)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        """Raises Forbidden for a foreign Host, and for a foreign Origin of anything that is not a plain read."""
        if not self.hosts.is_known_host(headers):
            raise AccessDenied("access.foreign_host")
        if _method(scope) == "GET" or "origin" not in headers:
            return
        if not self.hosts.is_allowed_origin(headers, scope["scheme"]):
            raise AccessDenied("access.foreign_origin")

    def _authenticate(self, entry: RoutePolicy, headers: Headers, scope: Scope) -> Credential | None:
        """None where no credential is good. Raises Forbidden for a cookie without its CSRF token."""
        if "authorization" in headers:
            return self._credential_from_token(headers, scope)
        found = self._credential_from_cookie(headers)
        if found is not None and entry.access is not AccessLevel.PUBLIC:
            self._check_csrf(entry, headers, found)
        return found

    def _credential_from_token(self, headers: Headers, scope: Scope) -> TokenCredential | None:
        kind, _, secret = headers["authorization"].partition(" ")
        return self.access.token_credential(secret.strip(), client_address(scope)) if kind.lower() == "bearer" else None

    def _credential_from_cookie(self, headers: Headers) -> SessionCredential | None:
        secret = session_cookie(headers)
        return self.access.session_credential(secret) if secret else None

    def _check_csrf(self, entry: RoutePolicy, headers: Headers, visitor: SessionCredential) -> None:
        """A cookie comes by itself, whoever made the browser ask: something else must show that our page did."""
        if entry.method == route_policy.WEBSOCKET and "origin" not in headers:
            raise AccessDenied("access.foreign_origin")
        if entry.method not in route_policy.READ_METHODS and headers.get(CSRF_HEADER) != visitor.session.csrf:
            raise AccessDenied("access.csrf")

    def _check_right(self, entry: RoutePolicy, visitor: Credential | None) -> None:
        """Raises Conflict before the set-up (S06), whoever asks; whom somebody made an operator by hand may stop."""
        if entry.access is AccessLevel.PUBLIC:
            return
        if self.access.needs_setup and not (visitor is not None and entry.access is Right.STOP):
            raise Conflict("access.setup_needed")
        if visitor is None:
            raise NotAuthenticated("access.not_logged_in")
        if entry.access is AccessLevel.SESSION:
            if not isinstance(visitor, SessionCredential):
                raise AccessDenied("access.only_session")
            return
        if not visitor.actor.may(entry.access):
            key = "access.idle" if visitor.is_idle else "access.forbidden"
            raise AccessDenied(key, right=entry.access)

    async def _deny(
        self, error: AuthError, scope: Scope, entry: RoutePolicy | None, visitor: Credential | None, send: Send
    ) -> None:
        """In its turn: strangers may ask for stops, too."""
        await yield_to_loop()
        actor = Actor("", frozenset(), "", address=client_address(scope)) if visitor is None else visitor.actor
        await self.denials.record_denial(_method(scope), entry.path if entry else "-", error.key, actor)
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 4000 + http_status(error)})
        else:
            await send_error(send, error, (b"connection", b"close"))

    async def _forward(
        self, entry: RoutePolicy, visitor: Credential | None, scope: Scope, receive: Receive, send: Send
    ) -> None:
        scope.setdefault("state", {})["visitor"] = visitor
        if (
            isinstance(visitor, SessionCredential)
            and entry.is_user_activity
            and entry.method not in route_policy.READ_METHODS
        ):
            await self.access.record_activity(visitor.session)
        if scope["type"] == "websocket" and visitor is not None:
            await run_until_credential_ends(self.app, visitor, scope, receive, send)
        else:
            await self.app(scope, receive, send)


def session_cookie(headers: Headers) -> str | None:
    """The session's secret, where a cookie holds one. Cookies are shared with every other port of the host: whatever
    stands beside ours is nobody's business."""
    pairs = (pair.partition("=") for line in headers.getlist("cookie") for pair in line.split(";"))
    found = {name.strip(): value.strip() for name, _, value in pairs}
    return next((found[name] for name in COOKIE_NAMES if name in found), None)


def client_address(scope: Scope) -> str:
    """Where the connection comes from; a header can't claim another."""
    return scope["client"][0] if scope.get("client") else "local"


def _method(scope: Scope) -> str:
    return route_policy.WEBSOCKET if scope["type"] == "websocket" else scope["method"]


def _match(scope: Scope) -> RoutePolicy:
    """Raises ResourceNotFound, MethodNotAllowed."""
    known = route_policy.policies_for(scope["path"])
    if not known:
        raise ResourceNotFound("access.no_such_address")
    found = next((entry for entry in known if entry.method == _method(scope)), None)
    if found is None:
        raise MethodNotAllowed("access.no_such_method", allowed=", ".join(sorted(entry.method for entry in known)))
    return found
