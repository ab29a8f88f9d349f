"""Which address is which operation of the plant. The rights stand in ``plant.operations``, the handlers are made from
this table: there is no route for an operation that is not in it (S02).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from drivebus.service.api.operations import OPERATIONS, Operation

API_PREFIX = "/api/v1"


@dataclass(frozen=True, slots=True)
class ApiRoute:
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
    def path_params(self) -> tuple[str, ...]:
        """Parameters that stand in the path."""
        return tuple(re.findall(r"{(\w+)}", self.path))

    @property
    def has_body(self) -> bool:
        """Parameters that are not in the path come as JSON, where the method has a body."""
        return self.method in ("POST", "PUT")

    def param_schemas(self) -> dict[str, Any]:
        """Names and schemas of the parameters that are not in the path."""
        found: dict[str, Any] = self.operation.params.model_json_schema().get("properties", {})
        return {name: schema for name, schema in found.items() if name not in self.path_params}

    def required_params(self) -> list[str]:
        """Those of ``fields`` without which nothing is done."""
        needed = self.operation.params.model_json_schema().get("required", [])
        return [name for name in needed if name not in self.path_params]


API_ROUTES = (
    ApiRoute("GET", "/plant", "plant.get"),
    ApiRoute("GET", "/statistics", "plant.statistics"),
    ApiRoute("GET", "/drives", "drives.list"),
    ApiRoute("GET", "/drives/{drive}", "drives.get"),
    ApiRoute("GET", "/drives/{drive}/profile", "drives.profile"),
    ApiRoute("GET", "/drives/{drive}/statistics", "drives.statistics"),
    ApiRoute("POST", "/drives/{drive}/parameters/read", "parameters.read"),
    ApiRoute("POST", "/drives/{drive}/parameters/write", "parameters.write"),
    ApiRoute("POST", "/drives/{drive}/lease", "lease.take"),
    ApiRoute("POST", "/drives/{drive}/lease/renew", "lease.renew"),
    ApiRoute("DELETE", "/drives/{drive}/lease", "lease.release"),
    ApiRoute("POST", "/drives/{drive}/arm", "drive.arm"),
    ApiRoute("POST", "/drives/{drive}/run", "drive.run"),
    ApiRoute("POST", "/drives/{drive}/set-frequency", "drive.set_frequency"),
    ApiRoute("POST", "/drives/{drive}/stop", "drive.stop"),
    ApiRoute("POST", "/drives/{drive}/jog", "drive.jog"),
    ApiRoute("POST", "/drives/{drive}/jog/renew", "drive.jog_renew"),
    ApiRoute("POST", "/drives/{drive}/jog/end", "drive.jog_end"),
    ApiRoute("POST", "/drives/{drive}/reset", "drive.reset"),
    ApiRoute("POST", "/drives/{drive}/release", "drive.release"),
    ApiRoute("POST", "/drives/{drive}/waiver", "drive.waiver"),
    ApiRoute("DELETE", "/drives/{drive}/waiver", "drive.unwaive"),
    ApiRoute("PUT", "/drives/{drive}/limits", "drive.limits"),
    ApiRoute("GET", "/groups", "groups.list"),
    ApiRoute("POST", "/groups/{group}/arm", "group.arm"),
    ApiRoute("POST", "/groups/{group}/start", "group.start"),
    ApiRoute("POST", "/groups/{group}/set-frequency", "group.set_frequency"),
    ApiRoute("POST", "/groups/{group}/stop", "group.stop"),
    ApiRoute("POST", "/stop", "plant.stop"),
    ApiRoute("GET", "/buses", "buses.list"),
    ApiRoute("GET", "/buses/{bus}", "buses.get"),
    ApiRoute("GET", "/buses/{bus}/frames", "buses.frames"),
    ApiRoute("GET", "/history/tags", "history.tags"),
    ApiRoute("GET", "/history/trend", "history.trend"),
    ApiRoute("GET", "/history/export", "history.export"),
    ApiRoute("GET", "/history/markers", "history.markers"),
    ApiRoute("GET", "/alarms", "alarms.list"),
    ApiRoute("GET", "/alarms/history", "alarms.history"),
    ApiRoute("POST", "/alarms/{alarm}/acknowledge", "alarm.acknowledge"),
    ApiRoute("POST", "/alarms/{alarm}/shelve", "alarm.shelve"),
    ApiRoute("POST", "/alarms/{alarm}/unshelve", "alarm.unshelve"),
    ApiRoute("GET", "/cases", "cases.list"),
    ApiRoute("GET", "/cases/{case}", "cases.get"),
    ApiRoute("GET", "/audit", "audit.list"),
    ApiRoute("GET", "/audit/verify", "audit.verify"),
    ApiRoute("GET", "/configuration", "configuration.get"),
    ApiRoute("POST", "/configuration/check", "configuration.check"),
    ApiRoute("POST", "/configuration/reload", "configuration.reload"),
)
