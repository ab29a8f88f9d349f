"""The DZB100 family: frames of eleven bytes without a check value."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from drivebus.protocols.dzb100.codec import Dzb100Codec
from drivebus.protocols.dzb100.messages import BROADCAST, LAST_ADDRESS, LAST_QUERY_ITEM
from drivebus.protocols.family import Locator, NotationStyle, ProtocolFamily

_QUERY = re.compile(r"Q([0-9]{1,2})", re.ASCII)
_NUMBER = re.compile(r"[0-9]{1,5}", re.ASCII)


def _parse(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Return parameter 10 for ``10``, query 1 for ``Q01``; None for another notation."""
    query = _QUERY.fullmatch(text)
    if query:
        return ("query", int(query[1])) if int(query[1]) <= LAST_QUERY_ITEM else None
    return ("parameter", int(text)) if _NUMBER.fullmatch(text) and int(text) <= highest else None


def _format(locator: Locator, highest: int) -> str:
    space, index = locator
    return f"Q{index:02d}" if space == "query" else f"{index:02d}"


FAMILY: Final = ProtocolFamily(
    name="dzb100",
    codecs={"ascii": Dzb100Codec},
    addresses=(1, LAST_ADDRESS),
    broadcast=BROADCAST,
    gap_characters=0.0,  # not published
    max_error_rate=0.001,  # nothing on the wire detects a flipped bit
    jog_frequency="command",
    notations={"dzb100": NotationStyle(examples=("10 (00-80)", "Q01 (Q00-Q03)"), parse=_parse, format=_format)},
    describe="drivebus.commissioning.decode.dzb100:describe",
    dialect="drivebus.drives.dialects.dzb100:Dzb100Dialect",
    calibrations="drivebus.drives.operations.dzb100_calibration:STEPS",
    scale_option="setpoint_coding",
    simulated_models=("drivebus.simulator.models.dzb100:MODELS",),
    scan_models=("dzb100",),
)
