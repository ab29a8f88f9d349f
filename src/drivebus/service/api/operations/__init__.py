"""Operations of the service, each declared once.

The modules hold the declarations by subject, each with its parameters and its result; ``OPERATIONS`` has them all.
"""

from __future__ import annotations

from drivebus.service.api.operations.alarms import ALARM_OPERATIONS, AUDIT_OPERATIONS, INCIDENT_OPERATIONS
from drivebus.service.api.operations.buses import BUS_OPERATIONS
from drivebus.service.api.operations.drives import DRIVE_OPERATIONS
from drivebus.service.api.operations.groups import GROUP_OPERATIONS
from drivebus.service.api.operations.history import HISTORY_OPERATIONS
from drivebus.service.api.operations.operation import API_PREFIX, Audit, Operation, OperationParams
from drivebus.service.api.operations.plant import CONFIGURATION_OPERATIONS, PLANT_OPERATIONS, STOP_OPERATIONS

OPERATIONS: dict[str, Operation] = {
    operation.name: operation
    for operation in (
        *PLANT_OPERATIONS,
        *DRIVE_OPERATIONS,
        *GROUP_OPERATIONS,
        *STOP_OPERATIONS,
        *BUS_OPERATIONS,
        *HISTORY_OPERATIONS,
        *ALARM_OPERATIONS,
        *INCIDENT_OPERATIONS,
        *AUDIT_OPERATIONS,
        *CONFIGURATION_OPERATIONS,
    )
}

__all__ = ["API_PREFIX", "OPERATIONS", "Audit", "Operation", "OperationParams"]
