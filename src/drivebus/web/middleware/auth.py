"""Authentication and authorization of every request, before a route runs and before its body is read.

Order: host and origin, route, turn on the event loop, credential, CSRF token, right, body, right. A request that fails
one of them is answered here and recorded through the audit aggregator.
"""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivebus.errors import DrivebusError
from drivebus.service.api.audit_aggregator import AuditAggregator
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential, SessionCredential, TokenCredential
from drivebus.service.auth.errors import AccessDenied, NotAuthenticated, ResourceNotFound
from drivebus.service.auth.rights import AccessLevel, RequiredAccess, Right
from drivebus.service.auth.service import AuthService
from drivebus.service.runtime.fairness import yield_to_loop
from drivebus.web.errors import MethodNotAllowed, http_status, send_error
from drivebus.web.middleware.host_check import HostCheck
from drivebus.web.middleware.request_body import MAX_BODY_BYTES, MAX_PUBLIC_BODY_BYTES, read_body
from drivebus.web.middleware.session_expiry import run_until_credential_ends
from drivebus.web.middleware.trusted_proxies import TrustedProxies
from drivebus.web.route import READ_METHODS, WEBSOCKET, Route, RouteTable
from drivebus.web.session_end import SessionEndWatch

COOKIE_NAMES = ("__Host-drivebus", "drivebus_session")
"""The first over TLS, where the browser protects it by its prefix; the second over HTTP on this machine."""
CSRF_HEADER = "x-drivebus-csrf"
WEBSOCKET_CLOSE_BASE = 4000  # a rejected WebSocket closes with this plus the HTTP status


class AuthMiddleware:
    """ASGI middleware: forward a permitted request with what it has checked in ``state``, deny the others."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        auth: AuthService,
        hosts: HostCheck,
        proxies: TrustedProxies,
        aggregator: AuditAggregator,
        routes: RouteTable,
        end_watch: SessionEndWatch,
    ) -> None:
        self.app = app
        self.auth = auth
        self.hosts = hosts
        self.proxies = proxies
        self.aggregator = aggregator
        self.routes = routes
        self.end_watch = end_watch

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers, route, credential = Headers(scope=scope), None, None
        state = scope.setdefault("state", {})
        self.proxies.resolve(scope, headers)
        try:
            self._check_origin(scope, headers)
            state["uses_tls"] = self.hosts.uses_tls(headers, scope["scheme"])
            route = self._match(scope)
            if route.yields:
                await yield_to_loop()
            credential = state["credential"] = self._authenticate(route, headers, scope)
            self._check_right(route, credential)
            if route.method not in READ_METHODS:
                is_public = isinstance(route.access, AccessLevel)
                max_bytes = MAX_PUBLIC_BODY_BYTES if is_public else MAX_BODY_BYTES
                state["body"] = await read_body(receive, headers, max_bytes)
                self._check_right(route, credential)  # again: the client may have sent its body for ten seconds
        except DrivebusError as error:
            await self._deny(error, scope, route, credential, send)
            return
        await self._forward(route, credential, scope, receive, send)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        """Check the Host, and the Origin of anything but a GET. Raises AccessDenied for a foreign one."""
        if not self.hosts.is_known_host(headers):
            raise AccessDenied("auth.foreign_host")
        if _method(scope) == "GET" or "origin" not in headers:
            return
        if not self.hosts.is_allowed_origin(headers, scope["scheme"]):
            raise AccessDenied("auth.foreign_origin")

    def _match(self, scope: Scope) -> Route:
        """Return the route of a request. Raises ResourceNotFound, MethodNotAllowed."""
        routes = self.routes.match(scope["path"])
        if not routes:
            raise ResourceNotFound("auth.no_such_address")
        matching = next((route for route in routes if route.method == _method(scope)), None)
        if matching is None:
            allowed = {route.method for route in routes} | {"HEAD" for route in routes if route.method == "GET"}
            raise MethodNotAllowed("auth.no_such_method", allowed=tuple(sorted(allowed)))
        return matching

    def _authenticate(self, route: Route, headers: Headers, scope: Scope) -> Credential | None:
        """Return the valid credential, if any. Raises AccessDenied for a cookie without its CSRF token."""
        if "authorization" in headers:
            return self._credential_from_token(headers, scope)
        credential = self._credential_from_cookie(headers, uses_tls=scope["state"]["uses_tls"])
        if credential is not None and route.access is not AccessLevel.PUBLIC:
            self._check_csrf(route, headers, credential)
        return credential

    def _credential_from_token(self, headers: Headers, scope: Scope) -> TokenCredential | None:
        kind, _, secret = headers["authorization"].partition(" ")
        is_bearer = kind.lower() == "bearer"
        return self.auth.token_credential(secret.strip(), client_address(scope)) if is_bearer else None

    def _credential_from_cookie(self, headers: Headers, *, uses_tls: bool) -> SessionCredential | None:
        secret = session_cookie(headers, uses_tls=uses_tls)
        return self.auth.session_credential(secret) if secret else None

    def _check_csrf(self, route: Route, headers: Headers, credential: SessionCredential) -> None:
        """Check that the page of this service sent a request. Raises AccessDenied.

        A browser adds the cookie to every request, but only the page knows the CSRF token.
        """
        if route.method == WEBSOCKET and "origin" not in headers:
            raise AccessDenied("auth.foreign_origin")
        if route.method not in READ_METHODS and headers.get(CSRF_HEADER) != credential.session.csrf:
            raise AccessDenied("auth.csrf")

    def _check_right(self, route: Route, credential: Credential | None) -> None:
        """Check the right of a route. Raises Conflict before the set-up, NotAuthenticated, AccessDenied.

        A user added on the command line may stop before the set-up.
        """
        if route.access is AccessLevel.PUBLIC:
            return
        if credential is None or route.access is not Right.STOP:
            self.auth.check_set_up()
        if credential is None or credential.end_reason is not None:
            raise NotAuthenticated("auth.not_logged_in")
        if route.access is AccessLevel.SESSION:
            if not isinstance(credential, SessionCredential):
                raise AccessDenied("auth.only_session")
            return
        if not credential.actor.may(route.access):
            raise _right_missing(route.access, credential)

    async def _deny(
        self, error: DrivebusError, scope: Scope, route: Route | None, credential: Credential | None, send: Send
    ) -> None:
        """Record and answer a denied request, after the requests that came before it.

        The record has the path of the route table, also where it lacks the method; ``-`` where no route was looked up
        or found.
        """
        await yield_to_loop()
        actor = Actor("", frozenset(), "", address=client_address(scope)) if credential is None else credential.actor
        if isinstance(error, MethodNotAllowed):
            route = self.routes.match(scope["path"])[0]
        await self.aggregator.record_denial(_method(scope), route.path if route else "-", error.key, actor)
        if scope["type"] != "websocket":
            await send_error(send, error)
        elif "websocket.http.response" in scope.get("extensions", {}):
            await send_error(_websocket_denial(send), error)
        else:
            await send({"type": "websocket.close", "code": WEBSOCKET_CLOSE_BASE + http_status(type(error))})

    async def _forward(
        self, route: Route, credential: Credential | None, scope: Scope, receive: Receive, send: Send
    ) -> None:
        if credential is not None:
            self.end_watch.watch(credential)
        if isinstance(credential, SessionCredential) and not route.background and route.method not in READ_METHODS:
            await self.auth.record_activity(credential.session)
        if scope["type"] == "websocket" and credential is not None:
            await run_until_credential_ends(self.app, credential, scope, receive, send)
        else:
            await self.app(scope, receive, send)


def _websocket_denial(send: Send) -> Send:
    """Return a sender of the HTTP response to a handshake, instead of a close without status and reason."""

    async def send_to_handshake(message: Message) -> None:
        await send({**message, "type": f"websocket.{message['type']}"})

    return send_to_handshake


def _right_missing(right: RequiredAccess, credential: Credential) -> AccessDenied:
    """Return the error of a missing right; it names the token where the user has the right."""
    if isinstance(credential, TokenCredential) and credential.user_may(right):
        return AccessDenied("auth.token_forbidden", right=right, token=credential.token.name)
    return AccessDenied("auth.idle" if credential.is_idle else "auth.forbidden", right=right)


def session_cookie(headers: Headers, *, uses_tls: bool = False) -> str | None:
    """Return the secret of the session cookie; over TLS only of the one with the prefix, which no other page can set.

    Cookies are shared with every other port of the host, so other and malformed ones are skipped.
    """
    cookies = request_cookies(headers)
    return next((cookies[name] for name in COOKIE_NAMES[: 1 if uses_tls else None] if name in cookies), None)


def request_cookies(headers: Headers) -> dict[str, str]:
    """Return the cookies of a request by name."""
    pairs = (pair.partition("=") for line in headers.getlist("cookie") for pair in line.split(";"))
    return {name.strip(): value.strip() for name, _, value in pairs}


def client_address(scope: Scope) -> str:
    """Return the address of the connection, or the one that a trusted proxy names (``TrustedProxies``)."""
    return scope["client"][0] if scope.get("client") else "local"


def _method(scope: Scope) -> str:
    return WEBSOCKET if scope["type"] == "websocket" else scope["method"]
