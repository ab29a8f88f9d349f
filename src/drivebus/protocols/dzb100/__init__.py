"""The DZB100's 11-byte frames (manual section 2 and 3). Sans-IO.

messages   requests and replies as values
values     what a word of data may mean: codings, the state word
codec      frames from messages and back; the effect of a frame
explain    what a frame says, for people
"""

from drivebus.protocols.dzb100.codec import Dzb100Codec, classify_frame
from drivebus.protocols.dzb100.describe import Dzb100DecodeOptions, coding_key, describe
from drivebus.protocols.dzb100.messages import (
    BROADCAST,
    LAST_PARAMETER,
    Dzb100Command,
    Dzb100Control,
    Dzb100Query,
    Dzb100ReadParameter,
    Dzb100Reply,
    Dzb100Request,
    Dzb100WriteParameter,
)
from drivebus.protocols.dzb100.values import (
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
    "classify_frame",
    "coding_key",
    "decode_frequency",
    "describe",
    "encode_frequency",
]
