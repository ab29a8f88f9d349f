"""C320 and its sisters: two encodings of the same fields (manual section 2.3 ff.). Sans-IO.

tables     operations, states, response codes, notation
messages   requests and replies as values
frame      fields to bytes and back
codec      requests and replies to frames and back: strict, against the request
effect     what a frame does to the drive, from its bytes
explain    what a frame says, for people
"""

from drivebus.protocols.sifang.codec import SifangCodec
from drivebus.protocols.sifang.effect import effect
from drivebus.protocols.sifang.explain import describe
from drivebus.protocols.sifang.messages import (
    Control,
    Heard,
    ItemError,
    ReadIdentity,
    ReadMonitor,
    ReadParameter,
    Reply,
    Request,
    WriteParameter,
    short_reply,
)
from drivebus.protocols.sifang.tables import (
    BROADCAST,
    Operation,
    Response,
    State,
    monitor_index,
    monitor_item,
    parameter_name,
    parse_parameter,
)
from drivebus.protocols.sifang.tolerant import Meaning

__all__ = [
    "BROADCAST",
    "Control",
    "Heard",
    "ItemError",
    "Meaning",
    "Operation",
    "ReadIdentity",
    "ReadMonitor",
    "ReadParameter",
    "Reply",
    "Request",
    "Response",
    "SifangCodec",
    "State",
    "WriteParameter",
    "describe",
    "effect",
    "monitor_index",
    "monitor_item",
    "parameter_name",
    "parse_parameter",
    "short_reply",
]
