"""Log of unexpected errors of the supervision: one drive or step that fails keeps nothing from the others."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from drivebus import i18n

LOG = logging.getLogger("drivebus.service")


@contextmanager
def failure_logged() -> Iterator[None]:
    """Log an unexpected error of the block, and go on after the block."""
    try:
        yield
    except Exception:
        LOG.exception(i18n.preferred_text("log.supervision_failed"))
