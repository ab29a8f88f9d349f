"""Operations that describe the gateway and the plant to programs: health, OpenAPI, metrics."""

from __future__ import annotations

from pydantic import Field

from drivebus.service.api.operations import Operation
from drivebus.service.api.operations.operation import ApiObject
from drivebus.service.auth.rights import AccessLevel, Right
from drivebus.types import Json
from drivebus.values import Text


class HealthResponse(ApiObject):
    """Answer of the gateway.

    Drives are stopped where files can't be written too, and started while the audit trail can be written.
    """

    ok: bool = Field(description="false, with status 503, where the service does not answer within 2 s")
    write_failure_count: int = Field(
        default=0, description="number of files that the service can't write at present, the history included"
    )
    write_failures: list[str] = Field(
        default=[],
        description="their names as in the state of the plant, only in the answer to a credential with the right view",
    )


class OpenApiResponse(ApiObject):
    """Description in OpenAPI 3.1, whose own specification describes the parts."""

    openapi: str
    info: Json
    paths: Json
    components: Json


HEALTH_GET = Operation(
    name="health.get",
    right=AccessLevel.PUBLIC,
    method="GET",
    path="/health",
    response=HealthResponse,
    summary=Text("Whether the web gateway and the service answer, else 503", "网页网关和服务是否应答，否则为 503"),
)

OPENAPI_GET = Operation(
    name="openapi.get",
    right=Right.VIEW,
    method="GET",
    path="/openapi.json",
    response=OpenApiResponse,
    summary=Text("Description of this API in OpenAPI", "本 API 的 OpenAPI 描述"),
)

METRICS_GET = Operation(
    name="metrics.get",
    right=Right.VIEW,
    method="GET",
    prefix="",
    path="/metrics",
    media_types=("text/plain", "application/openmetrics-text"),
    summary=Text("Metrics for Prometheus", "供 Prometheus 采集的指标"),
)
