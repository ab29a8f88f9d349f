"""Audit trail: who did what and when, with frames and outcome, in a hash chain that shows every later change."""

from drivebus.service.audit.records import AuditEntry
from drivebus.service.audit.trail import AuditTrail

__all__ = ["AuditEntry", "AuditTrail"]
