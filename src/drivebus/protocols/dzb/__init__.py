"""The DZB100's 11-byte frames (manual section 2 and 3). Sans-IO.

messages   requests and replies as values
values     what a word of data may mean: codings, the state word
codec      frames from messages and back; the effect of a frame
explain    what a frame says, for people
"""

from drivebus.protocols.dzb.codec import DzbCodec, effect
from drivebus.protocols.dzb.explain import Meaning, coding_key, describe
from drivebus.protocols.dzb.messages import (
    BROADCAST,
    LAST_PARAMETER,
    Command,
    Control,
    Query,
    ReadParameter,
    Reply,
    Request,
    WriteParameter,
)
from drivebus.protocols.dzb.values import (
    FREQUENCY_CODINGS,
    FaultCoding,
    FrequencyCoding,
    StateWord,
    decode_frequency,
    encode_frequency,
)

__all__ = [
    "BROADCAST",
    "FREQUENCY_CODINGS",
    "LAST_PARAMETER",
    "Command",
    "Control",
    "DzbCodec",
    "FaultCoding",
    "FrequencyCoding",
    "Meaning",
    "Query",
    "ReadParameter",
    "Reply",
    "Request",
    "StateWord",
    "WriteParameter",
    "coding_key",
    "decode_frequency",
    "describe",
    "effect",
    "encode_frequency",
]
