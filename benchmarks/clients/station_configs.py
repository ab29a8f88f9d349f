"""Station configuration of the measured clients: plain Modbus RTU, reads only."""

from __future__ import annotations

from drivebus.bus.messages import StationConfig
from drivebus.protocols.codec import Effect
from drivebus.protocols.modbus import Diagnostics, ModbusRtuCodec
from drivebus.serial_settings import StationTiming


def station_config(address: int, codec: ModbusRtuCodec, delay_s: float) -> StationConfig:
    """Return the configuration of one station; a reply may take ``delay_s`` plus 5 ms before the timeout."""
    timing = StationTiming(
        gap_characters=3.5,
        reply_delay_s=delay_s + 0.005,
        adapter_latency_s=0.01,
        max_reply_lateness_s=0.2,
    )
    return StationConfig(
        address=address,
        codec=codec,
        timing=timing,
        effect_of=lambda frame: Effect.NONE,
        sync_request=lambda n: Diagnostics(address, n & 0xFFFF),
    )
