"""``Access``: who is it? Logging in, out, and finding whoever comes with a cookie or a token."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivebus.plant.access.kept import Keeper
from drivebus.plant.access.passwords import Passwords, check_new
from drivebus.plant.access.refusals import Conflict, Forbidden, NotLoggedIn, TooManyAttempts
from drivebus.plant.access.register import Once, Register, User, plain
from drivebus.plant.access.rights import Role
from drivebus.plant.access.sessions import Session, Sessions, digest
from drivebus.plant.access.setup import SetUp
from drivebus.plant.access.store import AccessFile
from drivebus.plant.access.throttle import Throttle
from drivebus.plant.access.visitor import Around, BySession, ByToken, Visitor
from drivebus.seams import Clock, wall_ms

KEEP_S = 60.0
"""How far back the last touch of a session may lie after a crash of the web process."""


@dataclass(frozen=True, slots=True)
class Opened:
    """A login that worked. ``secret`` goes into the cookie and is known to nobody else."""

    secret: str
    session: Session


class Access:
    """Users, sessions and tokens of one plant; lives in the web process. ``file`` None: ``access.json`` there."""

    def __init__(
        self,
        directory: Path,
        file: Path | None = None,
        *,
        passwords: Passwords | None = None,
        clock: Clock = time.monotonic,
        wall: Callable[[], int] = wall_ms,
    ) -> None:
        self.file = AccessFile(file or directory / "access.json")
        self.passwords = passwords or Passwords()
        self.sessions = Sessions()
        self.keeper = Keeper(directory)
        self.sessions.restore(self.keeper.read())
        self._keeping = asyncio.Lock()
        self._kept_at = clock()
        self._later: set[asyncio.Task[None]] = set()
        self.setup = SetUp(directory)
        self.clock = clock
        self.wall_ms = wall
        self.throttle = Throttle()
        self.around = Around(self.file.read, clock, wall)

    @property
    def register(self) -> Register:
        return self.file.read()

    @property
    def needs_setup(self) -> bool:
        return not self.register.has_administrator

    async def change(self, change: Callable[[Register], Register]) -> Register:
        """Change the register, durably; the loop does not wait for the disk."""
        return await asyncio.to_thread(self.file.change, change)

    async def keep(self) -> None:
        """Write down which sessions there are, for the next process; nothing fails where that can't be done."""
        async with self._keeping:
            self._kept_at = self.clock()
            await asyncio.to_thread(self.keeper.write, self.sessions.kept())

    async def touch(self, session: Session) -> None:
        """The person behind it did something. Nobody waits for the disk here: it may be a stop (6.5)."""
        session.touch(self.clock())
        if self.clock() - self._kept_at >= KEEP_S and not self._later:
            later = asyncio.create_task(self.keep())
            self._later.add(later)
            later.add_done_callback(self._later.discard)

    async def set_up(self, secret: str, name: str, password: str, address: str) -> Opened:
        """The first administrator. Raises Conflict where there is one, NotLoggedIn for a wrong secret."""
        if not self.needs_setup:
            raise Conflict("access.is_set_up")
        self._try_of(f"setup@{_net(address)}")
        if not self.setup.fits(secret):
            raise NotLoggedIn("access.wrong_secret")
        user = await self.made(name, Role.ADMINISTRATOR, password)
        await self.change(lambda register: _first(register, user))
        self.setup.used()
        return await self._open(user, address)

    async def made(self, name: str, role: Role, password: str) -> User:
        """A user to be added. Raises Unfit for the password, Unavailable."""
        hashed = await self.passwords.hash(check_new(password, plain(name)))
        return User(plain(name), role, hashed, self.wall_ms())

    async def login(self, name: str, password: str, address: str) -> Opened:
        """Raises NotLoggedIn (which of the two was wrong is not told), TooManyAttempts, Unavailable."""
        user = self.register.find(name)
        await self._check(user, name, password, address)
        current = self.register.find(name)
        if user is None or current is None or current.stamp != user.stamp:
            raise NotLoggedIn("access.wrong_password")
        return await self._open(current, address)

    async def login_once(self, code: str, address: str) -> Opened:
        """By a code that works once. Raises NotLoggedIn, TooManyAttempts."""
        keys, at = self._try_of(_net(address))
        found = self._code(code)
        if found is None:
            raise NotLoggedIn("access.wrong_code")
        await self.change(lambda register: self._spend(register, found))
        user = self.register.user(found.user)
        if user.disabled:
            raise NotLoggedIn("access.wrong_code")
        self.throttle.succeeded(keys, at)
        return await self._open(user, address)

    async def issue_code(self, user: str, lasts_s: float) -> str:
        """A one-time code for ``user``. Raises NoSuch."""
        code = secrets.token_urlsafe(16)
        now_ms = self.wall_ms()
        once = Once(digest(code), plain(user), now_ms + round(lasts_s * 1000))
        await self.change(lambda register: register.with_code(once, now_ms))
        return code

    async def log_out(self, session: Session) -> None:
        """This one."""
        session.end("logout")
        await self.keep()

    async def end_all(self, user: str, why: str) -> int:
        """Every session of the user; how many there were (S07)."""
        ended = self.sessions.end_all(plain(user), why)
        await self.keep()
        return ended

    async def new_password(self, session: Session, old: str, new: str) -> Opened:
        """One's own. Ends every session of the user; the new one is the caller's. Raises Forbidden where ``old`` is
        wrong, TooManyAttempts, Unfit."""
        user = await self._own(session, old)
        hashed = await self.passwords.hash(check_new(new, user.name))

        def change(register: Register) -> Register:
            now = register.user(user.name)
            if now.stamp != user.stamp:  # an administrator was quicker: role, password or leave to come in
                raise NotLoggedIn("access.wrong_password")
            return register.changed(replace(now, password=hashed))

        changed = (await self.change(change)).user(user.name)
        self.sessions.end_all(user.name, "rights")
        return await self._open(changed, session.address)

    async def wake(self, session: Session, password: str) -> Opened:
        """An idle session gets its rights back; it stays the same one, so that its leases go on (S07).

        Raises Forbidden for a wrong password, TooManyAttempts.
        """
        await self._own(session, password)
        secret = self.sessions.wake(session, self.clock())
        await self.keep()
        return Opened(secret, session)

    async def _own(self, session: Session, password: str) -> User:
        """The session's user, by the password. Not NotLoggedIn: the session goes on, and with it the right to stop."""
        user = self.register.user(session.user)
        try:
            await self._check(user, user.name, password, session.address)
        except NotLoggedIn as error:
            raise Forbidden(error.key) from error
        return user

    def by_cookie(self, secret: str) -> BySession | None:
        session = self.sessions.find(secret, self.clock())
        visitor = BySession(session, self.around) if session is not None else None
        return visitor if visitor is not None and visitor.why_over is None else None

    def by_token(self, secret: str, address: str) -> ByToken | None:
        wanted = digest(secret)
        token = next((token for token in self.register.tokens if token.digest == wanted), None)
        visitor = ByToken(token, address, self.around) if token is not None else None
        return visitor if visitor is not None and visitor.why_over is None else None

    async def _open(self, user: User, address: str) -> Opened:
        secret, session = self.sessions.open(user, address, self.clock())
        await self.keep()
        return Opened(secret, session)

    async def _check(self, user: User | None, name: str, password: str, address: str) -> None:
        keys, at = self._try_of(f"user:{digest(plain(name))}", _net(address))
        known = user.password if user is not None and not user.disabled else None
        if not await self.passwords.verify(known, password):
            raise NotLoggedIn("access.wrong_password")
        self.throttle.succeeded(keys, at)

    def _try_of(self, *keys: str) -> tuple[tuple[str, ...], float]:
        """Raises TooManyAttempts."""
        now = self.clock()
        wait_s = self.throttle.wait_s(keys, now)
        if wait_s > 0:
            raise TooManyAttempts("access.too_many", retry_s=round(wait_s, 1))
        self.throttle.tried(keys, now)
        return keys, now

    def _code(self, code: str) -> Once | None:
        wanted, now_ms = digest(code), self.wall_ms()
        return next((one for one in self.register.codes if one.digest == wanted and one.expires_ms > now_ms), None)

    def _spend(self, register: Register, code: Once) -> Register:
        """Raises NotLoggedIn where somebody else was faster."""
        if code not in register.codes:
            raise NotLoggedIn("access.wrong_code")
        return register.without_code(code.digest)


def _first(register: Register, user: User) -> Register:
    """Of two that set up at the same time, one does."""
    if register.has_administrator:
        raise Conflict("access.is_set_up")
    return register.added(user)


def _net(address: str) -> str:
    """Guessers change addresses within their own IPv6 network at will: count the /64. Where both are listened for, an
    IPv4 address comes as ``::ffff:10.0.0.9``: those are not one network."""
    try:
        parsed = ipaddress.IPv6Address(address)
    except ValueError:
        return f"address:{address}"
    network = parsed if parsed.ipv4_mapped else ipaddress.ip_network((parsed, 64), strict=False)
    return f"address:{network}"


__all__ = ["Access", "Opened", "Visitor"]
