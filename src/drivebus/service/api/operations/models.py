"""Operations on the models that drivebus knows, whether or not the plant has such drives."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivebus.service.api.operations.operation import ApiObject, Name, NoParams, Operation, OperationParams
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class ModelParams(OperationParams):
    """Model that is described."""

    model: Annotated[Name, Field(examples=["vc660"])]


class ModelsResponse(ApiObject):
    """Every model by name, with maker, family, encodings, factory settings, addresses, grade and capabilities."""

    models: list[dict[str, Any]]


MODELS_LIST = Operation(
    name="models.list",
    right=Right.VIEW,
    method="GET",
    path="/models",
    params=NoParams,
    response=ModelsResponse,
    summary=Text("Every model that drivebus knows", "drivebus 支持的全部型号"),
)

MODELS_GET = Operation(
    name="models.get",
    right=Right.VIEW,
    method="GET",
    path="/models/{model}",
    params=ModelParams,
    summary=Text(
        "Profile of a model: signals, parameters, faults, caveats", "某型号的型号文件：信号、参数、故障、注意事项"
    ),
)
