"""Operations of the service, each declared once.

The modules hold the declarations by subject, each with its parameters and its result; ``OPERATIONS`` has them all.
"""

from __future__ import annotations

from drivebus.service.api.operations import (
    alarms,
    audit,
    buses,
    comm_loss,
    control,
    drives,
    groups,
    history,
    incidents,
    models,
    plant,
    selections,
)
from drivebus.service.api.operations.operation import (
    API_PREFIX,
    Audit,
    Operation,
    OperationParams,
    collect_operations,
)

OPERATIONS: dict[str, Operation] = collect_operations(
    plant, drives, control, comm_loss, selections, groups, buses, history, alarms, incidents, audit, models
)
"""Every operation of the service by name."""

__all__ = ["API_PREFIX", "OPERATIONS", "Audit", "Operation", "OperationParams", "collect_operations"]
