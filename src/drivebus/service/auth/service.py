"""The one-time set-up secret: shown locally where there is no administrator yet; there is no default password (S06).

``Access``: who is it? Logging in, out, and finding whoever comes with a cookie or a token.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivebus.clock import Clock, wall_ms
from drivebus.service.auth.credentials import AuthContext, Credential, SessionCredential, TokenCredential
from drivebus.service.auth.errors import AccessDenied, Conflict, NotAuthenticated, TooManyAttempts
from drivebus.service.auth.passwords import LoginThrottle, Passwords, check_password_policy
from drivebus.service.auth.rights import Role
from drivebus.service.auth.sessions import Session, SessionStore, SessionTable, secret_digest
from drivebus.service.auth.users import OneTimeCode, User, UserDatabase, UserFile, normalized_name, replace_private

SETUP_SECRET_FILE = "setup-secret"


class SetupSecret:
    """The secret, in ``<directory>/setup-secret`` (0600) while it is needed, in memory for the comparison."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / SETUP_SECRET_FILE
        self._secret: str | None = None

    def issue(self) -> str:
        """Make a secret and write its file; the same one while this process lives and it is not used."""
        if self._secret is None:
            self._secret = secrets.token_urlsafe(16)
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            replace_private(self.path, self._secret.encode() + b"\n")
        return self._secret

    def verify(self, given: str) -> bool:
        if self._secret is None:
            return False
        return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), self._secret.encode())

    def consume(self) -> None:
        """There is an administrator now."""
        self._secret = None
        self.path.unlink(missing_ok=True)


SESSION_SAVE_INTERVAL_S = 60.0
"""How far back the last touch of a session may lie after a crash of the web process."""


@dataclass(frozen=True, slots=True)
class LoginResult:
    """A login that worked. ``secret`` goes into the cookie and is known to nobody else."""

    secret: str
    session: Session


class AuthService:
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
        self.user_file = UserFile(file or directory / "access.json")
        self.passwords = passwords or Passwords()
        self.sessions = SessionTable()
        self.session_store = SessionStore(directory)
        self.sessions.restore(self.session_store.read())
        self._save_lock = asyncio.Lock()
        self._saved_at = clock()
        self._save_tasks: set[asyncio.Task[None]] = set()
        self.setup_secret = SetupSecret(directory)
        self.clock = clock
        self.wall_ms = wall
        self.throttle = LoginThrottle()
        self.context = AuthContext(self.user_file.read, clock, wall)

    @property
    def database(self) -> UserDatabase:
        return self.user_file.read()

    @property
    def needs_setup(self) -> bool:
        return not self.database.has_administrator

    async def change(self, change: Callable[[UserDatabase], UserDatabase]) -> UserDatabase:
        """Change the register, durably; the loop does not wait for the disk."""
        return await asyncio.to_thread(self.user_file.change, change)

    async def keep(self) -> None:
        """Write down which sessions there are, for the next process; nothing fails where that can't be done."""
        async with self._save_lock:
            self._saved_at = self.clock()
            await asyncio.to_thread(self.session_store.write, self.sessions.stored())

    async def record_activity(self, session: Session) -> None:
        """The person behind it did something. Nobody waits for the disk here: it may be a stop (6.5)."""
        session.record_activity(self.clock())
        if self.clock() - self._saved_at >= SESSION_SAVE_INTERVAL_S and not self._save_tasks:
            later = asyncio.create_task(self.keep())
            self._save_tasks.add(later)
            later.add_done_callback(self._save_tasks.discard)

    async def create_first_administrator(self, secret: str, name: str, password: str, address: str) -> LoginResult:
        """The first administrator. Raises Conflict where there is one, NotAuthenticated for a wrong secret."""
        if not self.needs_setup:
            raise Conflict("access.is_set_up")
        self._record_attempt(f"setup@{_throttle_network(address)}")
        if not self.setup_secret.verify(secret):
            raise NotAuthenticated("access.wrong_secret")
        user = await self.new_user(name, Role.ADMINISTRATOR, password)
        await self.change(lambda register: _add_first_administrator(register, user))
        self.setup_secret.consume()
        return await self._open_session(user, address)

    async def new_user(self, name: str, role: Role, password: str) -> User:
        """A user to be added. Raises Unfit for the password, Unavailable."""
        hashed = await self.passwords.hash(check_password_policy(password, normalized_name(name)))
        return User(normalized_name(name), role, hashed, self.wall_ms())

    async def login(self, name: str, password: str, address: str) -> LoginResult:
        """Raises NotAuthenticated (which of the two was wrong is not told), TooManyAttempts, Unavailable."""
        user = self.database.find(name)
        await self._verify_password(user, name, password, address)
        current = self.database.find(name)
        if user is None or current is None or current.stamp != user.stamp:
            raise NotAuthenticated("access.wrong_password")
        return await self._open_session(current, address)

    async def login_with_code(self, code: str, address: str) -> LoginResult:
        """By a code that works once. Raises NotAuthenticated, TooManyAttempts."""
        keys, at = self._record_attempt(_throttle_network(address))
        found = self._find_code(code)
        if found is None:
            raise NotAuthenticated("access.wrong_code")
        await self.change(lambda register: self._consume_code(register, found))
        user = self.database.user(found.user)
        if user.disabled:
            raise NotAuthenticated("access.wrong_code")
        self.throttle.record_success(keys, at)
        return await self._open_session(user, address)

    async def issue_code(self, user: str, lifetime_s: float) -> str:
        """A one-time code for ``user``. Raises ResourceNotFound."""
        code = secrets.token_urlsafe(16)
        now_ms = self.wall_ms()
        once = OneTimeCode(secret_digest(code), normalized_name(user), now_ms + round(lifetime_s * 1000))
        await self.change(lambda register: register.with_code(once, now_ms))
        return code

    async def logout(self, session: Session) -> None:
        """This one."""
        session.end("logout")
        await self.keep()

    async def end_sessions(self, user: str, why: str) -> int:
        """Every session of the user; how many there were (S07)."""
        ended = self.sessions.end_all(normalized_name(user), why)
        await self.keep()
        return ended

    async def change_password(self, session: Session, old: str, new: str) -> LoginResult:
        """One's own. Ends every session of the user; the new one is the caller's. Raises Forbidden where ``old`` is
        wrong, TooManyAttempts, Unfit."""
        user = await self._verify_own_password(session, old)
        hashed = await self.passwords.hash(check_password_policy(new, user.name))

        def change(register: UserDatabase) -> UserDatabase:
            now = register.user(user.name)
            if now.stamp != user.stamp:  # an administrator was quicker: role, password or leave to come in
                raise NotAuthenticated("access.wrong_password")
            return register.with_changed_user(replace(now, password=hashed))

        changed = (await self.change(change)).user(user.name)
        self.sessions.end_all(user.name, "rights")
        return await self._open_session(changed, session.address)

    async def unlock(self, session: Session, password: str) -> LoginResult:
        """An idle session gets its rights back; it stays the same one, so that its leases go on (S07).

        Raises Forbidden for a wrong password, TooManyAttempts.
        """
        await self._verify_own_password(session, password)
        secret = self.sessions.unlock(session, self.clock())
        await self.keep()
        return LoginResult(secret, session)

    async def _verify_own_password(self, session: Session, password: str) -> User:
        """Return the session's user for a correct password. An error leaves the session and its right to stop."""
        user = self.database.user(session.user)
        try:
            await self._verify_password(user, user.name, password, session.address)
        except NotAuthenticated as error:
            raise AccessDenied(error.key) from error
        return user

    def session_credential(self, secret: str) -> SessionCredential | None:
        session = self.sessions.find(secret, self.clock())
        visitor = SessionCredential(session, self.context) if session is not None else None
        return visitor if visitor is not None and visitor.end_reason is None else None

    def token_credential(self, secret: str, address: str) -> TokenCredential | None:
        wanted = secret_digest(secret)
        token = next((token for token in self.database.tokens if token.digest == wanted), None)
        visitor = TokenCredential(token, address, self.context) if token is not None else None
        return visitor if visitor is not None and visitor.end_reason is None else None

    async def _open_session(self, user: User, address: str) -> LoginResult:
        secret, session = self.sessions.open(user, address, self.clock())
        await self.keep()
        return LoginResult(secret, session)

    async def _verify_password(self, user: User | None, name: str, password: str, address: str) -> None:
        keys, at = self._record_attempt(f"user:{secret_digest(normalized_name(name))}", _throttle_network(address))
        known = user.password if user is not None and not user.disabled else None
        if not await self.passwords.verify(known, password):
            raise NotAuthenticated("access.wrong_password")
        self.throttle.record_success(keys, at)

    def _record_attempt(self, *keys: str) -> tuple[tuple[str, ...], float]:
        """Raises TooManyAttempts."""
        now = self.clock()
        wait_s = self.throttle.wait_s(keys, now)
        if wait_s > 0:
            raise TooManyAttempts("access.too_many", retry_s=round(wait_s, 1))
        self.throttle.record_attempt(keys, now)
        return keys, now

    def _find_code(self, code: str) -> OneTimeCode | None:
        wanted, now_ms = secret_digest(code), self.wall_ms()
        return next((one for one in self.database.codes if one.digest == wanted and one.expires_ms > now_ms), None)

    def _consume_code(self, register: UserDatabase, code: OneTimeCode) -> UserDatabase:
        """Raises NotAuthenticated where somebody else was faster."""
        if code not in register.codes:
            raise NotAuthenticated("access.wrong_code")
        return register.without_code(code.digest)


def _add_first_administrator(register: UserDatabase, user: User) -> UserDatabase:
    """Of two that set up at the same time, one does."""
    if register.has_administrator:
        raise Conflict("access.is_set_up")
    return register.with_user(user)


def _throttle_network(address: str) -> str:
    """Guessers change addresses within their own IPv6 network at will: count the /64. Where both are listened for, an
    IPv4 address comes as ``::ffff:10.0.0.9``: those are not one network."""
    try:
        parsed = ipaddress.IPv6Address(address)
    except ValueError:
        return f"address:{address}"
    network = parsed if parsed.ipv4_mapped else ipaddress.ip_network((parsed, 64), strict=False)
    return f"address:{network}"


__all__ = ["AuthService", "Credential", "LoginResult"]
