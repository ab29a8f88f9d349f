"""Every codec that a campaign tries, in all its variants, each with its judge and with who makes lawful talk for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random
from typing import Any

from drivebus.lab.codecs import talk
from drivebus.lab.codecs.judges.dzb import DzbJudge
from drivebus.lab.codecs.judges.forms import Form
from drivebus.lab.codecs.judges.modbus import ModbusJudge
from drivebus.lab.codecs.judges.sifang import SifangJudge
from drivebus.lab.codecs.talk import Exchange
from drivebus.message import Codec
from drivebus.protocols.dzb import DzbCodec
from drivebus.protocols.modbus import AsciiCodec, RtuCodec
from drivebus.protocols.sifang import SifangCodec

Judge = SifangJudge | DzbJudge | ModbusJudge


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A codec under trial."""

    name: str
    codec: Codec
    judge: Judge
    talk: Callable[[Random, Codec], Exchange]
    alphabet: bytes
    """What garbled bytes are drawn from: mostly what the codec's frames are made of."""
    longest: int
    """No frame of this codec has more bytes, whoever sent it: ``need`` may not ask for more (I12)."""
    meant: Callable[[Any], None] = lambda reply: None
    """What is made of an accepted reply afterwards, in every coding; raises only what it says it does."""

    def exchange(self, rng: Random) -> Exchange:
        """Lawful talk; now and then what is said to everybody, with the reply that nobody may give."""
        made = self.talk(rng, self.codec)
        if rng.random() > BROADCASTS:
            return made
        try:
            request = talk.to_everybody(made.request, self.codec)
            sent = self.codec.encode_request(request)
        except ValueError:  # a read
            return made
        at = self.judge.address
        received = made.received[: at.start] + sent[at] + made.received[at.stop :]
        return Exchange(request, sent, self.judge.seal(received))

    def asked(self, sent: bytes) -> Any:
        """The request that these bytes are, as a host would have made it."""
        message = self.codec.decode_request(sent).message  # type: ignore[union-attr]
        return getattr(message, "request", message)

    def forms(self, sent: bytes) -> tuple[Form, ...]:
        """All lawful replies to ``sent``, or (with nothing sent) all lawful requests."""
        return self.judge.forms(sent) if sent else _request_forms(self)


@cache
def _request_forms(entry: Entry) -> tuple[Form, ...]:
    return entry.judge.forms(b"")


BROADCASTS = 0.1
_HEX = b"0123456789ABCDEF"
_ALL = bytes(range(256))
_NIBBLES = bytes(range(16))
_RTU, _ASCII = 7 + 255 + 2, 2 * (7 + 255) + 5
"""The byte count of a garbled request may say 255."""


def _entries() -> tuple[Entry, ...]:
    loose = _HEX + b"abcdef:;<=>?"
    c320, modbus, df800 = talk.sifang, talk.modbus, talk.df800
    return (
        Entry("c320-ascii", SifangCodec("ascii"), SifangJudge("ascii"), c320, _HEX, 18),
        Entry("c320-ascii-tolerant", SifangCodec("ascii", "tolerant"), SifangJudge("ascii", True), c320, loose, 18),
        Entry("c320-hex", SifangCodec("hex"), SifangJudge("hex"), c320, _NIBBLES, 18),
        Entry("c320-hex-nibble", SifangCodec("hex", nibble=True), SifangJudge("hex", True), c320, _NIBBLES, 18),
        Entry("dzb100", DzbCodec(), DzbJudge(), talk.dzb, _HEX + b"\x06\x07", 11, talk.dzb_meanings),
        Entry("modbus-rtu", RtuCodec(), ModbusJudge("rtu"), modbus, _ALL, _RTU),
        Entry("modbus-ascii", AsciiCodec(), ModbusJudge("ascii", marks=2), modbus, _HEX, _ASCII),
        Entry(
            "modbus-ascii-resync",
            AsciiCodec(resync=True),
            ModbusJudge("ascii", resync=4, marks=2),
            modbus,
            _HEX,
            _ASCII + 4,
        ),
        Entry("df800-rtu", RtuCodec("short", 4), ModbusJudge("rtu", short=True), df800, _ALL, _RTU),
        Entry("df800-ascii", AsciiCodec("short", 4), ModbusJudge("ascii", True, marks=2), df800, _HEX, _ASCII),
    )


ROSTER = {entry.name: entry for entry in _entries()}
