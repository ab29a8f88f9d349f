"""The one-time set-up secret: shown locally where there is no administrator yet; there is no default password (S06)."""

from __future__ import annotations

import hmac
import secrets
from pathlib import Path

from drivebus.service.auth.user_file import replace_private

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
