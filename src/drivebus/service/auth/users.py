"""Who may come in: users, tokens and one-time codes as values. Secrets are kept as hashes only (S07).

``access.json``: the register in a file that only its owner reads (0600), replaced as a whole.
"""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import IO

from pydantic import TypeAdapter, ValidationError

from drivebus import atomic_write
from drivebus.errors import ConfigurationError
from drivebus.service.auth.errors import Conflict, InvalidInput, ResourceNotFound
from drivebus.service.auth.rights import ROLE_RIGHTS, Right, Role

_USER_NAME = re.compile(r"[^\W_][\w.@-]{0,63}")


@dataclass(frozen=True, slots=True)
class User:
    """A person."""

    name: str
    role: Role
    password: str | None
    """argon2's own text; None: can't log in by password."""
    created_ms: int
    disabled: bool = False

    @property
    def rights(self) -> frozenset[Right]:
        return frozenset() if self.disabled else ROLE_RIGHTS[self.role]

    @property
    def stamp(self) -> str:
        """Whatever of this changes ends the user's sessions (S04: role loss)."""
        said = f"{self.role} {self.password} {self.disabled} {self.created_ms}"
        return hashlib.sha256(said.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Token:
    """A program's key, of one user: never more than that user may."""

    id: str
    name: str
    user: str
    rights: tuple[Right, ...]
    digest: str
    created_ms: int
    expires_ms: int


@dataclass(frozen=True, slots=True)
class OneTimeCode:
    """A code that logs a user in, once."""

    digest: str
    user: str
    expires_ms: int


@dataclass(frozen=True, slots=True)
class UserDatabase:
    """All of them. Every change gives a new one."""

    users: tuple[User, ...] = ()
    tokens: tuple[Token, ...] = ()
    codes: tuple[OneTimeCode, ...] = ()

    def find(self, name: str) -> User | None:
        """By the name as somebody typed it."""
        wanted = normalized_name(name)
        return next((user for user in self.users if user.name == wanted), None)

    def user(self, name: str) -> User:
        """Raises ResourceNotFound."""
        found = self.find(name)
        if found is None:
            raise ResourceNotFound("access.no_such_user", name=name)
        return found

    def rights_of(self, name: str) -> frozenset[Right]:
        """None at all for somebody who is not there."""
        found = self.find(name)
        return frozenset() if found is None else found.rights

    @property
    def has_administrator(self) -> bool:
        """One who can log in: commands and addresses beyond this machine wait for that (S06, S15)."""
        return any(_can_administer(user) for user in self.users)

    def with_user(self, user: User) -> UserDatabase:
        """Raises Unfit for a name that can't be one, Conflict where it is taken."""
        if not _USER_NAME.fullmatch(user.name) or user.name != normalized_name(user.name):
            raise InvalidInput("access.bad_name", name=user.name)
        if self.find(user.name) is not None:
            raise Conflict("access.name_taken", name=user.name)
        return replace(self, users=(*self.users, user))

    def with_changed_user(self, user: User) -> UserDatabase:
        """Replace a user. Raises ResourceNotFound; Conflict where no administrator would remain."""
        self.user(user.name)
        return self._with_administrator(
            replace(self, users=tuple(user if one.name == user.name else one for one in self.users))
        )

    def without_user(self, name: str) -> UserDatabase:
        """Without the user and all that was the user's. Raises ResourceNotFound, Conflict."""
        gone = self.user(name).name
        return self._with_administrator(
            UserDatabase(
                tuple(user for user in self.users if user.name != gone),
                tuple(token for token in self.tokens if token.user != gone),
                tuple(code for code in self.codes if code.user != gone),
            )
        )

    def with_token(self, token: Token) -> UserDatabase:
        """Raises ResourceNotFound for its user, Unfit where the user may not all of it."""
        beyond = set(token.rights) - ROLE_RIGHTS[self.user(token.user).role]
        if beyond or not token.rights:
            raise InvalidInput("access.beyond_role", rights=", ".join(sorted(beyond)))
        return replace(self, tokens=(*self.tokens, token))

    def without_token(self, id: str) -> UserDatabase:
        """Raises ResourceNotFound."""
        if all(token.id != id for token in self.tokens):
            raise ResourceNotFound("access.no_such_token", id=id)
        return replace(self, tokens=tuple(token for token in self.tokens if token.id != id))

    def with_code(self, code: OneTimeCode, now_ms: int) -> UserDatabase:
        """Raises ResourceNotFound for its user. Codes that are too old go."""
        self.user(code.user)
        return replace(self, codes=(*_unexpired(self.codes, now_ms), code))

    def without_code(self, digest: str) -> UserDatabase:
        return replace(self, codes=tuple(code for code in self.codes if code.digest != digest))

    def _with_administrator(self, after: UserDatabase) -> UserDatabase:
        if self.has_administrator and not after.has_administrator:
            raise Conflict("access.last_administrator")
        return after


def normalized_name(name: str) -> str:
    """One spelling for names that look alike (NFKC, case folded)."""
    return unicodedata.normalize("NFKC", name).casefold()


def _can_administer(user: User) -> bool:
    return user.role is Role.ADMINISTRATOR and user.password is not None and not user.disabled


def _unexpired(codes: Iterable[OneTimeCode], now_ms: int) -> tuple[OneTimeCode, ...]:
    return tuple(code for code in codes if code.expires_ms > now_ms)


_USER_DATABASE_ADAPTER = TypeAdapter(UserDatabase)
_PRIVATE_MODE = 0o600


class UserFile:
    """The register; several programs may use one file: each change reads it again under a lock.

    Raises ConfigurationError where it can't be read or written, or is none of ours: nobody starts from nothing. Whoever
    has read it once goes on with what it said then: a slip of an editor takes nobody's stop away.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file_state: tuple[int, int, int] | None = None
        self._database = UserDatabase()

    def read(self) -> UserDatabase:
        """What the file says now; read again only where it changed."""
        try:
            return self._read_if_changed()
        except ConfigurationError:
            if self._file_state is None:
                raise
            return self._database

    def _read_if_changed(self) -> UserDatabase:
        try:
            state = self.path.stat()
        except FileNotFoundError:
            return UserDatabase()
        except OSError as error:
            raise self._unusable_error(str(error)) from error
        seen = (state.st_mtime_ns, state.st_size, state.st_ino)
        if seen != self._file_state:
            self._database, self._file_state = self._load(), seen
        return self._database

    def change(self, change: Callable[[UserDatabase], UserDatabase]) -> UserDatabase:
        """Put what ``change`` makes of it; durable on return. Where ``change`` raises, nothing is put."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with os.fdopen(_open_private(self.path.with_suffix(".lock")), "w") as lock:
                flock(lock, LOCK_EX)
                after = change(self._read_if_changed())
                replace_private(self.path, _USER_DATABASE_ADAPTER.dump_json(after, indent=1))
        except OSError as error:
            raise self._unusable_error(error.strerror or str(error)) from error
        return after

    def _load(self) -> UserDatabase:
        try:
            return _USER_DATABASE_ADAPTER.validate_json(self.path.read_bytes())
        except (OSError, ValidationError) as error:
            raise self._unusable_error(str(error)) from error

    def _unusable_error(self, problem: str) -> ConfigurationError:
        return ConfigurationError("access.store_unusable", file=str(self.path), problem=problem)


def replace_private(path: Path, content: bytes) -> None:
    """Old or new, never half, never readable by others; durable on return."""
    atomic_write.atomic_write(path, content, _create_private)


def _create_private(part: Path) -> IO[bytes]:
    """A file of nobody else's making."""
    part.unlink(missing_ok=True)
    return os.fdopen(_open_private(part, os.O_EXCL), "wb")


def _open_private(path: Path, more: int = 0) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | more, _PRIVATE_MODE)
