"""Frames of ``vectors/models/``: what a source's frame means is what the product sends or reads for it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.drives import create_dialect
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.status_word import status_direction, status_state
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import Direction
from drivebus.profiles.model import SETPOINT_STEP
from drivebus.protocols.codec import Complete, Effect
from drivebus.simulator.models.catalog import simulated_models
from drivebus.values import Quality
from verification.source_stations.drives import SOURCE_DRIVES

FOLDER = Path(__file__).parents[2] / "vectors" / "models"
LINES = [json.loads(line) for file in sorted(FOLDER.glob("*.jsonl")) for line in file.open(encoding="utf-8")]
BLIND = ("huanyang_gt", "mollom_g70", "spe_b", "svd_p", "vf51")
"""Models whose ten frames were written from the source before their profiles were read."""
UNCERTAIN = {"huanyang_gt-output-current-3"}
"""Readings that the product marks uncertain: the program multiplies by 1.0 for want of a published step."""
NOT_OFFERED = {
    "svd_p-output-current-3": "the program multiplies by 1.0 for want of a published step",
    "mollom_g70-register-f00c": "the program takes the upper limit F0-12 for the maximum; 10000 is F0-10 "
    "in this map, as in the manuals of SKF8000 and SV600 (page 187)",
    "mollom_g70-register-f00e": "the program reads the lower limit F0-14, which is no parameter of the profile",
}
"""Frames of programs that the product never sends, with the reason."""


def dialect_of(line: dict[str, Any]) -> Any:
    profile = profiles.load(line["model"])
    encoding = "rtu" if profile.family == "modbus" else None
    request = bytes.fromhex(line["request"])
    address = int(request[1:3]) if profile.family == "mitsubishi" else request[0]
    dialect = create_dialect(profile, address, encoding=encoding)
    if profile.setpoint_share is not None:
        dialect.set_option("maximum_frequency", line["meaning"].get("maximum_hz", 50.0))
    if SETPOINT_STEP in {question.name for question in profile.open_questions}:  # the frames are of this very model
        dialect.set_option(SETPOINT_STEP, f"{profile.setpoint_scale.factor:g}")
    return dialect


def frames_of(dialect: Any, frames: Any) -> list[bytes]:
    """Return the bytes of commands, which are requests or frames with one."""
    return [dialect.codec.encode_request(getattr(frame, "request", frame)) for frame in frames]


def command_frames(dialect: Any, name: str) -> list[bytes]:
    """Return what the product sends for a command, nothing where the profile does not offer it."""
    profile = dialect.profile
    if name.startswith("start_"):
        reverse = name == "start_reverse"
        if reverse and "reverse" not in profile.capabilities:
            return []
        direction = Direction.REVERSE if reverse else Direction.FORWARD if "reverse" in profile.capabilities else None
        return frames_of(dialect, dialect.start(direction, 0))
    if name.startswith("jog_") and "jog" not in profile.capabilities:
        return []
    if name in ("jog_forward", "jog_reverse"):
        return frames_of(dialect, dialect.jog(Direction[name.removeprefix("jog_").upper()], None))
    if name == "reset":
        return frames_of(dialect, dialect.reset()) if "reset_fault" in profile.capabilities else []
    modes = {"stop": StopMode.STOP, "coast": StopMode.COAST, "quick_stop": StopMode.QUICK_STOP}
    mode = StopMode.JOG_STOP if name == "jog_stop" else modes.get(name)
    if mode is None or mode.value not in profile.capabilities:
        return []
    return frames_of(dialect, dialect.stop(mode))


def decoded(codec: Any, line: dict[str, Any]) -> tuple[Any, Any]:
    """Return the messages of a request and its reply."""
    request = codec.decode_request(bytes.fromhex(line["request"]))
    assert isinstance(request, Complete)
    reply = codec.decode_reply(request.message, bytes.fromhex(line["reply"]))
    assert isinstance(reply, Complete)
    return request.message, reply.message


def readings_of(dialect: Any, line: dict[str, Any]) -> Any:
    return dialect.decode_readings(*decoded(dialect.codec, line), 1.0)


@pytest.mark.parametrize("line", [line for line in LINES if "command" in line["meaning"]], ids=lambda line: line["id"])
def test_a_command_is_the_frame_of_its_source(line: dict[str, Any]) -> None:
    """A command that the profile does not offer is never sent, and never taken for a stop."""
    dialect, frame = dialect_of(line), bytes.fromhex(line["request"])
    sent = command_frames(dialect, line["meaning"]["command"])
    if sent:
        assert frame in sent
    else:
        assert dialect.profile.family == "modbus"
        assert dialect.station_config.effect_of(frame) is not Effect.NONE
        assert not (
            line["meaning"]["command"].startswith(("start", "jog"))
            and dialect.station_config.effect_of(frame) is Effect.STOP
        )


@pytest.mark.parametrize(
    "line", [line for line in LINES if "setpoint_hz" in line["meaning"]], ids=lambda line: line["id"]
)
def test_a_frequency_is_the_word_of_its_source(line: dict[str, Any]) -> None:
    dialect = dialect_of(line)
    word = dialect.setpoint_word(line["meaning"]["setpoint_hz"])
    assert bytes.fromhex(line["request"]) in frames_of(dialect, dialect.set_frequency(word, ReadingPairs()))


@pytest.mark.parametrize("line", [line for line in LINES if "signal" in line["meaning"]], ids=lambda line: line["id"])
def test_a_reading_is_the_value_of_its_source(line: dict[str, Any]) -> None:
    readings, name = readings_of(dialect_of(line), line), line["meaning"]["signal"]
    assert (name not in readings) is (line["id"] in NOT_OFFERED)
    if name not in readings:
        return
    reading = readings[name]
    assert reading.value == pytest.approx(line["meaning"]["value"])
    assert (reading.quality is not Quality.GOOD) is (line["id"] in UNCERTAIN)


@pytest.mark.parametrize("line", [line for line in LINES if "state" in line["meaning"]], ids=lambda line: line["id"])
def test_a_state_is_that_of_its_source(line: dict[str, Any]) -> None:
    dialect = dialect_of(line)
    reading, status = readings_of(dialect, line)["state"], dialect.profile.status
    expected = line["meaning"]["state"]
    assert (reading.quality is Quality.BAD) is (expected is None)
    if expected is not None:
        state, direction = status_state(status, reading.raw), status_direction(status, reading.raw)
        name = f"{state.value}_{direction.value}" if direction and state.turning else state.value
        assert name == expected


@pytest.mark.parametrize("line", [line for line in LINES if "fault" in line["meaning"]], ids=lambda line: line["id"])
def test_a_fault_is_the_number_of_its_source(line: dict[str, Any]) -> None:
    dialect = dialect_of(line)
    readings = readings_of(dialect, line)
    ((_, reading),) = [(name, reading) for name, reading in readings.items() if name.startswith("fault_")]
    status = dialect.profile.status
    number = status.fault_number(reading.raw) if status.numbers_fault else (reading.raw & -reading.raw).bit_length() - 1
    assert number == line["meaning"]["fault"]


@pytest.mark.parametrize(
    "line", [line for line in LINES if {"register", "parameter"} & set(line["meaning"])], ids=lambda line: line["id"]
)
def test_a_parameter_is_the_value_of_its_source(line: dict[str, Any]) -> None:
    dialect, meaning = dialect_of(line), line["meaning"]
    parameters = dialect.profile.parameters.values()
    found = [parameter for parameter in parameters if parameter.notation == meaning.get("parameter")]
    found += [parameter for parameter in parameters if parameter.locator == ("holding", meaning.get("register"))]
    assert (not found) is (line["id"] in NOT_OFFERED)
    if not found:
        return
    assert dialect.codec.encode_request(dialect.read_parameter(found[0])) == bytes.fromhex(line["request"])
    _, reply = decoded(dialect.codec, line)
    assert found[0].scale.value(dialect.parameter_raw(reply)) == pytest.approx(meaning["value"])


@pytest.mark.parametrize("line", [line for line in LINES if "writes" in line["meaning"]], ids=lambda line: line["id"])
def test_a_write_of_command_and_frequency_at_once_counts_as_motion(line: dict[str, Any]) -> None:
    dialect = dialect_of(line)
    message, reply = decoded(dialect.codec, line)
    assert {str(message.register + n): word for n, word in enumerate(message.values)} == line["meaning"]["writes"]
    assert reply.register == message.register
    assert dialect.station_config.effect_of(bytes.fromhex(line["request"])) is Effect.MOTION


@pytest.mark.parametrize("line", LINES, ids=lambda line: line["id"])
def test_each_worked_frame_names_its_model_its_source_and_whether_it_was_printed(line: dict[str, Any]) -> None:
    assert set(line) <= {"id", "model", "request", "reply", "meaning", "printed", "source"}
    assert line["id"].startswith(line["model"]) and [other["id"] for other in LINES].count(line["id"]) == 1
    assert line["source"].startswith(("manual", "sister manual", "program", "recorded", "gist"))
    assert line["printed"] or "computed" in line["source"] or line["model"] == "fr_e500"


@pytest.mark.parametrize("model", BLIND)
def test_a_blind_check_has_ten_frames(model: str) -> None:
    assert len([line for line in LINES if line["model"] == model]) == 10


def test_the_higher_grade_needs_frames_and_a_station_of_its_own() -> None:
    graded = {name for name in profiles.models() if profiles.load(name).grade == "simulated"}
    simulated = set(simulated_models()) | set(SOURCE_DRIVES)
    framed = {line["model"] for line in LINES if line["model"] not in BLIND}
    framed |= {file.stem for file in FOLDER.parent.glob("*.jsonl")}
    assert graded <= simulated & framed, graded - (simulated & framed)
    assert len(graded - {"c320", "dzb100", "vc660", "df800"}) >= 12
