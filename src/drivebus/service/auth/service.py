"""Authentication service of a plant: set-up, login, logout, and the credential of a cookie or a token."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivebus.clock import Clock, wall_ms
from drivebus.service.auth.credentials import AuthContext, SessionCredential, TokenCredential
from drivebus.service.auth.devices import DeviceCookies
from drivebus.service.auth.errors import AccessDenied, Conflict, NotAuthenticated, ResourceNotFound, TooManyAttempts
from drivebus.service.auth.names import normalized_name
from drivebus.service.auth.password_policy import check_password_policy
from drivebus.service.auth.passwords import PasswordHashing
from drivebus.service.auth.rights import Role
from drivebus.service.auth.sessions import Session, SessionStore, SessionTable, secret_digest
from drivebus.service.auth.setup_secret import SetupSecret
from drivebus.service.auth.throttle import AttemptKeys, LoginThrottle, address_key, unknown_browser_keys
from drivebus.service.auth.users import OneTimeCode, User, UserDatabase, UserFile
from drivebus.service.config.model import USER_FILE

SESSION_SAVE_INTERVAL_S = 60.0
"""Activity of a session that a crash of the web process may lose."""


@dataclass(frozen=True, slots=True)
class LoginResult:
    """Successful login. ``secret`` is for the cookie and is stored nowhere."""

    secret: str
    session: Session


class AuthService:
    """Users, sessions and tokens of one plant. ``file`` None: ``USER_FILE`` in ``directory``."""

    def __init__(
        self,
        directory: Path,
        file: Path | None = None,
        *,
        had_users: bool = False,
        passwords: PasswordHashing | None = None,
        clock: Clock = time.monotonic,
        wall_ms: Callable[[], int] = wall_ms,
    ) -> None:
        """``had_users``: it is known from elsewhere that the plant had users before."""
        self._had_users = had_users
        self.user_file = UserFile(file or directory / USER_FILE)
        self.passwords = passwords or PasswordHashing()
        self.sessions = SessionTable()
        self.session_store = SessionStore(directory)
        self.sessions.restore(self.session_store.read())
        self._save_lock = asyncio.Lock()
        self._saved_at = clock()
        self._save_tasks: set[asyncio.Task[None]] = set()
        self.setup_secret = SetupSecret(directory)
        self.clock = clock
        self.wall_ms = wall_ms
        self.failed_logins = Counter[str]()
        """User → wrong passwords since the last login, while this process runs."""
        self.throttle = LoginThrottle()
        """Throttle of passwords."""
        self.secret_throttle = LoginThrottle()
        """Throttle of set-up secrets and one-time codes, which take no hash: a flood of them must not reach the other
        counts.
        """
        self.devices = DeviceCookies(directory)
        self.context = AuthContext(self.user_file.read, clock, wall_ms)

    @property
    def database(self) -> UserDatabase:
        return self.user_file.read()

    @property
    def needs_setup(self) -> bool:
        return not self.database.has_administrator

    @property
    def users_missing(self) -> bool:
        """Whether the users' file of a plant that had users is gone: then no new set-up is allowed.

        The file, or a new administrator on the command line, ends this state.
        """
        return self.user_file.is_missing and (self._had_users or self.session_store.exists)

    def check_set_up(self) -> None:
        """Raise Conflict while no administrator can log in."""
        if self.needs_setup:
            raise self._users_missing_error() if self.users_missing else Conflict("auth.setup_needed")

    def _users_missing_error(self) -> Conflict:
        return Conflict("auth.users_missing", file=self.user_file.path.name)

    async def change_database(self, change: Callable[[UserDatabase], UserDatabase]) -> UserDatabase:
        """Change the user database durably, without blocking the event loop."""
        return await asyncio.to_thread(self.user_file.change, change)

    async def save_sessions(self) -> None:
        """Save the sessions for the next process. A failed write is ignored: logging in must not depend on it."""
        async with self._save_lock:
            self._saved_at = self.clock()
            await asyncio.to_thread(self.session_store.write, self.sessions.stored())

    async def record_activity(self, session: Session) -> None:
        """Record a user's activity. The save runs in the background, because the request may be a stop."""
        session.record_activity(self.clock())
        if self.clock() - self._saved_at >= SESSION_SAVE_INTERVAL_S and not self._save_tasks:
            task = asyncio.create_task(self.save_sessions())
            self._save_tasks.add(task)
            task.add_done_callback(self._save_tasks.discard)

    async def create_first_administrator(self, secret: str, name: str, password: str, address: str) -> LoginResult:
        """Create the first administrator and log in.

        Raises Conflict if there is one already or the plant's users are missing, NotAuthenticated for a wrong secret,
        TooManyAttempts, InvalidInput, AuthUnavailable.
        """
        if not self.needs_setup:
            raise Conflict("auth.is_set_up")
        if self.users_missing:
            raise self._users_missing_error()
        self._record_attempt(self.secret_throttle, AttemptKeys((f"setup@{address_key(address)}",)))
        if not self.setup_secret.verify(secret):
            raise NotAuthenticated("auth.wrong_secret")
        user = await self.new_user(name, Role.ADMINISTRATOR, password)
        await self.change_database(lambda database: _add_first_administrator(database, user))
        self.setup_secret.consume()
        return await self._open_session(user, address)

    async def new_user(self, name: str, role: Role, password: str) -> User:
        """Return a user to add. Raises InvalidInput for a weak password, AuthUnavailable."""
        hashed = await self.passwords.hash(check_password_policy(password, normalized_name(name)))
        return User(normalized_name(name), role, hashed, self.wall_ms())

    async def login(self, name: str, password: str, address: str, device_cookie: str = "") -> LoginResult:
        """Log in.

        Raises NotAuthenticated, the same for a wrong name and a wrong password; TooManyAttempts, AuthUnavailable.
        ``device_cookie``: what the browser sent as the device cookie of this user.
        """
        user = self.database.find(name)
        device = self.devices.device(name, device_cookie)
        keys = AttemptKeys((f"device:{device}",)) if device else unknown_browser_keys(name, address)
        try:
            await self._verify_password(user, password, keys, is_known=bool(device))
        except NotAuthenticated:
            if user is not None:
                self.failed_logins[user.name] += 1
            raise
        current = self.database.find(name)
        if user is None or current is None or current.stamp != user.stamp:
            raise NotAuthenticated("auth.wrong_password")
        opened = await self._open_session(current, address)
        opened.session.failed_logins = self.failed_logins.pop(current.name, 0)
        return opened

    async def login_with_code(self, code: str, address: str) -> LoginResult:
        """Log in with a one-time code. Raises NotAuthenticated, TooManyAttempts."""
        keys = AttemptKeys((address_key(address),))
        at = self._record_attempt(self.secret_throttle, keys)
        code_record = self._find_code(code)
        if code_record is None:
            raise NotAuthenticated("auth.wrong_code")
        await self.change_database(lambda database: _consume_code(database, code_record))
        user = self.database.user(code_record.user)
        if user.disabled:
            raise NotAuthenticated("auth.wrong_code")
        self.secret_throttle.record_success(keys, at)
        return await self._open_session(user, address)

    async def issue_code(self, user: str, lifetime_s: float) -> str:
        """Return a new one-time code for ``user``. Raises ResourceNotFound."""
        code = secrets.token_urlsafe(16)
        now_ms = self.wall_ms()
        stored = OneTimeCode(secret_digest(code), normalized_name(user), now_ms + round(lifetime_s * 1000))
        await self.change_database(lambda database: database.with_code(stored, now_ms))
        return code

    async def logout(self, session: Session) -> None:
        """End this session."""
        session.end("logout")
        await self.save_sessions()

    async def end_session(self, own: Session, id: str, password: str) -> None:
        """End the session ``id`` of the user of the session ``own``, after a check of the password.

        Raises ResourceNotFound, AccessDenied for a wrong password, TooManyAttempts, AuthUnavailable.
        """
        await self.verify_own_password(own, password)
        ended = next((session for session in self.sessions.of_user(own.user) if session.id == id), None)
        if ended is None:
            raise ResourceNotFound("auth.no_such_session", id=id)
        await self.logout(ended)

    async def end_sessions(self, user: str, reason: str) -> int:
        """End every session of a user and return their number."""
        ended = self.sessions.end_all(normalized_name(user), reason)
        await self.save_sessions()
        return ended

    async def change_password(self, session: Session, old: str, new: str) -> LoginResult:
        """Change the password of the session's user, end all the user's sessions and open a new one.

        Raises AccessDenied for a wrong ``old`` password, TooManyAttempts, InvalidInput, AuthUnavailable.
        """
        user = await self.verify_own_password(session, old)
        hashed = await self.passwords.hash(check_password_policy(new, user.name))

        def change(database: UserDatabase) -> UserDatabase:
            current = database.user(user.name)
            if current.stamp != user.stamp:  # an administrator changed the role or the password meanwhile
                raise NotAuthenticated("auth.wrong_password")
            return database.with_changed_user(replace(current, password=hashed))

        changed = (await self.change_database(change)).user(user.name)
        self.sessions.end_all(user.name, "password")
        return await self._open_session(changed, session.address)

    async def unlock(self, session: Session, password: str) -> LoginResult:
        """Give an idle session its rights back. It stays the same session, so that its control leases stay valid.

        Raises AccessDenied for a wrong password, TooManyAttempts, AuthUnavailable.
        """
        await self.verify_own_password(session, password)
        secret = self.sessions.unlock(session, self.clock())
        await self.save_sessions()
        return LoginResult(secret, session)

    async def verify_own_password(self, session: Session, password: str) -> User:
        """Return the session's user after checking the password; its attempts are counted on their own.

        Raises AccessDenied rather than NotAuthenticated for a wrong password, because the session goes on and keeps its
        right to stop; TooManyAttempts, AuthUnavailable.
        """
        user = self.database.user(session.user)
        try:
            await self._verify_password(user, password, AttemptKeys((f"session:{session.id}",)), is_known=True)
        except NotAuthenticated as error:
            raise AccessDenied(error.key) from error
        return user

    def session_credential(self, secret: str) -> SessionCredential | None:
        """Return the credential of a cookie; None if it is unknown or ended.

        A cookie that an unlocking has just replaced may view and stop for ``REPLACED_SECRET_LIFETIME_S``.
        """
        session, secret_ends = self.sessions.find(secret, self.clock()), None
        if session is None and (replaced := self.sessions.find_replaced(secret)):
            session, secret_ends = replaced
        credential = SessionCredential(session, self.context, secret_ends) if session is not None else None
        return credential if credential is not None and credential.end_reason is None else None

    def token_credential(self, secret: str, address: str) -> TokenCredential | None:
        """Return the credential of a token; None if it is unknown or ended."""
        digest = secret_digest(secret)
        token = next((token for token in self.database.tokens if token.digest == digest), None)
        credential = TokenCredential(token, address, self.context) if token is not None else None
        return credential if credential is not None and credential.end_reason is None else None

    async def _open_session(self, user: User, address: str) -> LoginResult:
        secret, session = self.sessions.open(user, address, self.clock())
        await self.save_sessions()
        return LoginResult(secret, session)

    async def _verify_password(self, user: User | None, password: str, keys: AttemptKeys, *, is_known: bool) -> None:
        """Check a password and count the attempt, unless it is not checked.

        Raises NotAuthenticated, TooManyAttempts, AuthUnavailable.
        """
        self.passwords.check_capacity(is_known=is_known)
        at = self._record_attempt(self.throttle, keys)
        encoded = user.password if user is not None and not user.disabled else None
        if not await self.passwords.verify(encoded, password, is_known=is_known):
            raise NotAuthenticated("auth.wrong_password")
        self.throttle.record_success(keys, at)

    def _record_attempt(self, throttle: LoginThrottle, keys: AttemptKeys) -> float:
        """Count an attempt and return its time. Raises TooManyAttempts."""
        now = self.clock()
        wait_s = throttle.wait_s(keys, now)
        if wait_s > 0:
            raise TooManyAttempts("auth.too_many", retry_s=max(0.1, round(wait_s, 1)))
        throttle.record_attempt(keys, now)
        return now

    def _find_code(self, code: str) -> OneTimeCode | None:
        digest, now_ms = secret_digest(code), self.wall_ms()
        return next(
            (stored for stored in self.database.codes if stored.digest == digest and stored.expires_ms > now_ms), None
        )


def _consume_code(database: UserDatabase, code: OneTimeCode) -> UserDatabase:
    """Remove a code. Raises NotAuthenticated if a concurrent login has used it."""
    if code not in database.codes:
        raise NotAuthenticated("auth.wrong_code")
    return database.without_code(code.digest)


def _add_first_administrator(database: UserDatabase, user: User) -> UserDatabase:
    """Add the first administrator. Raises Conflict if a concurrent set-up has added one."""
    if database.has_administrator:
        raise Conflict("auth.is_set_up")
    return database.with_user(user)
