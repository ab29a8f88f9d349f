"""User database: users, tokens and one-time codes, and their file. Secrets are stored as hashes only."""

from __future__ import annotations

import hashlib
import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fcntl import LOCK_EX, flock
from math import inf
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from drivebus import i18n
from drivebus.atomic_write import PRIVATE_FILE_MODE, atomic_write_private
from drivebus.control_characters import CONTROL_CHARACTERS, is_blank, without_control_characters
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.regular_file import read_regular_file
from drivebus.service.auth.errors import Conflict, InvalidInput, ResourceNotFound
from drivebus.service.auth.names import appearance, check_user_name, normalized_name
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role
from drivebus.values import Text, bilingual_text


@dataclass(frozen=True, slots=True)
class User:
    """Person with a role."""

    name: str
    role: Role
    password: str | None
    """Encoded argon2 hash; None: no login by password."""
    created_ms: int
    disabled: bool = False

    @property
    def rights(self) -> frozenset[Right]:
        return frozenset() if self.disabled else ROLE_RIGHTS[self.role]

    @property
    def stamp(self) -> str:
        """Fingerprint of role, password and state. A change of it ends the user's sessions."""
        state = f"{self.role} {self.password} {self.disabled} {self.created_ms}"
        return hashlib.sha256(state.encode()).hexdigest()

    def change_since(self, stamp: str) -> Literal["disabled", "role", "password"] | None:
        """Return what ends the sessions of an earlier stamp; ``password`` also for a user that was added again."""
        if stamp == self.stamp:
            return None
        if self.disabled:
            return "disabled"
        return "role" if any(replace(self, role=role).stamp == stamp for role in Role) else "password"


@dataclass(frozen=True, slots=True, kw_only=True)
class Token:
    """Access token of a program. It never has more rights than its user."""

    id: str
    name: str
    user: str
    rights: tuple[Right, ...]
    digest: str
    created_ms: int
    expires_ms: int


MAX_TOKENS_PER_USER = 100
"""Each request with a token searches all of them: without a limit one user could slow down those of all others."""


@dataclass(frozen=True, slots=True)
class OneTimeCode:
    """Code that logs a user in once."""

    digest: str
    user: str
    expires_ms: int


@dataclass(frozen=True, slots=True)
class UserDatabase:
    """Immutable set of users, tokens and codes."""

    users: tuple[User, ...] = ()
    tokens: tuple[Token, ...] = ()
    codes: tuple[OneTimeCode, ...] = ()

    def find(self, name: str) -> User | None:
        """Return the user of a name in any spelling."""
        normalized = normalized_name(name)
        return next((user for user in self.users if user.name == normalized), None)

    def user(self, name: str) -> User:
        """Return the user of a name. Raises ResourceNotFound."""
        entry = self.find(name)
        if entry is None:
            raise ResourceNotFound("auth.no_such_user", name=name)
        return entry

    def rights_of(self, name: str) -> frozenset[Right]:
        """Return the rights of a user; none if there is no such user."""
        user = self.find(name)
        return frozenset() if user is None else user.rights

    @property
    def has_administrator(self) -> bool:
        """Whether an administrator can log in. Before that, commands and remote access are refused."""
        return any(_can_administer(user) for user in self.users)

    def with_user(self, user: User) -> UserDatabase:
        """Add a user. Raises InvalidInput for an invalid name, Conflict for one that exists."""
        check_user_name(user.name)
        same = next((other for other in self.users if appearance(other.name) == appearance(user.name)), None)
        if same is not None:
            raise Conflict("auth.name_taken", name=same.name)
        return replace(self, users=(*self.users, user))

    def with_changed_user(self, user: User) -> UserDatabase:
        """Replace the user of the same name. Raises ResourceNotFound; Conflict if no administrator would be left."""
        self.user(user.name)
        return self._with_administrator(
            replace(self, users=tuple(user if other.name == user.name else other for other in self.users))
        )

    def without_user(self, name: str) -> UserDatabase:
        """Remove a user and its tokens and codes. Raises ResourceNotFound; Conflict for the last administrator."""
        removed = self.user(name).name
        return self._with_administrator(
            UserDatabase(
                users=tuple(user for user in self.users if user.name != removed),
                tokens=tuple(token for token in self.tokens if token.user != removed),
                codes=tuple(code for code in self.codes if code.user != removed),
            )
        )

    def with_token(self, token: Token) -> UserDatabase:
        """Add a token.

        Raises ResourceNotFound for its user, InvalidInput for rights that the user lacks or none, for ``operate``
        without ``stop``, and for a name that is blank or has control characters, as it is shown to others. Raises
        Conflict beyond ``MAX_TOKENS_PER_USER``; those that have expired make room.
        """
        if CONTROL_CHARACTERS.search(token.name) or is_blank(token.name):
            raise InvalidInput("auth.bad_label", name=without_control_characters(token.name))
        beyond = set(token.rights) - ROLE_RIGHTS[self.user(token.user).role]
        if beyond or not token.rights:
            raise InvalidInput("auth.beyond_role", rights=tuple(sorted(beyond)))
        if Right.OPERATE in token.rights and Right.STOP not in token.rights:
            raise InvalidInput("auth.operate_without_stop")
        remaining = self.tokens
        if self._token_count(token.user) >= MAX_TOKENS_PER_USER:
            remaining = tuple(
                other for other in remaining if other.user != token.user or other.expires_ms > token.created_ms
            )
        after = replace(self, tokens=(*remaining, token))
        if after._token_count(token.user) > MAX_TOKENS_PER_USER:
            raise Conflict("auth.too_many_tokens", name=token.user, most=MAX_TOKENS_PER_USER)
        return after

    def _token_count(self, user: str) -> int:
        return sum(token.user == user for token in self.tokens)

    def without_token(self, id: str) -> UserDatabase:
        """Remove a token. Raises ResourceNotFound."""
        if all(token.id != id for token in self.tokens):
            raise ResourceNotFound("auth.no_such_token", id=id)
        return replace(self, tokens=tuple(token for token in self.tokens if token.id != id))

    def with_code(self, code: OneTimeCode, now_ms: int) -> UserDatabase:
        """Add a one-time code and remove expired ones. Raises ResourceNotFound for its user."""
        self.user(code.user)
        return replace(self, codes=(*_unexpired(self.codes, now_ms), code))

    def without_code(self, digest: str) -> UserDatabase:
        return replace(self, codes=tuple(code for code in self.codes if code.digest != digest))

    def _with_administrator(self, after: UserDatabase) -> UserDatabase:
        if self.has_administrator and not after.has_administrator:
            raise Conflict("auth.last_administrator")
        return after


def _can_administer(user: User) -> bool:
    return user.role is Role.ADMINISTRATOR and user.password is not None and not user.disabled


def _with_right_to_stop(token: Token) -> Token:
    """Return a token that may stop what it may start: one of an earlier version may have ``operate`` only."""
    if Right.OPERATE not in token.rights or Right.STOP in token.rights:
        return token
    return replace(token, rights=tuple(sorted({*token.rights, Right.STOP})))


def _unexpired(codes: Iterable[OneTimeCode], now_ms: int) -> tuple[OneTimeCode, ...]:
    return tuple(code for code in codes if code.expires_ms > now_ms)


MAX_LOGGED_NAMES = 10
OWN_CHANGE_READ_WITHIN_S = 10.0  # a thread that reads what another one writes here takes no longer
USER_CHANGES = ("log.users_added", "log.users_removed", "log.users_edited")
TOKEN_CHANGES = ("log.tokens_added", "log.tokens_removed", "log.tokens_edited")
LOG = logging.getLogger("drivebus.service")
_USER_DATABASE_ADAPTER = TypeAdapter(UserDatabase)


class UserFile:
    """File of the user database, private to its owner.

    Programs may share it: each change re-reads it under a lock, and what another program changed is used and logged.
    Raises ConfigurationError if it cannot be read or written or has another content: it is never replaced by an empty
    one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._loaded: tuple[tuple[int, int, int] | None, UserDatabase] = None, UserDatabase()
        """State of the file and its content, in one value: another thread reads it while ``change`` runs."""
        self._damage: tuple[tuple[int, int, int], Text] | None = None
        """State of a file with another content, and where its content is wrong: it is not parsed again."""
        self._logged_problem = ""
        """Why the file can't be read now, as it was logged."""
        self._written: deque[tuple[float, UserDatabase]] = deque()
        """Databases that this program wrote in the last seconds, with the time (infinite until it is written):
        another thread may read one before ``change`` returns, or after a later one was written.
        """

    @property
    def is_missing(self) -> bool:
        """Whether there is no file, and none was read before."""
        return self._loaded[0] is None and not os.path.lexists(self.path)

    def read(self) -> UserDatabase:
        """Return the database; the file is read again only if it has changed.

        Raises ConfigurationError until it could be read once.
        """
        try:
            return self._read_if_changed()
        except ConfigurationError as error:
            if self._loaded[0] is None:
                raise
            if (problem := str(error)) != self._logged_problem:
                self._logged_problem = problem
                LOG.error(i18n.preferred_text("log.users_kept", why=error))
            return self._loaded[1]  # a broken edit or a removed file must not prevent a stop

    def _read_if_changed(self, *, always: bool = False) -> UserDatabase:
        known_state, known = self._loaded
        try:
            state = self.path.stat()
        except FileNotFoundError as error:
            if known_state is None:
                return UserDatabase()
            raise self._unusable_error(SystemReason(error)) from error
        except OSError as error:
            raise self._unusable_error(SystemReason(error)) from error
        fingerprint = (state.st_mtime_ns, state.st_size, state.st_ino)
        if fingerprint == known_state and not always:
            return known
        loaded = self._load(fingerprint)
        if known_state is not None and loaded != known and not self._was_written_recently(loaded):
            _log_changes(self.path, known, loaded)
        self._loaded, self._logged_problem = (fingerprint, loaded), ""
        return loaded

    def change(self, change: Callable[[UserDatabase], UserDatabase]) -> UserDatabase:
        """Write the result of ``change`` durably and return it. If ``change`` raises, nothing is written."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            lock_path = self.path.with_suffix(".lock")
            flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            with os.fdopen(os.open(lock_path, flags, PRIVATE_FILE_MODE), "w") as lock:
                flock(lock, LOCK_EX)
                after = change(self._read_if_changed(always=True))
                self._write(after)
                self._loaded = self._loaded[0], after
        except OSError as error:
            raise ConfigurationError(
                "auth.store_unwritten", file=str(self.path), problem=SystemReason(error)
            ) from error
        return after

    def _write(self, database: UserDatabase) -> None:
        """Write a database, which another thread may read before this returns. Raises OSError."""
        under_way = inf, database
        self._written.append(under_way)
        try:
            atomic_write_private(self.path, _USER_DATABASE_ADAPTER.dump_json(database, indent=1))
            self._written.append((time.monotonic(), database))
        finally:
            self._written.remove(under_way)
        while self._written[0][0] < time.monotonic() - OWN_CHANGE_READ_WITHIN_S:
            self._written.popleft()

    def _was_written_recently(self, database: UserDatabase) -> bool:
        earliest = time.monotonic() - OWN_CHANGE_READ_WITHIN_S
        return any(at >= earliest and written == database for at, written in tuple(self._written))

    def _load(self, fingerprint: tuple[int, int, int]) -> UserDatabase:
        if self._damage is not None and self._damage[0] == fingerprint:
            raise self._unusable_error(self._damage[1])
        try:
            database = _USER_DATABASE_ADAPTER.validate_json(read_regular_file(self.path))
        except ValidationError as error:
            self._damage = fingerprint, content_problem(error)
            raise self._unusable_error(self._damage[1]) from None
        except OSError as error:
            raise self._unusable_error(SystemReason(error)) from error
        return replace(database, tokens=tuple(_with_right_to_stop(token) for token in database.tokens))

    def _unusable_error(self, problem: Text | SystemReason) -> ConfigurationError:
        return ConfigurationError("auth.store_unusable", file=str(self.path), problem=problem)


def content_problem(error: ValidationError) -> Text:
    """Return where the content of the file is wrong, without the content: it holds hashes of secrets."""
    place = ".".join(map(str, error.errors(include_input=False, include_url=False)[0]["loc"]))
    return bilingual_text("auth.store_entry", place=place) if place else bilingual_text("auth.store_content")


def _log_changes(path: Path, before: UserDatabase, after: UserDatabase) -> None:
    """Log the users and tokens that another program added, removed or changed."""
    kinds = (
        (USER_CHANGES, {user.name: user for user in before.users}, {user.name: user for user in after.users}),
        (TOKEN_CHANGES, {token.id: token for token in before.tokens}, {token.id: token for token in after.tokens}),
    )
    texts = []
    for keys, old, new in kinds:
        edited = {name for name in old.keys() & new.keys() if old[name] != new[name]}
        for key, names in zip(keys, (new.keys() - old.keys(), old.keys() - new.keys(), edited), strict=True):
            if names:
                shown = [*sorted(names)[:MAX_LOGGED_NAMES], *(["…"] if len(names) > MAX_LOGGED_NAMES else [])]
                texts.append(i18n.preferred_text(key, n=len(names), names=shown))
    if texts:
        changes = i18n.join(texts, "clauses", i18n.preferred())
        LOG.warning(i18n.preferred_text("log.users_changed", file=path, changes=changes))
