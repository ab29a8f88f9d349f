"""The audit trail: who did what, when, with which frames and outcome, in a chain that shows every later change."""

from drivebus.plant.audit.entry import Entry
from drivebus.plant.audit.trail import AuditTrail

__all__ = ["AuditTrail", "Entry"]
