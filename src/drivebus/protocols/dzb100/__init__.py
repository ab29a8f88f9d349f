"""DZB100 protocol: frames of 11 bytes (manual sections 2 and 3).

messages   requests and replies as values; state word, frequency codings
codec      messages to frames and back, strict; effect of a request frame
describe   frames for people
family     the ``ProtocolFamily`` object
"""

from drivebus.protocols.dzb100.codec import Dzb100Codec, frame_effect
from drivebus.protocols.dzb100.describe import Dzb100DecodeOptions, coding_key, describe
from drivebus.protocols.dzb100.messages import (
    BROADCAST,
    FREQUENCY_CODINGS,
    LAST_PARAMETER,
    Dzb100Command,
    Dzb100Control,
    Dzb100Query,
    Dzb100ReadParameter,
    Dzb100Reply,
    Dzb100Request,
    Dzb100WriteParameter,
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
    "Dzb100Codec",
    "Dzb100Command",
    "Dzb100Control",
    "Dzb100DecodeOptions",
    "Dzb100Query",
    "Dzb100ReadParameter",
    "Dzb100Reply",
    "Dzb100Request",
    "Dzb100WriteParameter",
    "FaultCoding",
    "FrequencyCoding",
    "StateWord",
    "coding_key",
    "decode_frequency",
    "describe",
    "encode_frequency",
    "frame_effect",
]
