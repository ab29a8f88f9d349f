"""New API tokens: a random secret that is stored nowhere, and a token with an end."""

from __future__ import annotations

import re

from drivebus.service.auth.rights import Right
from drivebus.service.auth.sessions import secret_digest
from drivebus.service.auth.tokens import new_token
from drivebus.service.auth.users import Token


def test_a_new_token_has_its_rights_once_ends_after_its_days_and_stores_a_digest_of_its_secret() -> None:
    rights = [Right.VIEW, Right.STOP, Right.VIEW]
    secret, token = new_token(name="scada", user="ann", rights=rights, days=30, now_ms=1_000)
    assert re.fullmatch(r"dbt_[\w-]{43}", secret), "256 random bits"
    assert re.fullmatch("[0-9a-f]{12}", token.id)
    assert token == Token(
        id=token.id,
        name="scada",
        user="ann",
        rights=tuple(sorted({Right.VIEW, Right.STOP})),
        digest=secret_digest(secret),
        created_ms=1_000,
        expires_ms=1_000 + 30 * 24 * 3600 * 1000,
    )
    other_secret, other = new_token(name="scada", user="ann", rights=rights, days=30, now_ms=1_000)
    assert secret != other_secret and token.id != other.id
