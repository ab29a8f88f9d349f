"""Which address is which operation of the plant. The rights stand in ``plant.operations``, the handlers are made from
this table: there is no route for an operation that is not in it (S02).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from drivebus.plant.operations import OPERATIONS, Operation

PREFIX = "/api/v1"


@dataclass(frozen=True, slots=True)
class Route:
    """One method of one path."""

    method: str
    path: str
    """Under ``PREFIX``; a name in braces is the parameter of that name."""
    name: str
    """Of the operation."""

    @property
    def operation(self) -> Operation:
        return OPERATIONS[self.name]

    @property
    def places(self) -> tuple[str, ...]:
        """Parameters that stand in the path."""
        return tuple(re.findall(r"{(\w+)}", self.path))

    @property
    def has_body(self) -> bool:
        """Parameters that are not in the path come as JSON, where the method has a body."""
        return self.method in ("POST", "PUT")

    def fields(self) -> dict[str, Any]:
        """Names and schemas of the parameters that are not in the path."""
        found: dict[str, Any] = self.operation.params.model_json_schema().get("properties", {})
        return {name: schema for name, schema in found.items() if name not in self.places}

    def required(self) -> list[str]:
        """Those of ``fields`` without which nothing is done."""
        needed = self.operation.params.model_json_schema().get("required", [])
        return [name for name in needed if name not in self.places]


ROUTES = (
    Route("GET", "/plant", "plant.get"),
    Route("GET", "/statistics", "plant.statistics"),
    Route("GET", "/drives", "drives.list"),
    Route("GET", "/drives/{drive}", "drives.get"),
    Route("GET", "/drives/{drive}/profile", "drives.profile"),
    Route("GET", "/drives/{drive}/statistics", "drives.statistics"),
    Route("POST", "/drives/{drive}/parameters/read", "parameters.read"),
    Route("POST", "/drives/{drive}/parameters/write", "parameters.write"),
    Route("POST", "/drives/{drive}/lease", "lease.take"),
    Route("POST", "/drives/{drive}/lease/renew", "lease.renew"),
    Route("DELETE", "/drives/{drive}/lease", "lease.release"),
    Route("POST", "/drives/{drive}/arm", "drive.arm"),
    Route("POST", "/drives/{drive}/run", "drive.run"),
    Route("POST", "/drives/{drive}/set-frequency", "drive.set_frequency"),
    Route("POST", "/drives/{drive}/stop", "drive.stop"),
    Route("POST", "/drives/{drive}/jog", "drive.jog"),
    Route("POST", "/drives/{drive}/jog/renew", "drive.jog_renew"),
    Route("POST", "/drives/{drive}/jog/end", "drive.jog_end"),
    Route("POST", "/drives/{drive}/reset", "drive.reset"),
    Route("POST", "/drives/{drive}/release", "drive.release"),
    Route("POST", "/drives/{drive}/waiver", "drive.waiver"),
    Route("DELETE", "/drives/{drive}/waiver", "drive.unwaive"),
    Route("PUT", "/drives/{drive}/limits", "drive.limits"),
    Route("GET", "/groups", "groups.list"),
    Route("POST", "/groups/{group}/arm", "group.arm"),
    Route("POST", "/groups/{group}/start", "group.start"),
    Route("POST", "/groups/{group}/set-frequency", "group.set_frequency"),
    Route("POST", "/groups/{group}/stop", "group.stop"),
    Route("POST", "/stop", "plant.stop"),
    Route("GET", "/buses", "buses.list"),
    Route("GET", "/buses/{bus}", "buses.get"),
    Route("GET", "/buses/{bus}/frames", "buses.frames"),
    Route("GET", "/history/tags", "history.tags"),
    Route("GET", "/history/trend", "history.trend"),
    Route("GET", "/history/export", "history.export"),
    Route("GET", "/history/markers", "history.markers"),
    Route("GET", "/alarms", "alarms.list"),
    Route("GET", "/alarms/history", "alarms.history"),
    Route("POST", "/alarms/{alarm}/acknowledge", "alarm.acknowledge"),
    Route("POST", "/alarms/{alarm}/shelve", "alarm.shelve"),
    Route("POST", "/alarms/{alarm}/unshelve", "alarm.unshelve"),
    Route("GET", "/cases", "cases.list"),
    Route("GET", "/cases/{case}", "cases.get"),
    Route("GET", "/audit", "audit.list"),
    Route("GET", "/audit/verify", "audit.verify"),
    Route("GET", "/configuration", "configuration.get"),
    Route("POST", "/configuration/check", "configuration.check"),
    Route("POST", "/configuration/reload", "configuration.reload"),
)
