"""The audit trail: who did what, when, with which frames and outcome, in a chain that shows every later change."""

from drivebus.service.audit.records import AuditEntry
from drivebus.service.audit.trail import AuditTrail

__all__ = ["AuditEntry", "AuditTrail"]
