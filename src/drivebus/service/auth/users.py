"""Who may come in: users, tokens and one-time codes as values. Secrets are kept as hashes only (S07)."""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, replace

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
