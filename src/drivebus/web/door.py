"""The door: who comes, from where, to which address, with which right. Nothing behind it runs before it said yes."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from drivebus.plant.access.access import Access
from drivebus.plant.access.refusals import AccessError, Conflict, Forbidden, NoSuch, NotLoggedIn
from drivebus.plant.access.rights import Right
from drivebus.plant.access.visitor import BySession, ByToken, Visitor
from drivebus.plant.actor import Actor
from drivebus.plant.turns import turn
from drivebus.web import body, rights
from drivebus.web.answers import refuse
from drivebus.web.hosts import Hosts
from drivebus.web.refused import Refusals
from drivebus.web.rights import Door, Entry
from drivebus.web.watch import watched

COOKIES = ("__Host-drivebus", "drivebus_session")
"""The first over TLS, where the browser itself guards it; the second on this machine."""
CSRF = "x-drivebus-csrf"


class NotThisWay(AccessError):
    """The address exists, the method does not."""

    status = 405


class Guard:
    """Middleware. A request goes on with ``state.visitor``, or is refused and told to the audit trail."""

    def __init__(self, app: ASGIApp, access: Access, hosts: Hosts, refusals: Refusals) -> None:
        self.app = app
        self.access = access
        self.hosts = hosts
        self.refusals = refusals

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers, entry, visitor = Headers(scope=scope), None, None
        try:
            self._check_place(scope, headers)
            entry = _entry(scope)
            if entry.waits:
                await turn()
            visitor = self._visitor(entry, headers, scope)
            self._check_right(entry, visitor)
            if entry.method not in rights.READS:
                largest = body.OF_ANYBODY if isinstance(entry.need, Door) else body.LARGEST
                receive = body.replayed(await body.read(receive, headers, largest), receive)
        except AccessError as error:
            await self._refuse(error, scope, entry, visitor, send)
            return
        await self._let_in(entry, visitor, scope, receive, send)

    def _check_place(self, scope: Scope, headers: Headers) -> None:
        """Raises Forbidden for a foreign Host, and for a foreign Origin of anything that is not a plain read."""
        if not self.hosts.knows(headers):
            raise Forbidden("access.foreign_host")
        if _method(scope) == "GET" or "origin" not in headers:
            return
        if not self.hosts.origin_fits(headers, scope["scheme"]):
            raise Forbidden("access.foreign_origin")

    def _visitor(self, entry: Entry, headers: Headers, scope: Scope) -> Visitor | None:
        """None where no credential is good. Raises Forbidden for a cookie without its CSRF token."""
        if "authorization" in headers:
            return self._by_token(headers, scope)
        found = self._by_cookie(headers)
        if found is not None and entry.need is not Door.PUBLIC:
            self._check_same_site(entry, headers, found)
        return found

    def _by_token(self, headers: Headers, scope: Scope) -> ByToken | None:
        kind, _, secret = headers["authorization"].partition(" ")
        return self.access.by_token(secret.strip(), address(scope)) if kind.lower() == "bearer" else None

    def _by_cookie(self, headers: Headers) -> BySession | None:
        secret = cookie(headers)
        return self.access.by_cookie(secret) if secret else None

    def _check_same_site(self, entry: Entry, headers: Headers, visitor: BySession) -> None:
        """A cookie comes by itself, whoever made the browser ask: something else must show that our page did."""
        if entry.method == rights.WEBSOCKET and "origin" not in headers:
            raise Forbidden("access.foreign_origin")
        if entry.method not in rights.READS and headers.get(CSRF) != visitor.session.csrf:
            raise Forbidden("access.csrf")

    def _check_right(self, entry: Entry, visitor: Visitor | None) -> None:
        """Raises Conflict before the set-up (S06), whoever asks; whom somebody made an operator by hand may stop."""
        if entry.need is Door.PUBLIC:
            return
        if self.access.needs_setup and not (visitor is not None and entry.need is Right.STOP):
            raise Conflict("access.setup_needed")
        if visitor is None:
            raise NotLoggedIn("access.not_logged_in")
        if entry.need is Door.SESSION:
            if not isinstance(visitor, BySession):
                raise Forbidden("access.only_session")
            return
        if not visitor.actor.may(entry.need):
            key = "access.idle" if visitor.is_idle else "access.forbidden"
            raise Forbidden(key, right=entry.need)

    async def _refuse(
        self, error: AccessError, scope: Scope, entry: Entry | None, visitor: Visitor | None, send: Send
    ) -> None:
        """In its turn: strangers may ask for stops, too."""
        await turn()
        actor = Actor("", frozenset(), "", address=address(scope)) if visitor is None else visitor.actor
        await self.refusals.refused(_method(scope), entry.path if entry else "-", error.key, actor)
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 4000 + error.status})
        else:
            await refuse(send, error, (b"connection", b"close"))

    async def _let_in(self, entry: Entry, visitor: Visitor | None, scope: Scope, receive: Receive, send: Send) -> None:
        scope.setdefault("state", {})["visitor"] = visitor
        if isinstance(visitor, BySession) and entry.by_hand and entry.method not in rights.READS:
            await self.access.touch(visitor.session)
        if scope["type"] == "websocket" and visitor is not None:
            await watched(self.app, visitor, scope, receive, send)
        else:
            await self.app(scope, receive, send)


def cookie(headers: Headers) -> str | None:
    """The session's secret, where a cookie holds one. Cookies are shared with every other port of the host: whatever
    stands beside ours is nobody's business."""
    pairs = (pair.partition("=") for line in headers.getlist("cookie") for pair in line.split(";"))
    found = {name.strip(): value.strip() for name, _, value in pairs}
    return next((found[name] for name in COOKIES if name in found), None)


def address(scope: Scope) -> str:
    """Where the connection comes from; a header can't claim another."""
    return scope["client"][0] if scope.get("client") else "local"


def _method(scope: Scope) -> str:
    return rights.WEBSOCKET if scope["type"] == "websocket" else scope["method"]


def _entry(scope: Scope) -> Entry:
    """Raises NoSuch, NotThisWay."""
    known = rights.entries_for(scope["path"])
    if not known:
        raise NoSuch("access.no_such_address")
    found = next((entry for entry in known if entry.method == _method(scope)), None)
    if found is None:
        raise NotThisWay("access.no_such_method", allowed=", ".join(sorted(entry.method for entry in known)))
    return found
