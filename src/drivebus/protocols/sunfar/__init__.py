"""C320 and its sisters: two encodings of the same fields (manual section 2.3 ff.). Sans-IO.

tables     operations, states, response codes, notation
messages   requests and replies as values
frame      fields to bytes and back
codec      requests and replies to frames and back: strict, against the request
effect     what a frame does to the drive, from its bytes
explain    what a frame says, for people
"""

from drivebus.protocols.sunfar.classify import classify_frame
from drivebus.protocols.sunfar.codec import SunfarCodec
from drivebus.protocols.sunfar.describe import describe
from drivebus.protocols.sunfar.messages import (
    ReadIdentity,
    ReadMonitor,
    ReceivedRequest,
    SunfarControl,
    SunfarReadParameter,
    SunfarReply,
    SunfarRequest,
    SunfarWriteParameter,
    UnknownItemError,
    error_reply,
)
from drivebus.protocols.sunfar.tables import (
    BROADCAST,
    SunfarOperation,
    SunfarResponse,
    SunfarState,
    monitor_index,
    monitor_item,
    parameter_name,
    parse_parameter,
)
from drivebus.protocols.sunfar.tolerant import SunfarDecodeOptions

__all__ = [
    "BROADCAST",
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
    "classify_frame",
    "describe",
    "error_reply",
    "monitor_index",
    "monitor_item",
    "parameter_name",
    "parse_parameter",
]
