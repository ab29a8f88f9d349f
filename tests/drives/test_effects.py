"""Effects of frames, and frames that must never be sent: hazards of the manuals (T01, T07, T11, T12, T16; I7)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import create_dialect
from drivebus.drives.dialects.base import Dialect, Hold, StopMode
from drivebus.drives.dialects.command_word import CommandBits
from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError, ProtocolError
from drivebus.profiles.words import MOTION_COMMANDS
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from fixtures.drives import dialect_for

VECTORS = Path(__file__).resolve().parents[2] / "vectors"


def frame(model: str, request: Any, **settings: Any) -> tuple[Any, bytes]:
    dialect = dialect_for(model, **settings)
    return dialect, dialect.codec.encode_request(request)


def effect(model: str, request: Any, **settings: Any) -> Effect:
    dialect, data = frame(model, request, **settings)
    return dialect.station_config.effect_of(data)


def lawful(model: str, request: Any) -> bool:
    dialect, data = frame(model, request)
    found: bool = dialect.is_allowed(data)
    return found


def vectors(model: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (VECTORS / f"{model}.jsonl").read_text().splitlines() if line.strip()]


PRINTED = [v for v in vectors("c320") if v["direction"] == "request"]
STARTS = [v for v in PRINTED if v["fields"]["operation"] in (1, 2, 4, 5, 0x11, 0x12, 0x14, 0x15)]


@pytest.mark.parametrize("entry", PRINTED, ids=lambda v: v["id"])
def test_every_printed_example_that_starts_the_motor_counts_as_motion(entry: dict[str, Any]) -> None:
    """Only a control frame (class 4) that starts may be sent at all."""
    data, moves = bytes.fromhex(entry["hex"]), entry in STARTS
    dialect = create_dialect(profiles.load("c320"), 1, encoding=entry["encoding"])
    assert (dialect.station_config.effect_of(data) is Effect.MOTION) is moves
    if moves and entry["fields"]["class"] != 4:
        assert not dialect.is_allowed(data)


def test_the_manual_starts_the_motor_in_every_example_of_its_chapter_4() -> None:
    assert {v["id"] for v in PRINTED if v["source"].startswith("manual §4")} <= {v["id"] for v in STARTS}
    assert len(STARTS) == 13


@pytest.mark.parametrize("group", range(16))
def test_reads_and_writes_of_c320_never_carry_an_operation(group: int) -> None:
    for item in range(0, 256, 17):
        assert effect("c320", sunfar.SunfarReadParameter(1, group, item)) is Effect.NONE
        assert effect("c320", sunfar.SunfarWriteParameter(1, group, item, 0x1234)) is Effect.SETTING
        assert effect("c320", sunfar.ReadMonitor(1, item)) is Effect.NONE


@pytest.mark.parametrize("operation", list(sunfar.SunfarOperation))
def test_c320_operations_have_the_effect_that_the_manual_gives_them(operation: sunfar.SunfarOperation) -> None:
    name = operation.name
    moves = name.startswith(("RUN_", "JOG_FORWARD", "JOG_REVERSE"))
    stops = name in ("STOP", "JOG_STOP", "EMERGENCY_STOP")
    expected = Effect.MOTION if moves else Effect.STOP if stops else Effect.SETTING
    assert effect("c320", sunfar.SunfarControl(1, operation)) is expected


def test_a_c320_stop_that_carries_data_is_not_exempt_from_permits() -> None:
    dialect = dialect_for("c320")
    plain = dialect.codec.encode_request(sunfar.SunfarControl(1, sunfar.SunfarOperation.STOP))
    spoiled = bytearray(plain)
    spoiled[6:10] = b"03E8"
    spoiled[10:14] = f"{sum(spoiled[1:10]):04X}".encode()
    assert dialect.station_config.effect_of(plain) is Effect.STOP
    assert dialect.station_config.effect_of(bytes(spoiled)) in (Effect.SETTING, Effect.MOTION)


def test_a_dzb100_stop_with_a_frequency_counts_as_motion() -> None:
    assert effect("dzb100", dzb100.Dzb100Control(1, dzb100.Dzb100Command.STOP, 0)) is Effect.STOP
    dialect = dialect_for("dzb100")
    for request in dialect.stop(StopMode.STOP):
        assert request.data == 0
    data = bytearray(dialect.codec.encode_request(dzb100.Dzb100Control(1, dzb100.Dzb100Command.STOP, 0)))
    data[7:11] = b"03E8"
    assert dialect.station_config.effect_of(bytes(data)) is Effect.MOTION


def test_one_flipped_bit_of_a_dzb100_stop_that_runs_commands_zero_hertz() -> None:
    dialect = dialect_for("dzb100")
    plain = dialect.codec.encode_request(dialect.stop(StopMode.STOP)[0])
    for place in range(len(plain)):
        for bit in range(8):
            spoiled = bytearray(plain)
            spoiled[place] ^= 1 << bit
            try:
                found = dialect.codec.decode_request(bytes(spoiled))
            except ProtocolError:
                continue
            request = getattr(found, "message", None)
            if isinstance(request, dzb100.Dzb100Control) and not request.command.is_stop:
                assert request.data == 0


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
def test_a_stop_cut_short_or_with_more_behind_it_may_move_and_never_leaves_with_a_permit(model: str) -> None:
    """Only one whole request is exempt from permits or allowed."""
    dialect = dialect_for(model)
    plain = dialect.codec.encode_request(dialect.stop(StopMode.STOP)[0])
    assert dialect.station_config.effect_of(plain) is Effect.STOP and dialect.is_allowed(plain)
    for data in (b"", plain[:1], plain[:-1], plain + b"\x00", plain + plain):
        assert dialect.station_config.effect_of(data) is Effect.MOTION
        assert not dialect.is_allowed(data)


def test_an_unlisted_dzb100_parameter_is_never_written() -> None:
    assert effect("dzb100", dzb100.Dzb100WriteParameter(1, 80, 1)) is Effect.SETTING
    dialect = dialect_for("dzb100")
    data = dialect.codec.encode_request(dzb100.Dzb100WriteParameter(1, 80, 1)).replace(b"80", b"81", 1)
    assert dialect.station_config.effect_of(data) is Effect.MOTION
    assert not dialect.is_allowed(data)


def test_register_200b_of_vc660_is_never_written() -> None:
    assert effect("vc660", modbus.WriteRegister(1, 0x200B, 1)) is Effect.MOTION
    assert not lawful("vc660", modbus.WriteRegister(1, 0x200B, 1))


def test_virtual_inputs_of_vc660_may_be_wired_to_run_and_count_as_motion() -> None:
    for register in (0x2002, 0x2003, 0x2004, 0x2005):
        assert effect("vc660", modbus.WriteRegister(1, register, 1)) is Effect.MOTION
        assert lawful("vc660", modbus.WriteRegister(1, register, 1))
    assert effect("vc660", modbus.WriteRegister(1, 0x2006, 1)) is Effect.SETTING


def test_a_control_register_of_vc660_has_no_eeprom_address() -> None:
    for register in (0xA002, 0xA006, 0xA008):
        assert effect("vc660", modbus.WriteRegister(1, register, 1)) is Effect.MOTION
        assert not lawful("vc660", modbus.WriteRegister(1, register, 1))


@pytest.mark.parametrize("model", ["vc660", "df800"])
@pytest.mark.parametrize("register", [0x1000, 0x2010, 0x3000, 0x7FFF, 0xFFFF])
def test_an_unknown_register_is_never_written(model: str, register: int) -> None:
    assert effect(model, modbus.WriteRegister(1, register, 0)) is Effect.MOTION
    assert not lawful(model, modbus.WriteRegister(1, register, 0))


@pytest.mark.parametrize("model", ["vc660", "df800"])
def test_every_command_word_that_can_move_a_motor_is_motion(model: str) -> None:
    """All 65,536 words: what starts or jogs, or what no table names, is MOTION; a STOP has none of those bits."""
    dialect = dialect_for(model)
    assert isinstance(dialect, ModbusDialect) and dialect.command_word is not None
    moving = {"vc660": 0x0019, "df800": 0x0002}[model]
    unnamed = {"vc660": 0xFC00, "df800": 0xFFE0}[model]
    for word in range(0x10000):
        found = dialect.command_word.effect(word)
        if word & moving or word & unnamed:
            assert found is Effect.MOTION, hex(word)
        if found is Effect.STOP:
            assert not word & moving
        if word & unnamed:
            assert not dialect.command_word.is_mapped(word)


def test_the_direction_toggle_of_df800_is_in_no_command_map() -> None:
    for field in ("b3b2", "b2b3"):
        dialect = dialect_for("df800", direction_field=field)
        assert isinstance(dialect, ModbusDialect) and dialect.command_word is not None
        for run in (0, 1, 2):
            assert not dialect.command_word.is_mapped(0x000C | run)
            assert dialect.command_word.effect(0x000C | run) is Effect.MOTION


def test_start_12h_is_motion_on_df800() -> None:
    assert effect("df800", modbus.WriteRegister(1, 0x2000, 0x12)) is Effect.MOTION


def test_df800_starts_without_a_direction_and_stops_with_nothing_else() -> None:
    dialect = dialect_for("df800")
    assert [f.request.value for f in dialect.start(None, 0)] == [0x0002]
    assert [r.value for r in dialect.stop(StopMode.STOP)] == [0x0001]
    assert [f.request.value for f in dialect.reset()] == [0x0010]


@pytest.mark.parametrize(("field", "forward", "reverse"), [("b3b2", 0x0A, 0x06), ("b2b3", 0x06, 0x0A)])
def test_a_calibrated_df800_starts_in_the_direction_of_its_field(field: str, forward: int, reverse: int) -> None:
    dialect = dialect_for("df800", direction_field=field, direction_calibrated=True)
    assert dialect.start(Direction.FORWARD, 0)[0].request.value == forward
    assert dialect.start(Direction.REVERSE, 0)[0].request.value == reverse


def accept_word(dialect: Dialect, word: int) -> None:
    """Send a command word that the drive accepts."""
    request = modbus.WriteRegister(1, 0x2000, word)
    dialect.on_sent(request)
    dialect.on_accepted(request)


def word_effect(dialect: Dialect, word: int) -> Effect:
    return dialect.station_config.effect_of(dialect.codec.encode_request(modbus.WriteRegister(1, 0x2000, word)))


def test_the_levels_of_vc660_are_remembered_and_sent_with_each_pulse() -> None:
    dialect = dialect_for("vc660")
    words = [f.request.value for f in dialect.start(Direction.REVERSE, 0)]
    assert words == [0x0005, 0x0004]
    for value in words:
        dialect.on_sent(modbus.WriteRegister(1, 0x2000, value))
    assert [r.value for r in dialect.stop(StopMode.STOP)] == [0x0006, 0x0004]
    assert [r.value for r in dialect.stop(StopMode.COAST)] == [0x0024, 0x0004]
    assert [f.request.value for f in dialect.reset()] == [0x0204, 0x0004]


def test_a_level_word_that_would_turn_a_running_motor_round_is_motion() -> None:
    dialect = dialect_for("vc660")
    accept_word(dialect, 0x0001)
    accept_word(dialect, 0x0000)
    assert word_effect(dialect, 0x0004) is Effect.MOTION


def test_the_levels_after_a_start_are_a_setting_and_after_a_stop_a_stop() -> None:
    """A stop removes queued commands: a frame that completes a start must not remove its own start."""
    dialect = dialect_for("vc660")
    accept_word(dialect, 0x0001)
    assert word_effect(dialect, 0) is Effect.SETTING
    accept_word(dialect, 0x0002)
    assert word_effect(dialect, 0) is Effect.STOP


def read_status(dialect: Dialect, word: int) -> None:
    """Decode a status word of a VC660."""
    dialect.decode_readings(modbus.ReadRegisters(1, 0x3000, 1), modbus.RegisterValues(1, 3, (word,)), 0.0)


def test_the_levels_after_a_lost_stop_of_a_paused_drive_are_motion() -> None:
    """They end the pause: a drive that has missed the stop before them would run again."""
    dialect = dialect_for("vc660")
    read_status(dialect, 0x0029)
    dialect.on_sent(modbus.WriteRegister(1, 0x2000, 0x0002))
    assert word_effect(dialect, 0) is Effect.MOTION
    accept_word(dialect, 0x0002)
    assert word_effect(dialect, 0) is Effect.STOP


def test_the_levels_alone_are_motion_until_the_drive_has_shown_that_it_is_not_paused() -> None:
    dialect = dialect_for("vc660")
    assert word_effect(dialect, 0) is Effect.MOTION and word_effect(dialect, 0x0002) is Effect.STOP
    read_status(dialect, 0x0009)
    assert word_effect(dialect, 0) is Effect.STOP


def test_a_jog_stop_is_a_stop_whatever_reply_was_lost_before() -> None:
    dialect = dialect_for("vc660")
    dialect.on_sent(modbus.WriteRegister(1, 0x2000, 0x0080))
    dialect.on_sent(dialect.jog(Direction.FORWARD, None)[0].request)
    assert dialect.stop(StopMode.JOG_STOP)[0].value == 0 and word_effect(dialect, 0) is Effect.STOP


def test_a_pause_is_a_setting_and_a_ramp_hold_moves() -> None:
    dialect = dialect_for("vc660")
    read_status(dialect, 0x4009)
    assert dialect.hold(Hold.PAUSE).request.value == 0x0084 and dialect.hold(Hold.RAMP).request.value == 0x0104
    assert word_effect(dialect, 0x0084) is Effect.SETTING
    turned_round, with_stop, with_reset, both = 0x0080, 0x0086, 0x0284, 0x0184
    for word in (0x0104, turned_round, with_stop, with_reset, both):
        assert word_effect(dialect, word) is Effect.MOTION
    accept_word(dialect, 0x0104)
    assert dialect.end_hold().request.value == 0x0004 and word_effect(dialect, 0x0004) is Effect.MOTION
    assert [frame.request.value for frame in dialect.reset()] == [0x0304, 0x0104]
    assert word_effect(dialect, 0x0304) is Effect.SETTING
    accept_word(dialect, 0x0304)
    assert word_effect(dialect, 0x0104) is Effect.SETTING


@pytest.mark.parametrize("model", ["c320", "dzb100", "df800"])
def test_a_model_without_pause_or_ramp_hold_refuses_them(model: str) -> None:
    for hold in Hold:
        with pytest.raises(CapabilityError):
            dialect_for(model).hold(hold)
    with pytest.raises(CapabilityError):
        dialect_for("c320").end_hold()


def test_a_jog_released_is_a_stop() -> None:
    dialect = dialect_for("vc660")
    accept_word(dialect, dialect.jog(Direction.FORWARD, None)[0].request.value)
    released = dialect.stop(StopMode.JOG_STOP)
    assert [r.value for r in released] == [0]
    assert dialect.station_config.effect_of(dialect.codec.encode_request(released[0])) is Effect.STOP


def test_the_words_that_vc660_composes_are_all_known_and_none_pauses_or_holds() -> None:
    dialect = dialect_for("vc660")
    assert isinstance(dialect, ModbusDialect) and isinstance(dialect.command_word, CommandBits)
    word = dialect.command_word
    composed = [*word.start(None), *word.start(Direction.REVERSE), *word.jog(Direction.REVERSE), *word.reset("vc660")]
    for how in StopMode:
        composed += word.stop(how, "vc660")
    for value in composed:
        assert word.is_mapped(value)
        assert not value & 0x0180
        assert len(word.active_names(value) & {*MOTION_COMMANDS}) <= 1


@pytest.mark.parametrize("how", [StopMode.COAST, StopMode.QUICK_STOP])
def test_a_stop_that_a_model_lacks_is_refused_before_sending(how: StopMode) -> None:
    with pytest.raises(CapabilityError):
        dialect_for("dzb100").stop(how)
    with pytest.raises(CapabilityError):
        dialect_for("df800").stop(how)


@pytest.mark.parametrize(
    ("model", "request_"),
    [
        ("c320", sunfar.SunfarControl(31, sunfar.SunfarOperation.SET_FREQUENCY, 100)),
        ("vc660", modbus.WriteRegister(0, 2, 4000)),
        ("vc660", modbus.WriteRegister(0, 0x2000, 1)),
    ],
)
def test_no_broadcast_but_a_stop_is_allowed(model: str, request_: Any) -> None:
    """VC660's own example 4 writes a parameter to all drives: it is not allowed."""
    assert not lawful(model, request_)


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100"])
def test_the_broadcast_stop_is_a_stop(model: str) -> None:
    dialect = dialect_for(model)
    if model == "vc660":
        read_status(dialect, 0x0009)
    requests = dialect.broadcast_stop()
    assert requests
    for request in requests:
        assert dialect.station_config.effect_of(dialect.codec.encode_request(request)) is Effect.STOP
        assert dialect.codec.address_of(request) == dialect.codec.broadcast_address


def test_df800_has_no_broadcast_unless_a_profile_gives_one() -> None:
    assert dialect_for("df800").broadcast_stop() == ()


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100", "df800"])
def test_bytes_that_are_no_request_may_move(model: str) -> None:
    dialect = dialect_for(model)
    for data in (b"", b"\x00", b"*0", b"\x01\x06\x20\x00\x00\x02\x00\x00", bytes(11)):
        assert dialect.station_config.effect_of(data) is Effect.MOTION
