"""Both readings of the DZB100 brought into one shape, and the messages that they are shown."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import dzb100
from drivebus.protocols.codec import Complete
from oracle.mutate import ANY_FRAME
from verification.reference.dzb100 import HEADS, Dzb100Reference
from verification.reference.dzb100 import KINDS as KINDS_BY_HEAD

REFUSE = "refuse"
REFERENCE = Dzb100Reference()
KINDS = tuple(HEADS)


class Dzb100Comparison:
    """``codec`` may be another than ours, to see that the comparison can tell."""

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
        """A request's fields; one in sixteen has one that no frame can carry."""
        kind = rng.choice(KINDS)
        last = {"control": 8, "query": 3}.get(kind, 80)
        asked: dict[str, Any] = {"kind": kind, "address": rng.randint(1, 31), "number": rng.randint(0, last)}
        if kind == "control":
            asked["address"] = rng.choice((asked["address"], asked["address"], asked["address"], 0))
        if kind in ("control", "write"):
            asked["data"] = rng.choice((0, rng.randrange(0x10000)))
        if rng.randrange(16) == 0:
            asked[rng.choice([name for name in asked if name != "kind"])] = rng.choice((-1, 0, 9, 32, 81, 100, 0x10000))
        return asked

    def kind(self, asked: dict[str, Any]) -> str:
        return str(asked["kind"])

    def reference_request(self, asked: dict[str, Any]) -> bytes | None:
        try:
            return REFERENCE.build(**asked)
        except ValueError:
            return None

    def product_request(self, asked: dict[str, Any]) -> bytes | None:
        try:
            return self.codec.encode_request(product_message(asked))
        except ValueError:
            return None

    def wanted_request(self, asked: dict[str, Any], plain: bytes | None) -> tuple[str | None, bytes | None]:
        """What drivebus is to build, and the name of the choice where that is not what the manual would let it."""
        if asked["kind"] == "control" and asked["data"]:
            if asked["number"] in (0, 2):
                return "a stop carries 0000", self.reference_request({**asked, "data": 0})
            if asked["number"] == 8:
                return "no data with a reset", None
        return None, plain

    def station_reads(self, rng: Random, asked: dict[str, Any]) -> bool:
        """Check that the station side reads the reference frame."""
        frame = REFERENCE.build(**asked)
        try:
            return bool(self.codec.decode_request(frame) == Complete(product_message(asked), len(frame)))
        except ProtocolError:
            return False

    # -- replies -----------------------------------------------------------------------------------------------

    def random_reply(self, rng: Random, asked: dict[str, Any]) -> bytes:
        """A reply as a drive might send it: mostly lawful, mostly with the right echoes."""
        b = rng.choice((6, 6, 6, 6, 7))
        if asked["kind"] == "control":
            b = rng.choice((b, b, rng.randrange(10), rng.choice(b"0123456789:"), rng.randrange(256)))
        data = rng.randrange(0x10000)
        if asked["kind"] == "query" and asked["number"] == 3:
            data = rng.choice((data, rng.randrange(10) << 12 | rng.randrange(16) << 8 | rng.randrange(0x24)))
        data = maybe(rng, asked.get("data", data), rng.randrange(0x10000))
        number = maybe(rng, asked["number"], rng.randrange(100))
        return REFERENCE.build_reply(asked["kind"], b, asked["address"], number, data)

    def reference_verdict(self, request: bytes, reply: bytes) -> Any:
        return REFERENCE.decode_reply(request, reply) or REFUSE

    def product_verdict(self, asked: dict[str, Any], reply: bytes) -> Any:
        """Return the meaning in the reference's form, Q03 read as the drive layer reads it."""
        try:
            verdict = self.codec.decode_reply(product_message(asked), reply)
            if not isinstance(verdict, Complete) or verdict.size != len(reply):
                return REFUSE  # the bus waits for the rest, or finds too much
            return reply_fields(verdict.message)
        except ProtocolError:
            return REFUSE

    def wanted_reply(self, asked: dict[str, Any], request: bytes, reply: bytes, plain: Any) -> tuple[str | None, Any]:
        """What drivebus is to believe, and the name of the choice where that is not the manual's letter."""
        if asked["kind"] == "control" and plain != REFUSE and reply[2] >> 4 not in (0, 3):
            return "B of a control reply: X is 0 or an ASCII digit", REFUSE
        return None, plain

    # -- hands -------------------------------------------------------------------------------------------------

    def another_b(self, rng: Random, frame: bytes) -> bytes:
        return frame[:2] + rng.randbytes(1) + frame[3:]

    def other_alphabet(self, rng: Random, frame: bytes) -> bytes:
        """3AH-3FH for A-F, as the C320's manual prints them."""
        return frame[:3] + bytes(byte - 7 if byte >= 0x41 else byte for byte in frame[3:])

    def other_head(self, rng: Random, frame: bytes) -> bytes:
        return bytes((rng.choice(b"CPRQ"),)) + frame[1:]

    def wrong_address(self, rng: Random, frame: bytes) -> bytes:
        return frame[:3] + (REFERENCE.two_decimal(rng.randrange(100))) + frame[5:]

    def earlier_reply(self, rng: Random, frame: bytes) -> bytes:
        """The reply to something else."""
        while True:
            asked = self.draw(rng)
            if self.reference_request(asked) is not None:
                return self.random_reply(rng, asked)


def maybe(rng: Random, right: int, other: int) -> int:
    return other if rng.randrange(12) == 0 else right


def product_message(asked: dict[str, Any]) -> dzb100.Dzb100Request:
    """The same request in our words."""
    address, number = asked["address"], asked["number"]
    if asked["kind"] == "control":
        return dzb100.Dzb100Control(address, number, asked["data"], broadcast=address == dzb100.BROADCAST)
    if asked["kind"] == "write":
        return dzb100.Dzb100WriteParameter(address, number, asked["data"])
    return (
        dzb100.Dzb100ReadParameter(address, number) if asked["kind"] == "read" else dzb100.Dzb100Query(address, number)
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
