"""The DZB100 in both codecs: random messages, and their meanings in one form."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100
from drivebus.protocols.codec import Complete
from verification.reference.dzb100 import HEADS, Dzb100Reference
from verification.reference.dzb100 import KINDS as KINDS_BY_HEAD
from verification.reference_comparison.mutations import ANY_FRAME, mostly

REFUSE = "refuse"
REFERENCE = Dzb100Reference()
KINDS = tuple(HEADS)


class Dzb100Comparison:
    """The DZB100; ``codec`` replaces the product's codec in tests of the comparison."""

    def __init__(self, codec: Any = None) -> None:
        self.name = "dzb100"
        self.codec = codec or dzb100.Dzb100Codec()
        self.mutations = (
            *ANY_FRAME,
            self.another_b,
            self.other_alphabet,
            self.other_head,
            self.wrong_address,
            self.earlier_reply,
        )

    # -- requests ----------------------------------------------------------------------------------------------

    def draw(self, rng: Random) -> dict[str, Any]:
        """Return the fields of a request; one request in sixteen has an invalid field."""
        kind = rng.choice(KINDS)
        last = {"control": 8, "query": 3}.get(kind, 80)
        fields: dict[str, Any] = {"kind": kind, "address": rng.randint(1, 31), "number": rng.randint(0, last)}
        if kind == "control":
            fields["address"] = rng.choice((fields["address"], fields["address"], fields["address"], 0))
        if kind in ("control", "write"):
            fields["data"] = rng.choice((0, rng.randrange(0x10000)))
        if rng.randrange(16) == 0:
            fields[rng.choice([name for name in fields if name != "kind"])] = rng.choice(
                (-1, 0, 9, 32, 81, 100, 0x10000)
            )
        return fields

    def kind(self, fields: dict[str, Any]) -> str:
        return str(fields["kind"])

    def reference_request(self, fields: dict[str, Any]) -> bytes | None:
        try:
            return REFERENCE.build(**fields)
        except ValueError:
            return None

    def product_request(self, fields: dict[str, Any]) -> bytes | None:
        try:
            return self.codec.encode_request(product_message(fields))
        except ValueError:
            return None

    def wanted_request(self, fields: dict[str, Any], by_reference: bytes | None) -> tuple[str | None, bytes | None]:
        """Return the name of the product's deliberate deviation from the manual, if any, and the request to expect."""
        if fields["kind"] == "control" and fields["data"]:
            if fields["number"] in (0, 2):
                return "a stop carries 0000", self.reference_request({**fields, "data": 0})
            if fields["number"] == 8:
                return "no data with a reset", None
        return None, by_reference

    def station_reads(self, rng: Random, fields: dict[str, Any]) -> bool:
        """Check that the station side reads the reference frame."""
        frame = REFERENCE.build(**fields)
        try:
            return bool(self.codec.decode_request(frame) == Complete(product_message(fields), len(frame)))
        except ProtocolError:
            return False

    # -- replies -----------------------------------------------------------------------------------------------

    def random_reply(self, rng: Random, fields: dict[str, Any]) -> bytes:
        """Return a reply as a drive might send it: mostly valid, mostly with correct echoes."""
        b = rng.choice((6, 6, 6, 6, 7))
        if fields["kind"] == "control":
            b = rng.choice((b, b, rng.randrange(10), rng.choice(b"0123456789:"), rng.randrange(256)))
        data = rng.randrange(0x10000)
        if fields["kind"] == "query" and fields["number"] == 3:
            data = rng.choice((data, rng.randrange(10) << 12 | rng.randrange(16) << 8 | rng.randrange(0x24)))
        data = mostly(rng, fields.get("data", data), rng.randrange(0x10000))
        number = mostly(rng, fields["number"], rng.randrange(100))
        return REFERENCE.build_reply(fields["kind"], b, fields["address"], number, data)

    def reference_verdict(self, request: bytes, reply: bytes) -> Any:
        return REFERENCE.decode_reply(request, reply) or REFUSE

    def product_verdict(self, fields: dict[str, Any], reply: bytes) -> Any:
        """Return the meaning in the reference's form, Q03 read as the drive layer reads it."""
        try:
            verdict = self.codec.decode_reply(product_message(fields), reply)
            if not isinstance(verdict, Complete) or verdict.size != len(reply):
                return REFUSE  # the bus waits for the rest, or finds too much
            return reply_fields(verdict.message)
        except ProtocolError:
            return REFUSE

    def wanted_reply(
        self, fields: dict[str, Any], request: bytes, reply: bytes, by_reference: Any
    ) -> tuple[str | None, Any]:
        """Return the name of the product's deliberate deviation from the manual, if any, and the meaning to expect."""
        if fields["kind"] == "control" and by_reference != REFUSE and reply[2] >> 4 not in (0, 3):
            return "B of a control reply: X is 0 or an ASCII digit", REFUSE
        return None, by_reference

    # -- mutations -------------------------------------------------------------------------------------------------

    def another_b(self, rng: Random, frame: bytes) -> bytes:
        return frame[:2] + rng.randbytes(1) + frame[3:]

    def other_alphabet(self, rng: Random, frame: bytes) -> bytes:
        """Replace A-F by 3AH-3FH, as the C320's manual prints them."""
        return frame[:3] + bytes(byte - 7 if byte >= 0x41 else byte for byte in frame[3:])

    def other_head(self, rng: Random, frame: bytes) -> bytes:
        return bytes((rng.choice(b"CPRQ"),)) + frame[1:]

    def wrong_address(self, rng: Random, frame: bytes) -> bytes:
        return frame[:3] + (REFERENCE.two_decimal(rng.randrange(100))) + frame[5:]

    def earlier_reply(self, rng: Random, frame: bytes) -> bytes:
        """Return the reply to another request."""
        while True:
            fields = self.draw(rng)
            if self.reference_request(fields) is not None:
                return self.random_reply(rng, fields)


def product_message(fields: dict[str, Any]) -> dzb100.Dzb100Request:
    """Return the same request as a message of the product."""
    address, number = fields["address"], fields["number"]
    if fields["kind"] == "control":
        return dzb100.Dzb100Control(address, number, fields["data"], broadcast=address == dzb100.BROADCAST)
    if fields["kind"] == "write":
        return dzb100.Dzb100WriteParameter(address, number, fields["data"])
    return (
        dzb100.Dzb100ReadParameter(address, number) if fields["kind"] == "read" else dzb100.Dzb100Query(address, number)
    )


def reply_fields(reply: dzb100.Dzb100Reply) -> dict[str, Any]:
    """Return a reply of the product in the reference's form. Raises CodeError for an unknown state word."""
    found: dict[str, Any] = {
        "kind": KINDS_BY_HEAD[ord(reply.head)],
        "address": reply.address,
        "number": reply.index,
        "result": {True: "right", False: "wrong", None: reply.digit}[reply.accepted],
        "data": reply.data,
    }
    if reply.head == "Q" and reply.index == 3 and reply.accepted:
        word = dzb100.StateWord.parse(reply.data)
        found |= {"command": word.command, "state_digit": word.state, "fault_code": word.fault_code}
    return found
