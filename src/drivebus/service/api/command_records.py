"""Records of commands in the audit trail of a plant, with an alarm while they cannot be written."""

from __future__ import annotations

import logging

from drivebus import i18n
from drivebus.errors import AuditUnavailable
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import failure_reason
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.chain import AUDIT_FILE
from drivebus.service.runtime.plant import Plant

LOG = logging.getLogger("drivebus.service")


async def record(plant: Plant, entry: AuditEntry) -> int:
    """Write an entry and return its number. Raises AuditUnavailable, with an alarm until one is written."""
    try:
        number = await plant.audit.record(entry)
    except AuditUnavailable as error:
        plant.raise_alarm(SystemAlarm.AUDIT_FAILURE, subject=AUDIT_FILE, reason=failure_reason(error))
        raise
    plant.clear_alarm(SystemAlarm.AUDIT_FAILURE, subject=AUDIT_FILE)
    return number


async def record_or_queue(plant: Plant, entry: AuditEntry) -> int | None:
    """Write an entry and return its number; None where the trail fails: it is written when the trail works again."""
    try:
        return await record(plant, entry)
    except AuditUnavailable:
        plant.audit.record_nowait(entry)
    except Exception:  # no reason to lose the record that follows, too
        LOG.exception(i18n.preferred_text("log.record_failed"))
    return None
