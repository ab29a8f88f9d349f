"""The one-time set-up secret: shown locally where there is no administrator yet; there is no default password (S06)."""

from __future__ import annotations

import hmac
import secrets
from pathlib import Path

from drivebus.plant.access.store import replace_private

FILE = "setup-secret"


class SetUp:
    """The secret, in ``<directory>/setup-secret`` (0600) while it is needed, in memory for the comparison."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE
        self._secret: str | None = None

    def offer(self) -> str:
        """Make a secret and write its file; the same one while this process lives and it is not used."""
        if self._secret is None:
            self._secret = secrets.token_urlsafe(16)
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            replace_private(self.path, self._secret.encode() + b"\n")
        return self._secret

    def fits(self, given: str) -> bool:
        if self._secret is None:
            return False
        return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), self._secret.encode())

    def used(self) -> None:
        """There is an administrator now."""
        self._secret = None
        self.path.unlink(missing_ok=True)
