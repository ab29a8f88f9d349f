"""Device cookies: recognize a browser in which a user has logged in before.

Attempts of such a browser are counted on their own, so that wrong attempts of others never delay its user ("Slow Down
Online Guessing Attacks with Device Cookies", OWASP). A device cookie gives no right and replaces no password.
"""

from __future__ import annotations

import contextlib
import hmac
import re
import secrets
from hashlib import sha256
from pathlib import Path

from drivebus.atomic_write import atomic_write_private
from drivebus.regular_file import read_regular_file
from drivebus.service.auth.names import normalized_name

DEVICE_KEY_FILE = "device.key"
_KEY_BYTES = 32
_COOKIE = re.compile(r"[\w-]{22}\.[0-9a-f]{64}", re.ASCII)


class DeviceCookies:
    """Issues and recognizes device cookies. Their key is ``device.key`` in the state directory (0600)."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / DEVICE_KEY_FILE
        self._key = b""

    def issue(self, user: str, previous: str = "") -> str:
        """Return the cookie of a browser in which ``user`` has just logged in; a valid ``previous`` one stays."""
        if self.device(user, previous):
            return previous
        device = secrets.token_urlsafe(16)
        return f"{device}.{self._mac(user, device)}"

    def device(self, user: str, cookie: str) -> str:
        """Return the id of the device if the cookie was issued for this user, else ``""``."""
        device, _, mac = cookie.partition(".")
        valid = _COOKIE.fullmatch(cookie) and hmac.compare_digest(mac, self._mac(user, device))
        return device if valid else ""

    def _mac(self, user: str, device: str) -> str:
        message = f"{device} {normalized_name(user)}".encode("utf-8", "surrogatepass")
        return hmac.new(self._load_key(), message, sha256).hexdigest()

    def _load_key(self) -> bytes:
        """Return the key; make a new one if there is none. One that cannot be saved lasts as long as this process."""
        if not self._key:
            with contextlib.suppress(OSError):
                self._key = read_regular_file(self.path)
        if len(self._key) != _KEY_BYTES:
            self._key = secrets.token_bytes(_KEY_BYTES)
            with contextlib.suppress(OSError):
                atomic_write_private(self.path, self._key)
        return self._key


def device_cookie_name(user: str) -> str:
    """Return the name of a user's device cookie: several users may share a browser."""
    return "drivebus_device_" + sha256(normalized_name(user).encode("utf-8", "surrogatepass")).hexdigest()[:16]
