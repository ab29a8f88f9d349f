"""Opaque cursors of several whole numbers."""

from __future__ import annotations

from base64 import urlsafe_b64decode, urlsafe_b64encode

from drivebus.errors import InvalidParameters
from drivebus.service.api.param_errors import param_fault


def encode_cursor(*numbers: int) -> str:
    return urlsafe_b64encode(".".join(map(str, numbers)).encode()).decode()


def decode_cursor(text: str, count: int) -> list[int]:
    """Return the ``count`` numbers of a cursor. Raises InvalidParameters."""
    try:
        numbers = [int(part) for part in urlsafe_b64decode(text.encode()).decode().split(".")]
        if len(numbers) == count and min(numbers) >= 0 and encode_cursor(*numbers) == text:
            return numbers
    except ValueError:
        pass
    raise InvalidParameters("plant.params", faults=[param_fault("cursor", text[:60], "cursor")])
