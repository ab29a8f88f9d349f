"""Passwords in a configuration, hidden where it is shown: an engineer may read the file, not the database."""

from __future__ import annotations

import re
import tomllib
from typing import Any
from urllib.parse import parse_qs, urlsplit

from drivebus.errors import ConfigurationError

HIDDEN = "…"
_PASSWORD_OF_URL = re.compile(r"(postgres(?:ql)?://[^\s:/@]*):\S*@|(//[^\s:/@]*):[^\s/]*@")
_PASSWORD_IN_QUERY = re.compile(r"([?&](?:ssl)?password=)[^\s&\"'#]*")
_SECRET_KEY = re.compile(r"(?:password|passphrase|secret|token)$")
_SECRET_VALUE = re.compile(r"""((?:password|passphrase|secret|token)["']?\s*=\s*)(?:"[^"\n]+"|'[^'\n]+')""")
_SECRET_WORD = re.compile(r"password|passphrase|secret|token", re.IGNORECASE)
_PART_OF_URL = re.compile(r"//|@|\\")  # a backslash may be an escape for one of them
_USER_OF_URL = re.compile(r"//.*@")


def redact_url(url: str) -> str:
    """Return a URL without its password."""
    return _PASSWORD_IN_QUERY.sub(rf"\1{HIDDEN}", _PASSWORD_OF_URL.sub(rf"\1\2:{HIDDEN}@", url))


def redact_text(text: str, source: str) -> str:
    """Return the text of a configuration without passwords.

    Raises ConfigurationError where one is, or in a faulty text may be, written in a form that cannot be hidden.
    """
    redacted_text = redact_url(_SECRET_VALUE.sub(rf'\1"{HIDDEN}"', text))
    try:
        unsafe = _has_password(tomllib.loads(redacted_text))
    except (ValueError, RecursionError):  # a fault of the file, which the user should be able to see
        lines = zip(text.split("\n"), redacted_text.split("\n"), strict=True)
        unsafe = any(_may_show_password(line, redacted) for line, redacted in lines)
    if unsafe:
        raise ConfigurationError("plant.password_in_file", source=source)
    return redacted_text


def restore_url(redacted: str | None, url: str | None) -> str | None:
    """Return ``url`` where ``redacted`` is its redacted form, else ``redacted``.

    For values that are not shown again.
    """
    return url if url is not None and redacted == redact_url(url) else redacted


def _may_show_password(line: str, redacted: str) -> bool:
    """Return whether a line of a faulty text may show a password, or a part of one that several lines hold."""
    comment = redacted.partition("#")[2]
    if _SECRET_WORD.search(comment) or _USER_OF_URL.search(comment):
        return True
    if line.lstrip().startswith("#") or not (_SECRET_WORD.search(line) or _PART_OF_URL.search(line)):
        return False
    try:
        return "\\" in line or _has_password(tomllib.loads(redacted))
    except (ValueError, RecursionError):
        return True


def _has_password(value: Any, key: str = "") -> bool:
    if isinstance(value, dict):
        return any(_has_password(item, name) for name, item in value.items())
    if isinstance(value, list):
        return any(_has_password(item, key) for item in value)
    if not isinstance(value, str):
        return False
    return value not in ("", HIDDEN) and (_SECRET_KEY.search(key) is not None or _url_has_password(value))


def _url_has_password(text: str) -> bool:
    try:
        parts = urlsplit(text)
        query = parse_qs(parts.query)
        passwords = [parts.password, *query.get("password", ()), *query.get("sslpassword", ())]
    except ValueError:
        return "@" in text and "://" in text
    return any(password not in (None, "", HIDDEN) for password in passwords)
