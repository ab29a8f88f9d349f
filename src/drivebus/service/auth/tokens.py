"""New API tokens of programs."""

from __future__ import annotations

import secrets
from collections.abc import Iterable

from drivebus.service.auth.rights import Right
from drivebus.service.auth.sessions import secret_digest
from drivebus.service.auth.users import Token

DAY_MS = 86_400_000


def new_token(*, name: str, user: str, rights: Iterable[Right], days: int, now_ms: int) -> tuple[str, Token]:
    """Return the secret of a new token, which is stored nowhere, and the token."""
    secret = "dbt_" + secrets.token_urlsafe(32)
    token = Token(
        id=secrets.token_hex(6),
        name=name,
        user=user,
        rights=tuple(sorted(set(rights))),
        digest=secret_digest(secret),
        created_ms=now_ms,
        expires_ms=now_ms + days * DAY_MS,
    )
    return secret, token
