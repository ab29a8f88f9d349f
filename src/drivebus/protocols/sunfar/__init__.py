"""Sunfar protocol of the C320, C300, E300, E350, E500 and E550: two encodings of the same fields.

messages   requests and replies as values; operations, states, response codes, notation
frame      fields to bytes and back
codec      messages to frames and back, strict; effect of a request frame
describe   frames for people
family     the entry of the family registry
"""

from drivebus.protocols.sunfar.codec import SunfarCodec, frame_effect
from drivebus.protocols.sunfar.describe import SunfarDecodeOptions, describe
from drivebus.protocols.sunfar.messages import (
    BROADCAST,
    VOLTAGE_CLASSES,
    MonitorIndexCoding,
    ReadIdentity,
    ReadMonitor,
    ReceivedRequest,
    SunfarControl,
    SunfarOperation,
    SunfarReadParameter,
    SunfarReply,
    SunfarRequest,
    SunfarResponse,
    SunfarState,
    SunfarWriteParameter,
    UnknownItemError,
    error_reply,
    monitor_index,
    monitor_item,
    parameter_name,
)

__all__ = [
    "BROADCAST",
    "VOLTAGE_CLASSES",
    "MonitorIndexCoding",
    "ReadIdentity",
    "ReadMonitor",
    "ReceivedRequest",
    "SunfarCodec",
    "SunfarControl",
    "SunfarDecodeOptions",
    "SunfarOperation",
    "SunfarReadParameter",
    "SunfarReply",
    "SunfarRequest",
    "SunfarResponse",
    "SunfarState",
    "SunfarWriteParameter",
    "UnknownItemError",
    "describe",
    "error_reply",
    "frame_effect",
    "monitor_index",
    "monitor_item",
    "parameter_name",
]
