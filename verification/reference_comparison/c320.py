"""The C320 in both codecs: random messages, and their meanings in one form."""

from __future__ import annotations

from random import Random
from typing import Any

from drivebus.errors import ProtocolError
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Complete
from verification.reference import sunfar as reference
from verification.reference.sunfar import SunfarReference
from verification.reference_comparison.mutations import ANY_FRAME, mostly

REFUSE = "refuse"
KINDS = ("read identity", "read monitor", "read parameter", "write RAM", "control", "write EEPROM")
OPERATIONS = tuple(reference.OPERATIONS)
PLAIN_STOPS = (0x03, 0x06, 0x21)
STATES = tuple(reference.STATES)


class C320Comparison:
    """Comparison of one encoding; ``codec`` replaces the product's codec in tests of the comparison."""

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
        """Return the fields of a request; one request in sixteen has an invalid field."""
        kind = rng.randrange(6)
        fields = {"address": rng.randrange(32), "kind": kind}
        if kind == 4:
            fields |= {"operation": rng.choice(OPERATIONS), "data": rng.choice((0, rng.randrange(0x10000)))}
            fields |= rng.choice(({}, {"expected_item": rng.randrange(256)}))
        elif kind != 1:
            fields["group"] = rng.randrange(16)
        if kind not in (0, 4):
            fields["item"] = rng.randrange(256)
        if kind in (3, 5):
            fields["data"] = rng.choice((0, rng.randrange(0x10000)))
        if rng.randrange(16) == 0:
            name = rng.choice([name for name in fields if name not in ("kind", "expected_item")])
            fields[name] = rng.choice((-1, 16, 32, 0x30, 0x31, 0x100, 0x10000))
        return fields

    def kind(self, fields: dict[str, int]) -> str:
        return KINDS[fields["kind"]]

    def reference_request(self, fields: dict[str, int]) -> bytes | None:
        try:
            return self.reference.build(**on_the_wire(fields))
        except ValueError:
            return None

    def product_request(self, fields: dict[str, int]) -> bytes | None:
        try:
            return self.codec.encode_request(product_message(fields))
        except ValueError:
            return None

    def wanted_request(self, fields: dict[str, int], by_reference: bytes | None) -> tuple[str | None, bytes | None]:
        """Return the name of the product's deliberate deviation from the manual, if any, and the request to expect."""
        if fields["kind"] in (0, 1, 2) and fields["address"] == reference.BROADCAST:
            return "no broadcast read", None
        if fields["kind"] == 4 and fields["data"]:
            if fields["operation"] in PLAIN_STOPS:
                return "a stop carries 0000", self.reference_request({**fields, "data": 0})
            if fields["operation"] & 0xF0 != 0x10:
                return "no data with an operation that sets no frequency", None
        return None, by_reference

    def station_reads(self, rng: Random, fields: dict[str, int]) -> bool:
        """Check that the station side reads the reference frame, with any operation (2.4.4: every class has one)."""
        operation = fields.get("operation", rng.choice(OPERATIONS))
        frame = self.reference.build(**{**on_the_wire(fields), "operation": operation})
        try:
            verdict = self.codec.decode_request(frame)
        except ProtocolError:
            return False
        expected = sunfar.ReceivedRequest(product_message(on_the_wire(fields)), sunfar.SunfarOperation(operation))
        return bool(verdict == Complete(expected, len(frame)))

    # -- replies -----------------------------------------------------------------------------------------------

    def random_reply(self, rng: Random, fields: dict[str, int]) -> bytes:
        """Return a reply as a drive might send it: mostly valid, mostly with correct echoes."""
        return self._answer(rng, fields, self.encoding, fields["address"])

    def _answer(self, rng: Random, fields: dict[str, int], encoding: str, address: int) -> bytes:
        response = rng.choice((0, 0, 0, 0, rng.randrange(16), rng.choice((1, 2, 3, 4, 6, 7, 8))))
        state = rng.choice((rng.choice(STATES), rng.choice(STATES), rng.choice(STATES), 0x20, rng.randrange(0x24)))
        if response in reference.SHORT_RESPONSES:
            state = rng.choice((0, 0, 0, state))
        group = mostly(rng, fields.get("group", 0), rng.randrange(16))
        if fields["kind"] == 0 and rng.randrange(8):
            digits = rng.randrange(16), rng.randrange(16)
            if response not in reference.SHORT_RESPONSES:
                return SunfarReference(encoding).build_identity(
                    address, response, state, group, *digits, rng.randrange(0x10000)
                )
        item = mostly(rng, fields.get("item", fields.get("expected_item", rng.randrange(256))), rng.randrange(256))
        set_data = rng.choice((0, fields.get("data", 0))) if response else fields.get("data", rng.randrange(0x10000))
        data = mostly(rng, set_data, rng.randrange(0x10000))
        return SunfarReference(encoding).build_reply(address, response, state, group, item, data)

    def reference_verdict(self, request: bytes, reply: bytes) -> Any:
        found = self.reference.decode_reply(request, reply)
        if found is None or (self.encoding == "hex" and found["response"] == 7):
            return REFUSE  # 2.4.5: response 7 is for "where data is sent in ASCII"
        return found

    def product_verdict(self, fields: dict[str, int], reply: bytes) -> Any:
        """Return the meaning in the reference's form. Any exception but ProtocolError escapes as a finding."""
        try:
            verdict = self.codec.decode_reply(product_message(fields), reply)
        except ProtocolError:
            return REFUSE
        if not isinstance(verdict, Complete) or verdict.size != len(reply):
            return REFUSE  # the bus waits for the rest, or finds too much
        return reply_fields(verdict.message)

    def wanted_reply(
        self, fields: dict[str, int], request: bytes, reply: bytes, by_reference: Any
    ) -> tuple[str | None, Any]:
        """Return the name of the product's deliberate deviation from the manual, if any, and the meaning to expect."""
        if (
            fields["kind"] == 4
            and by_reference != REFUSE
            and "data" in by_reference
            and by_reference.get("item", -1) != fields.get("expected_item")
        ):
            published = {name: by_reference[name] for name in by_reference if name not in ("item", "data")}
            return "a control reply's item and data are withheld", published
        if self.encoding == "hex" and by_reference == REFUSE and self._rejected_for_response_7(request, reply):
            return "response 7 after a hex request is reported", {"address": fields["address"], "response": 7}
        return None, by_reference

    def _rejected_for_response_7(self, request: bytes, reply: bytes) -> bool:
        """Return whether only the response code 7 makes the manual reject this reply."""
        found = self.reference.decode_reply(request, reply)
        return found is not None and found["response"] == 7

    # -- mutations -------------------------------------------------------------------------------------------------

    def resealed(self, rng: Random, frame: bytes) -> bytes:
        """Change one byte of a field and adapt the sum: only the rule of the field detects it."""
        fields = bytearray(frame[1:-5])
        digits = b"0123456789ABCDEF" if self.encoding == "ascii" else bytes(range(34))
        fields[rng.randrange(len(fields))] = rng.choice((rng.choice(digits), rng.randrange(256)))
        return self.reference.seal(bytes(fields))

    def other_alphabet(self, rng: Random, frame: bytes) -> bytes:
        """Apply the misprints of 4.5 and 4.6: 3AH-3FH for A-F, or one nibble a byte; the sum is correct."""
        if self.encoding == "ascii":
            return self.reference.seal(bytes(byte - 7 if byte >= 0x41 else byte for byte in frame[1:-5]))
        fields = bytearray(frame[1:-5])
        if len(fields) > 6:
            high, low = fields[-2:]
            fields[-4:] = bytes((high >> 4, high & 15, low >> 4, low & 15))
        return self.reference.seal(bytes(fields))

    def other_encoding(self, rng: Random, frame: bytes) -> bytes:
        """Return these fields with the header and sum of the other encoding."""
        return SunfarReference(self.other).seal(frame[1:-5])

    def wrong_address(self, rng: Random, frame: bytes) -> bytes:
        address = self.reference.write_field(2, rng.randrange(256))
        return self.reference.seal(address + frame[3:-5])

    def earlier_reply(self, rng: Random, frame: bytes) -> bytes:
        """Return the reply to another request."""
        return self._answer(rng, self.draw_valid(rng), self.encoding, rng.randrange(31))

    def draw_valid(self, rng: Random) -> dict[str, int]:
        while True:
            fields = self.draw(rng)
            if self.reference_request(fields) is not None:
                return fields


def on_the_wire(fields: dict[str, int]) -> dict[str, int]:
    """Return the fields without the monitor item of F6.12, which only the master knows."""
    return {name: fields[name] for name in fields if name != "expected_item"}


def product_message(fields: dict[str, int]) -> sunfar.SunfarRequest:
    """Return the same request as a message of the product."""
    address, kind = fields["address"], fields["kind"]
    if kind == 0:
        return sunfar.ReadIdentity(address, fields["group"])
    if kind == 1:
        return sunfar.ReadMonitor(address, fields["item"])
    if kind == 2:
        return sunfar.SunfarReadParameter(address, fields["group"], fields["item"])
    if kind == 4:
        return sunfar.SunfarControl(address, fields["operation"], fields["data"], fields.get("expected_item"))  # type: ignore[arg-type]
    return sunfar.SunfarWriteParameter(address, fields["group"], fields["item"], fields["data"], save=kind == 5)


def reply_fields(reply: sunfar.SunfarReply) -> dict[str, int]:
    """Return a reply of the product in the reference's form."""
    names = ("address", "response", "state", "group", "item", "fault_code", "data", "nibble_data")
    found = {name: int(getattr(reply, name)) for name in names if getattr(reply, name) is not None}
    if reply.info is not None:
        found["data"] = int(reply.info[2:], 16)
        if reply.info[:2] != "--":
            found |= {"digit_7": int(reply.info[0], 16), "digit_8": int(reply.info[1], 16)}
    return found
