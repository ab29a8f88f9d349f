"""Facts of the DZB100: its variant, and the effects of its requests."""

from __future__ import annotations

from verification.drive_variants import DriveVariant, FrameLengths
from verification.families.effect_names import effect_of_name
from verification.families.family_facts import FamilyFacts
from verification.reference.dzb100 import COMMANDS, Dzb100Reference
from verification.reference.effects import ReferenceWrite, RequestEffect

DZB100 = DriveVariant(
    name="dzb100",
    model="dzb100",
    encoding="ascii",
    baud=4800,
    frames=FrameLengths(request=11, reply=11, stop=11, delay_s=0.1),
    drive_options={"setpoint_coding": "hex-0.1", "query_coding": "hex-0.1", "parameter_coding": "hex-0.1"},
    min_timeout_characters=11,
    maximum_hz=400.0,
    start_has_setpoint=True,
    undetected_swaps=(3, 7),
    setpoint_readable=True,
    status_read_count=2,
    plain_reply=(11, (0, 3, 4)),
    has_checksum=False,
)
"""A stop always carries 0000 (T11)."""
COMMAND_EFFECTS = {command: effect_of_name(name) for command, name in COMMANDS.items()}
LAST_PARAMETER = 80


class Dzb100Facts(FamilyFacts):
    """Facts of the DZB100."""

    variants = (DZB100,)

    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        what, address, number, _ = Dzb100Reference().parse_request(frame)
        return address, _effect(what, number)

    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        what, _, number, data = Dzb100Reference().parse_request(frame)
        effect = _effect(what, number)
        # a stop carries 0000: with other data one flipped bit makes it a run (T11)
        return RequestEffect.MOTION if effect is RequestEffect.STOP and data else effect

    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        what, _, number, data = Dzb100Reference().parse_request(frame)
        if what == "control":
            return ReferenceWrite(hz=data / 10)
        if number > LAST_PARAMETER:
            raise ValueError(f"parameter {number} is on no list")
        return ReferenceWrite(parameter=number, saved=True)

    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request is a read of a parameter (R)."""
        return Dzb100Reference().parse_request(frame)[0] == "read"

    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        what, _, number, _ = Dzb100Reference().parse_request(request)
        return request if what == "query" and number in (1, 3) else None

    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        known = Dzb100Reference().decode_reply(request, reply)
        if known is None or known["kind"] != "query" or known["result"] != "right":
            return None
        if known["number"] == 3:  # A is the run command
            return COMMAND_EFFECTS[known["command"]] is RequestEffect.STOP
        return known["data"] == 0 if known["number"] == 1 else None


def _effect(what: str, number: int) -> RequestEffect:
    if what == "control":
        return COMMAND_EFFECTS[number % 10]
    return RequestEffect.SETTING if what == "write" else RequestEffect.READ


FACTS = Dzb100Facts()
