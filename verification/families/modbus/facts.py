"""Facts of VC660 and DF800: variants, and the effects of their Modbus requests."""

from __future__ import annotations

from dataclasses import replace

from verification.drive_variants import DriveVariant, FrameLengths
from verification.families.family_facts import FamilyFacts
from verification.reference.effects import ReferenceWrite, RequestEffect
from verification.reference.modbus import ModbusReference


def _rtu_reply(request: bytes) -> int:
    return 4 + _payload(request)


def _ascii_reply(request: bytes) -> int:
    return 3 + 2 * (3 + _payload(bytes.fromhex(request[1:-2].decode())))


def _payload(octets: bytes) -> int:
    return 1 + 2 * octets[5] if octets[1] == 3 else 4


VC660 = DriveVariant(
    name="vc660",
    model="vc660",
    encoding="rtu",
    baud=9600,
    frames=FrameLengths(request=8, reply=13, stop=8, delay_s=0.024, delay_characters=3.5, reply_to=_rtu_reply),
    gap_floor_s=0.00175,
    min_timeout_s=0.004,
    max_reply_lateness_s=0.204,
    setpoint_readable=True,
    lateness_range_s=(0.08, 0.17),
    plain_reply=(7, (0, 1)),
)
"""FC03 of four registers; F06.06 = 4 ms and 20 ms of work."""
DF800 = DriveVariant(
    name="df800-rtu",
    model="df800",
    encoding="rtu",
    baud=9600,
    frames=FrameLengths(request=8, reply=9, stop=8, delay_s=0.1, delay_characters=3.5, reply_to=_rtu_reply),
    drive_options={"direction_calibrated": True},
    gap_floor_s=0.00175,
    identical_probe_quarantine_s=5.0,
    reports_running=False,
    stops_by_broadcast=False,
    maximum_hz=400.0,
    plain_reply=(7, (0, 1)),
)
"""FC03 of two registers at most."""
DF800_ASCII = replace(
    DF800,
    name="df800-ascii",
    encoding="ascii",
    frames=FrameLengths(request=17, reply=19, stop=17, delay_s=0.1, reply_to=_ascii_reply),
    options={"encoding": "ascii"},
    gap_floor_s=0.0,
    min_timeout_characters=15,
    plain_reply=(15, (1, 2, 3, 4)),
)
COMMAND_REGISTER, FREQUENCY_REGISTER, LAST_PUBLISHED_REGISTER = 0x2000, 0x2001, 0x2FFF
"""VC660 and DF800; up to 2FFFH no other register is published."""
VC660_STATUS_REGISTER, VC660_RUNNING = 0x3000, 0x08
VC660_STARTS = 0x0001 | 0x0008 | 0x0010
"""VC660 §5: b0 start, b3 and b4 jog."""
VC660_STOPS = 0x0002 | 0x0020 | 0x0040
"""VC660 §5: b1 stop, b5 coast, b6 emergency stop."""
VC660_REVERSE, VC660_RESET = 0x0004, 0x0200
"""VC660 §5: b2 direction, b9 fault reset."""
VC660_PAUSE, VC660_RAMP_HOLD = 0x0080, 0x0100
"""VC660 §5: b7 pause, b8 ramp hold; levels, so the next word without them ends them."""
VC660_HOLDS = VC660_PAUSE | VC660_RAMP_HOLD
VC660_BITS = VC660_STARTS | VC660_STOPS | VC660_REVERSE | VC660_RESET | VC660_HOLDS
DF800_BITS = 0x001F
"""2000H of the DF800: b1-b0 01 stop, 10 start, 11 jog; b3-b2 direction; b4 fault reset."""
DF800_TOGGLE = 0x0C
"""Direction bits of the DF800 that toggle the direction (T16)."""
DF800_PARAMETERS = range(100, 1000)
"""Parameter registers of the DF800: group × 100 + number; group 0 holds monitors."""
VC660_LAST_INDEX = 450
VC660_EEPROM = 0x8000
"""VC660: set in the address of a parameter that is saved."""


class ModbusFacts(FamilyFacts):
    """Facts of VC660 and DF800."""

    variants = (VC660, DF800, DF800_ASCII)

    def classify(self, model: str, encoding: str, frame: bytes) -> tuple[int, RequestEffect]:
        octets = ModbusReference(encoding).parse_request(frame)
        return octets[0], _vc660_effect(octets) if model == "vc660" else _df800_effect(octets)

    def worst_effect(self, model: str, frame: bytes, command_word: int) -> RequestEffect:
        """Return the worst effect of RTU. ``command_word``: the word that a VC660 was sent before."""
        value = _worst_command(frame)
        if isinstance(value, RequestEffect):
            return value
        return _worst_vc660(value, command_word) if model == "vc660" else _worst_df800(value)

    def decode_write(self, variant: DriveVariant, frame: bytes) -> ReferenceWrite:
        written = modbus_write(variant, frame)
        if written is None:
            raise ValueError(f"no write: {frame.hex(' ')}")
        register, value = written
        if register == FREQUENCY_REGISTER:
            return ReferenceWrite(hz=value / 100)
        if register == COMMAND_REGISTER:
            _check_command_word(variant, value)
            return ReferenceWrite()
        parameter = register & ~VC660_EEPROM if variant.model == "vc660" else register
        listed = range(VC660_LAST_INDEX + 1) if variant.model == "vc660" else DF800_PARAMETERS
        if parameter not in listed:
            raise ValueError(f"register {register:04X}H is on no list")
        return ReferenceWrite(parameter=parameter, saved=variant.model == "df800" or register >= VC660_EEPROM)

    def is_sync_probe(self, variant: DriveVariant, frame: bytes) -> bool:
        """Return whether a request is function 08 (VC660) or a read of two registers, used for nothing else (DF800)."""
        octets = ModbusReference(variant.encoding).parse_request(frame)
        return octets[1] == 8 if variant.model == "vc660" else octets[1] == 3 and octets[4:6] == b"\x00\x02"

    def status_read_key(self, variant: DriveVariant, request: bytes) -> bytes | None:
        octets = ModbusReference(variant.encoding).parse_request(request)
        register = int.from_bytes(octets[2:4])
        shows = variant.model == "vc660" and octets[1] == 3 and register == VC660_STATUS_REGISTER
        return octets[2:4] if shows else None

    def shows_standstill(self, variant: DriveVariant, request: bytes, reply: bytes) -> bool | None:
        if self.status_read_key(variant, request) is None:
            return None
        return not ModbusReference(variant.encoding).octets(reply)[4] & VC660_RUNNING


def modbus_write(variant: DriveVariant, frame: bytes) -> tuple[int, int] | None:
    """Return register and value of a Modbus write; None for other requests."""
    return _register_write(ModbusReference(variant.encoding).parse_request(frame))


def command_word(frame: bytes) -> int | None:
    """Return the word that a Modbus RTU frame writes to the command register; None where it writes none."""
    try:
        written = _register_write(ModbusReference("rtu").parse_request(frame))
    except ValueError:
        return None
    return written[1] if written is not None and written[0] == COMMAND_REGISTER else None


def _vc660_effect(octets: bytes) -> RequestEffect:
    value = _command_or_effect(octets, reads=(3, 8))
    if isinstance(value, RequestEffect):
        return value
    if value & VC660_STOPS:
        return RequestEffect.STOP
    if value & (VC660_STARTS | VC660_RAMP_HOLD):
        return RequestEffect.MOTION
    return RequestEffect.SETTING if value & (VC660_RESET | VC660_PAUSE) else RequestEffect.RELEASE


def _df800_effect(octets: bytes) -> RequestEffect:
    value = _command_or_effect(octets, reads=(3,))
    if isinstance(value, RequestEffect):
        return value
    return (RequestEffect.SETTING, RequestEffect.STOP, RequestEffect.MOTION, RequestEffect.MOTION)[value & 3]


def _command_or_effect(octets: bytes, reads: tuple[int, ...]) -> int | RequestEffect:
    """Return the word written to the command register, else the effect."""
    if octets[1] in reads:
        return RequestEffect.READ
    written = _register_write(octets)
    if written is None:
        raise ValueError(f"function {octets[1]}: {octets.hex(' ')}")
    return written[1] if written[0] == COMMAND_REGISTER else RequestEffect.SETTING


def _register_write(octets: bytes) -> tuple[int, int] | None:
    """Return register and value that function 6 writes; None for other functions."""
    return (int.from_bytes(octets[2:4]), int.from_bytes(octets[4:6])) if octets[1] == 6 else None


def _worst_vc660(value: int, held: int) -> RequestEffect:
    if value & ~VC660_BITS or value & VC660_STARTS:
        return RequestEffect.MOTION
    holds = value & VC660_HOLDS
    if value & VC660_STOPS:
        return RequestEffect.MOTION if holds else RequestEffect.STOP
    if (value ^ held) & VC660_REVERSE:
        return RequestEffect.MOTION
    if value & VC660_RESET:
        return RequestEffect.MOTION if (value ^ held) & VC660_HOLDS else RequestEffect.SETTING
    completes_reset = held & VC660_RESET and not (value ^ held) & VC660_HOLDS
    if holds == VC660_PAUSE or (holds and completes_reset):
        return RequestEffect.SETTING
    return RequestEffect.MOTION if holds or held & VC660_HOLDS else RequestEffect.STOP


def _worst_df800(value: int) -> RequestEffect:
    known = {0x00: RequestEffect.STOP, 0x01: RequestEffect.STOP, 0x10: RequestEffect.SETTING}
    return known.get(value, RequestEffect.MOTION)


def _worst_command(frame: bytes) -> RequestEffect | int:
    octets = ModbusReference("rtu").parse_request(frame)
    written = _register_write(octets)
    if written is not None and FREQUENCY_REGISTER < written[0] <= LAST_PUBLISHED_REGISTER:
        return RequestEffect.MOTION
    return _command_or_effect(octets, reads=(3, 8))


def _check_command_word(variant: DriveVariant, value: int) -> None:
    vc660 = variant.model == "vc660"
    with_hold = vc660 and value & VC660_HOLDS and value & (VC660_STARTS | VC660_STOPS)
    toggles = not vc660 and value & DF800_TOGGLE == DF800_TOGGLE
    if value & ~(VC660_BITS if vc660 else DF800_BITS) or with_hold or toggles:
        raise ValueError(f"no command is {value:04X}H")


FACTS = ModbusFacts()
