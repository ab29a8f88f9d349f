"""Both readings of the C320 brought into one shape, and the messages that they are shown."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete
from oracle.mutate import ANY_FRAME
from verification.reference import sunfar as reference
from verification.reference.sunfar import SunfarReference

REFUSE = "refuse"
KINDS = ("read identity", "read monitor", "read parameter", "write RAM", "control", "write EEPROM")
OPERATIONS = tuple(reference.OPERATIONS)
PLAIN_STOPS = (0x03, 0x06, 0x21)
STATES = tuple(reference.STATES)


class C320Comparison:
    """One encoding; ``codec`` may be another than ours, to see that the comparison can tell."""

    def __init__(self, encoding: str, codec: Any = None) -> None:
        self.name = f"c320-{encoding}"
        self.encoding = encoding
        self.reference = SunfarReference(encoding)
        self.other = "hex" if encoding == "ascii" else "ascii"
        self.codec = codec or sunfar.SunfarCodec(encoding)  # type: ignore[arg-type]
        self.mutations = (
            *ANY_FRAME,
            self.resealed,
            self.other_alphabet,
            self.other_encoding,
            self.wrong_address,
            self.earlier_reply,
        )

    # -- requests ----------------------------------------------------------------------------------------------

    def draw(self, rng: Random) -> dict[str, int]:
        """A request's fields; one in sixteen has one that no frame can carry."""
        kind = rng.randrange(6)
        asked = {"address": rng.randrange(32), "kind": kind}
        if kind == 4:
            asked |= {"operation": rng.choice(OPERATIONS), "data": rng.choice((0, rng.randrange(0x10000)))}
            asked |= rng.choice(({}, {"expected_item": rng.randrange(256)}))
        elif kind != 1:
            asked["group"] = rng.randrange(16)
        if kind not in (0, 4):
            asked["item"] = rng.randrange(256)
        if kind in (3, 5):
            asked["data"] = rng.choice((0, rng.randrange(0x10000)))
        if rng.randrange(16) == 0:
            name = rng.choice([name for name in asked if name not in ("kind", "expected_item")])
            asked[name] = rng.choice((-1, 16, 32, 0x30, 0x31, 0x100, 0x10000))
        return asked

    def kind(self, asked: dict[str, int]) -> str:
        return KINDS[asked["kind"]]

    def reference_request(self, asked: dict[str, int]) -> bytes | None:
        try:
            return self.reference.build(**on_the_wire(asked))
        except ValueError:
            return None

    def product_request(self, asked: dict[str, int]) -> bytes | None:
        try:
            return self.codec.encode_request(product_message(asked))
        except ValueError:
            return None

    def wanted_request(self, asked: dict[str, int], plain: bytes | None) -> tuple[str | None, bytes | None]:
        """What drivebus is to build, and the name of the choice where that is not what the manual would let it."""
        if asked["kind"] in (0, 1, 2) and asked["address"] == reference.BROADCAST:
            return "no read of everybody", None
        if asked["kind"] == 4 and asked["data"]:
            if asked["operation"] in PLAIN_STOPS:
                return "a stop carries 0000", self.reference_request({**asked, "data": 0})
            if asked["operation"] & 0xF0 != 0x10:
                return "no data with an operation that sets no frequency", None
        return None, plain

    def station_reads(self, rng: Random, asked: dict[str, int]) -> bool:
        """Check that the station side reads the reference frame, with any operation (2.4.4: every class has one)."""
        operation = asked.get("operation", rng.choice(OPERATIONS))
        frame = self.reference.build(**{**on_the_wire(asked), "operation": operation})
        try:
            verdict = self.codec.decode_request(frame)
        except ProtocolError:
            return False
        expected = sunfar.ReceivedRequest(product_message(on_the_wire(asked)), sunfar.SunfarOperation(operation))
        return bool(verdict == Complete(expected, len(frame)))

    # -- replies -----------------------------------------------------------------------------------------------

    def random_reply(self, rng: Random, asked: dict[str, int]) -> bytes:
        """A reply as a drive might send it: mostly lawful, mostly with the right echoes."""
        return self._answer(rng, asked, self.encoding, asked["address"])

    def _answer(self, rng: Random, asked: dict[str, int], encoding: str, address: int) -> bytes:
        response = rng.choice((0, 0, 0, 0, rng.randrange(16), rng.choice((1, 2, 3, 4, 6, 7, 8))))
        state = rng.choice((rng.choice(STATES), rng.choice(STATES), rng.choice(STATES), 0x20, rng.randrange(0x24)))
        if response in reference.SHORT_RESPONSES:
            state = rng.choice((0, 0, 0, state))
        group = maybe(rng, asked.get("group", 0), rng.randrange(16))
        if asked["kind"] == 0 and rng.randrange(8):
            digits = rng.randrange(16), rng.randrange(16)
            if response not in reference.SHORT_RESPONSES:
                return SunfarReference(encoding).build_identity(
                    address, response, state, group, *digits, rng.randrange(0x10000)
                )
        item = maybe(rng, asked.get("item", asked.get("expected_item", rng.randrange(256))), rng.randrange(256))
        set_data = rng.choice((0, asked.get("data", 0))) if response else asked.get("data", rng.randrange(0x10000))
        data = maybe(rng, set_data, rng.randrange(0x10000))
        return SunfarReference(encoding).build_reply(address, response, state, group, item, data)

    def reference_verdict(self, request: bytes, reply: bytes) -> Any:
        found = self.reference.decode_reply(request, reply)
        if found is None or (self.encoding == "hex" and found["response"] == 7):
            return REFUSE  # 2.4.5: response 7 is for "where data is sent in ASCII"
        return found

    def product_verdict(self, asked: dict[str, int], reply: bytes) -> Any:
        """Return the meaning in the reference's form. Any exception but ProtocolError escapes as a finding."""
        try:
            verdict = self.codec.decode_reply(product_message(asked), reply)
        except ProtocolError:
            return REFUSE
        if not isinstance(verdict, Complete) or verdict.size != len(reply):
            return REFUSE  # the bus waits for the rest, or finds too much
        return reply_fields(verdict.message)

    def wanted_reply(self, asked: dict[str, int], request: bytes, reply: bytes, plain: Any) -> tuple[str | None, Any]:
        """What drivebus is to believe, and the name of the choice where that is not the manual's letter."""
        if (
            asked["kind"] == 4
            and plain != REFUSE
            and "data" in plain
            and plain.get("item", -1) != asked.get("expected_item")
        ):
            published = {name: plain[name] for name in plain if name not in ("item", "data")}
            return "a control reply's item and data are withheld", published
        if self.encoding == "hex" and plain == REFUSE and self._seven(request, reply):
            return "response 7 after a hex request is told", {"address": asked["address"], "response": 7}
        return None, plain

    def _seven(self, request: bytes, reply: bytes) -> bool:
        """Return whether only the response code 7 makes the manual reject this reply."""
        found = self.reference.decode_reply(request, reply)
        return found is not None and found["response"] == 7

    # -- hands -------------------------------------------------------------------------------------------------

    def resealed(self, rng: Random, frame: bytes) -> bytes:
        """A field's byte changes and the sum with it: only the field's own rule can see it."""
        fields = bytearray(frame[1:-5])
        digits = b"0123456789ABCDEF" if self.encoding == "ascii" else bytes(range(34))
        fields[rng.randrange(len(fields))] = rng.choice((rng.choice(digits), rng.randrange(256)))
        return self.reference.seal(bytes(fields))

    def other_alphabet(self, rng: Random, frame: bytes) -> bytes:
        """The misprints of 4.5 and 4.6: 3AH-3FH for A-F, or one nibble a byte; the sum fits."""
        if self.encoding == "ascii":
            fields = bytes(byte - 7 if byte >= 0x41 else byte for byte in frame[1:-5])
            return self.reference.seal(fields)
        fields = bytearray(frame[1:-5])
        if len(fields) > 6:
            high, low = fields[-2:]
            fields[-4:] = bytes((high >> 4, high & 15, low >> 4, low & 15))
        return self.reference.seal(bytes(fields))

    def other_encoding(self, rng: Random, frame: bytes) -> bytes:
        """The other header over these fields, with a sum in that header's own spelling."""
        return SunfarReference(self.other).seal(frame[1:-5])

    def wrong_address(self, rng: Random, frame: bytes) -> bytes:
        address = self.reference.write_field(2, rng.randrange(256))
        return self.reference.seal(address + frame[3:-5])

    def earlier_reply(self, rng: Random, frame: bytes) -> bytes:
        """The reply to something else."""
        return self._answer(rng, self.draw_lawful(rng), self.encoding, rng.randrange(31))

    def draw_lawful(self, rng: Random) -> dict[str, int]:
        while True:
            asked = self.draw(rng)
            if self.reference_request(asked) is not None:
                return asked


def maybe(rng: Random, right: int, other: int) -> int:
    return other if rng.randrange(12) == 0 else right


def on_the_wire(asked: dict[str, int]) -> dict[str, int]:
    """Without what only the host knows: the monitor that F6.12 is set to."""
    return {name: asked[name] for name in asked if name != "expected_item"}


def product_message(asked: dict[str, int]) -> sunfar.SunfarRequest:
    """The same request in our words."""
    address, kind = asked["address"], asked["kind"]
    if kind == 0:
        return sunfar.ReadIdentity(address, asked["group"])
    if kind == 1:
        return sunfar.ReadMonitor(address, asked["item"])
    if kind == 2:
        return sunfar.SunfarReadParameter(address, asked["group"], asked["item"])
    if kind == 4:
        return sunfar.SunfarControl(address, asked["operation"], asked["data"], asked.get("expected_item"))  # type: ignore[arg-type]
    return sunfar.SunfarWriteParameter(address, asked["group"], asked["item"], asked["data"], save=kind == 5)


def reply_fields(reply: sunfar.SunfarReply) -> dict[str, int]:
    """Return a reply of the product in the reference's form."""
    names = ("address", "response", "state", "group", "item", "fault_code", "data", "nibble_data")
    found = {name: int(getattr(reply, name)) for name in names if getattr(reply, name) is not None}
    if reply.info is not None:
        found["data"] = int(reply.info[2:], 16)
        if reply.info[:2] != "--":
            found |= {"digit_7": int(reply.info[0], 16), "digit_8": int(reply.info[1], 16)}
    return found
