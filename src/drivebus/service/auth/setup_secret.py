"""``SetupSecret``: authorization of the first administrator."""

from __future__ import annotations

import contextlib
import hmac
import secrets
from pathlib import Path

from drivebus.atomic_write import atomic_write_private

SETUP_SECRET_FILE = "setup-secret"


class SetupSecret:
    """Secret, valid once, that authorizes the creation of the first administrator. There is no default password.

    It is in ``<directory>/setup-secret`` (0600) until it is used, and in memory for the comparison.
    """

    def __init__(self, directory: Path) -> None:
        self.path = directory / SETUP_SECRET_FILE
        self.file_error: OSError | None = None
        """Why the file could not be written."""
        self._secret: str | None = None

    def issue(self) -> str:
        """Return the secret; create it and its file on the first call."""
        if self._secret is None:
            self._secret = secrets.token_urlsafe(16)
            try:
                atomic_write_private(self.path, self._secret.encode() + b"\n")
            except OSError as error:  # a disk that cannot be written: the secret is printed too
                self.file_error = error
        return self._secret

    def verify(self, secret: str) -> bool:
        if self._secret is None:
            return False
        return hmac.compare_digest(secret.encode("utf-8", "surrogatepass"), self._secret.encode())

    def consume(self) -> None:
        """Invalidate the secret and delete its file."""
        self._secret = None
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
