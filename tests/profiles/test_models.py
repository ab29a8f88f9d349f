"""The built-in profiles agree with the manuals and the vectors."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.drives.state import join_fault_after_word
from drivebus.profiles import notation
from drivebus.profiles.model import DriveProfile, Evidence
from drivebus.profiles.spaces import READ_FUNCTION_BY_SPACE
from drivebus.serial_settings import SerialSettings
from drivebus.values import Text
from fixtures.drives import writable_registers

MODELS = ("c320", "dzb100", "vc660", "df800", "c300", "e300", "e350", "e500", "e550")
DRAFTS = ("c300", "e300", "e350", "e500", "e550")
VECTORS = Path(__file__).parents[2] / "vectors"


def texts(value: Any) -> list[Text]:
    """Every Text inside a profile, without the sources of its facts, which may be names and numbers alone."""
    if isinstance(value, Text):
        return [value]
    if isinstance(value, Evidence):
        return []
    if isinstance(value, dict):
        return [text for inner in value.values() for text in texts(inner)]
    if isinstance(value, tuple):
        return [text for inner in value for text in texts(inner)]
    names = getattr(value, "__dataclass_fields__", {})
    return [text for name in names for text in texts(getattr(value, name))]


@pytest.mark.parametrize("model", MODELS)
def test_every_sentence_of_a_profile_is_there_in_chinese(model: str) -> None:
    everything = texts(profiles.load(model))
    assert len(everything) > 20
    plain = {"1200", "2400", "4800", "9600", "300", "600", "19200", "38400", "RS485", "F1.00", "8N1 ASCII", "8N1 RTU"}
    for text in everything:
        chinese = any("一" <= character <= "鿿" for character in text.zh)
        assert chinese or text.zh in plain | {"2001H", "MODBUS RTU"}, text
        assert not any("一" <= character <= "鿿" for character in text.en), text


@pytest.mark.parametrize("model", profiles.models())
def test_every_kind_of_wire_address_has_its_word(model: str) -> None:
    """``drivebus read`` printed the key of the missing word for a Huanyang HY and for ``coil:0049H``."""
    profile = profiles.load(model)
    spaces = {item.locator[0] for item in (*profile.signals.values(), *profile.parameters.values())}
    if profile.family == "modbus":  # every register, input and coil can be read by its address
        spaces |= set(READ_FUNCTION_BY_SPACE)
    assert spaces and all(i18n.known(f"read.space_{space}") for space in spaces)


@pytest.mark.parametrize("model", MODELS)
def test_every_claim_has_its_evidence_and_its_place(model: str) -> None:
    profile = profiles.load(model)
    claims = [*profile.signals.values(), *profile.parameters.values(), *profile.caveats]
    for evidence in [claim.evidence for claim in claims] + list(profile.evidence.values()):
        assert evidence.kind in ("manual", "computed", "sister", "assumed")
        assert evidence.source.en or evidence.kind in ("assumed", "computed")


@pytest.mark.parametrize("model", DRAFTS)
def test_a_draft_claims_nothing_from_the_manual_of_another_model(model: str) -> None:
    profile = profiles.load(model)
    assert profile.grade == "draft"
    assert not profile.preconditions and not profile.faults
    claims = [*profile.signals.values(), *profile.parameters.values()]
    assert {claim.evidence.kind for claim in claims} <= {"sister", "assumed"}
    assert profile.evidence["comm_loss"].kind in ("sister", "assumed")
    assert any(caveat.id == "draft" for caveat in profile.caveats)


def test_the_sisters_differ_in_frequency_step_and_monitor_table() -> None:
    steps = {model: profiles.load(model).setpoint_scale.factor for model in ("c320", *DRAFTS)}
    assert steps == {"c320": 0.01, "c300": 0.01, "e300": 0.1, "e350": 0.1, "e500": 0.1, "e550": 0.1}
    first = {model: notation.find_entry(profiles.load(model), "d.1").text.en for model in ("c320", "c300", "e300")}
    assert first == {"c320": "output voltage", "c300": "output current", "e300": "output current"}
    assert {m for m in ("c320", *DRAFTS) if "set_frequency" in profiles.load(m).signals} == {"e300", "e500", "e550"}
    selectors = {model: profiles.load(model).roles.get("monitor_selector") for model in ("c320", *DRAFTS)}
    assert selectors == {"c320": "F6.12", "c300": None, "e300": None, "e350": None, "e500": "F3.08", "e550": None}
    assert dict(profiles.load("e550").roles) == {"protocol": "F4.00"}


def test_the_step_of_the_e350_is_assumed_so_that_a_wrong_one_is_slower() -> None:
    """C320 manual 1.2.1 names the E350; no source says its step."""
    profile = profiles.load("e350")
    assert profile.evidence["setpoint"].kind == "assumed" and profile.options["setpoint_step"] == "unknown"
    assert profile.setpoint_scale.factor == max(profiles.load(model).setpoint_scale.factor for model in DRAFTS)


def test_a_silent_hosts_parameters_are_those_of_each_models_own_manual() -> None:
    """C320 manual 2.2.4 (3): time and action. Only the E300's publishes the action's values and the time's unit."""
    known = {model: profiles.load(model).comm_loss for model in MODELS}
    named = {model: (loss.time_notation, loss.action_notation) for model, loss in known.items() if loss.time_notation}
    assert named == {"c320": ("F9.4", "F9.3"), "e300": ("F4.4", "F4.3"), "e550": ("F4.04", "F4.03")}
    assert {model: loss.trips_values for model, loss in known.items() if loss.trips_values} == {"e300": (0, 1)}


@pytest.mark.parametrize(
    ("model", "raw", "hertz"),
    [("c320", 0x03E7, 9.99), ("c300", 0x1772, 60.02), ("e500", 0x01F4, 50.0), ("e550", 0x0064, 10.0)],
)
def test_the_frequency_step_is_that_of_the_worked_frame(model: str, raw: int, hertz: float) -> None:
    """Vectors c320-4.2, c320-sib-write-ram, c320-sib-reply, c320-sib-control."""
    scale = profiles.load(model).setpoint_scale
    assert scale.value(raw) == hertz
    assert scale.raw(hertz) == raw


def test_timing_is_the_manuals_where_it_gives_one() -> None:
    line = SerialSettings.parse(9600, "8E1")
    c320 = profiles.load("c320").timing
    assert c320.gap_s(line) == pytest.approx(5 * 11 / 9600)
    assert c320.timeout_s(line, 18) == pytest.approx((8 + 18) * 11 / 9600 + c320.adapter_latency_s)
    slowest = SerialSettings.parse(1200, "8E1")
    assert c320.max_reply_lateness_s >= slowest.seconds(8) + 0.1
    vc660 = profiles.load("vc660").timing
    assert vc660.gap_s(SerialSettings.parse(38400, "8N1")) == 0.00175
    assert vc660.gap_s(SerialSettings.parse(19200, "8N1")) == pytest.approx(3.5 * 10 / 19200)
    assert (vc660.reply_delay_s, vc660.max_reply_lateness_s) == (0.024, 0.204)
    for model in ("dzb100", "df800"):
        timing = profiles.load(model).timing
        assert (timing.reply_delay_s, timing.max_reply_lateness_s) == (0.1, 0.5)
        assert profiles.load(model).evidence["timing"].kind == "assumed"


def test_each_precondition_accepts_only_the_setting_for_commands_from_the_bus() -> None:
    found = {
        model: {p.notation: p.accepted for p in profiles.load(model).preconditions}
        for model in ("c320", "dzb100", "vc660", "df800")
    }
    assert found == {
        "c320": {"F0.1": (2,)},
        "dzb100": {"00": (2,), "01": (3,)},
        "vc660": {"F00.01": (4,), "F01.00": (2,)},
        "df800": {"F1.01": (5,), "F1.02": (2,)},
    }


def test_a_precondition_that_can_not_be_read_names_what_to_supply() -> None:
    conditions = {p.notation: p for p in profiles.load("vc660").preconditions}
    assert conditions["F00.01"].unreadable is None
    missing = conditions["F01.00"].unreadable
    assert missing is not None and "F00" in missing.en and "[group_sizes]" in missing.zh
    assert "F01.00" in profiles.load("vc660").unplaced


@pytest.mark.parametrize("model", MODELS)
def test_what_can_be_read_of_the_preconditions_is_a_listed_parameter(model: str) -> None:
    profile = profiles.load(model)
    for condition in profile.preconditions:
        assert (condition.notation in profile.parameters) == (condition.unreadable is None)


def test_addresses_and_broadcast_never_meet() -> None:
    """Address 0 of DZB100 and VC660, and 31 of C320, answer nothing."""
    found = {model: (p.addresses, p.broadcast) for model in MODELS[:4] if (p := profiles.load(model))}
    assert found == {
        "c320": ((0, 30), 31),
        "dzb100": ((1, 31), 0),
        "vc660": ((1, 247), 0),
        "df800": ((1, 247), None),
    }


def test_vc660_commands_are_the_control_table() -> None:
    commands = profiles.load("vc660").commands
    assert commands is not None
    assert {name for name, bit in commands.bits.items() if bit.pulse} == {
        "start",
        "stop",
        "coast",
        "quick_stop",
        "reset",
    }
    values = {name: bit.value for name, bit in commands.bits.items()}
    assert values == {
        "start": 1,
        "stop": 2,
        "forward": 0,
        "reverse": 4,
        "jog_forward": 8,
        "jog_reverse": 16,
        "jog_stop": 0,
        "coast": 32,
        "quick_stop": 64,
        "pause": 128,
        "hold_ramp": 256,
        "reset": 512,
    }
    assert commands.rewrite_levels_after_pulse


def test_vc660_may_write_exactly_what_its_tables_mark_as_writable() -> None:
    eeprom_forms = {0x8001, 0x8002}
    assert writable_registers(profiles.load("vc660")) == {1, 2, *range(0x2000, 0x200A)} | eeprom_forms


def test_vc660_status_word_has_its_reserved_bits() -> None:
    status = profiles.load("vc660").status
    assert status is not None
    assert status.reserved_mask == sum(1 << bit for bit in range(9, 14))
    assert status.fault_registers == (0x3016, 0x3017)
    assert status.bits["running"] == 1 << 3 and status.bits["output_reverse"] == 1 << 15


def test_vc660_has_the_factory_settings_of_its_manual() -> None:
    """F01.00 had none. Its 0 is why a drive fresh from the box takes no command from the bus."""
    manual = {"F00.01": 2, "F01.00": 0, "F06.02": 0, "F06.03": 0, "F06.04": 5, "F06.05": 0, "F06.06": 4, "F06.07": 0}
    vc660 = profiles.load("vc660")
    parameters = [*vc660.parameters.values(), *(unplaced.parameter for unplaced in vc660.unplaced.values())]
    assert {
        parameter.notation: parameter.factory for parameter in parameters if parameter.factory is not None
    } == manual


def test_vc660_status_registers_read_as_the_worked_example() -> None:
    """Vector vc660-status-response: 50.00 Hz, 39.98 Hz, 12.8 A."""
    signals = profiles.load("vc660").signals
    raw = (0x1388, 0x0F9E, 0x0080)
    names = ("set_frequency", "output_frequency", "output_current")
    assert [signals[n].scale.value(r) for n, r in zip(names, raw, strict=True)] == [50.0, 39.98, 12.8]
    assert [signals[n].locator[1] for n in names] == [0x3001, 0x3002, 0x3003]


VC660_STATUS = """
3000 - 1 | 3001 Hz 0.01 | 3002 Hz 0.01 | 3003 A 0.1 | 3004 V 0.1 | 3005 kW 0.01 | 3006 V 1 | 3007 - 1 | 3008 - 1
3009 V 0.01 | 300A mA 0.01 | 300B °C 1 | 300C rpm 1 | 3014 - 1 | 3015 - 1 | 3016 - 1 | 3017 - 1 | 3018 - 1
"""
"""Manual section 5, status registers: address, unit and step. What it marks as reserved (300D-3013) is not there."""


def test_vc660_status_registers_are_the_manuals_table() -> None:
    rows = [row.split() for row in VC660_STATUS.replace("\n", "|").split("|") if row.strip()]
    table = {(int(register, 16), "" if unit == "-" else unit, float(step)) for register, unit, step in rows}
    signals = profiles.load("vc660").signals.values()
    assert {(each.locator[1], each.unit, each.scale.factor) for each in signals} == table


def test_dzb100_parameter_77_counts_its_baud_rates_from_1200() -> None:
    profile = profiles.load("dzb100")
    assert [text.en for _, text in sorted(profile.parameters["77"].choices.items())] == ["1200", "2400", "4800"]
    assert list(profile.serial.bauds) == [1200, 2400, 4800]


def test_vc660_f06_04_counts_its_baud_rates_from_300(tmp_path: Path) -> None:
    sizes = "\n".join(f"F{group:02d} = 10" for group in range(7))
    own = tmp_path / "sized.toml"
    own.write_text(f'format = 1\nextends = "vc660"\nmodel = "sized"\n[group_sizes]\n{sizes}\n', encoding="utf-8")
    choices = profiles.load(own).parameters["F06.04"].choices
    bauds = [300, 600, 1200, 2400, 4800, 9600, 19200, 38400]
    assert {raw: (text.en, text.zh) for raw, text in choices.items()} == {
        raw: (str(baud), str(baud)) for raw, baud in enumerate(bauds)
    }


@pytest.mark.parametrize(
    ("model", "factory"), [("c320", "9600 8E1"), ("dzb100", "4800 8E1"), ("vc660", "9600 8N1"), ("df800", "9600 8N1")]
)
def test_a_drive_fresh_from_the_box_is_spoken_to_on_its_factory_line(model: str, factory: str) -> None:
    line = profiles.load(model).serial
    assert f"{line.baud} {line.format}" == factory


@pytest.mark.parametrize(
    ("model", "bauds", "formats"),
    [
        ("c320", "1200 2400 4800 9600 19200", "8N1 8E1 8O1"),
        ("dzb100", "1200 2400 4800", "8E1 8O1"),
        ("vc660", "300 600 1200 2400 4800 9600 19200 38400", "8N1 8O1 8E1"),
    ],
)
def test_the_lines_that_a_keypad_can_choose_are_the_manuals(model: str, bauds: str, formats: str) -> None:
    line = profiles.load(model).serial
    assert (line.bauds, line.formats) == (tuple(map(int, bauds.split())), tuple(formats.split()))


@pytest.mark.parametrize(
    ("model", "lowest", "highest"), [("df800", 0.0, 400.0), ("dzb100", 0.0, 400.0), ("c320", 0.0, 50.0)]
)
def test_frequency_limits_are_the_manuals_or_a_50_hz_motors(model: str, lowest: float, highest: float) -> None:
    limits = profiles.load(model).limits
    assert (limits.minimum_hz, limits.maximum_hz) == (lowest, highest)


def test_c320_monitors_are_those_that_its_manual_or_a_sisters_names() -> None:
    signals = profiles.load("c320").signals
    assert {name: (each.locator, each.unit) for name, each in signals.items()} == {
        "output_frequency": (("monitor", 0), "Hz"),
        "output_voltage": (("monitor", 1), "V"),
        "dc_bus_voltage": (("monitor", 4), "V"),
        "pulse_input": (("monitor", 15), ""),
        "last_fault_temperature": (("monitor", 37), "°C"),
    }


def test_vc660_publishes_only_bit_0_of_its_fault_words() -> None:
    profile = profiles.load("vc660")
    assert profile.fault(0).text.en == "under-voltage"
    other = profile.fault(17)
    assert other.label == ""  # the keypad shows none, and a label is the same in every language
    assert other.text.en.startswith("fault bit 17, not published") and other.text.zh.startswith("故障位 17，")


@pytest.mark.parametrize(("setting", "forward", "reverse"), [("b3b2", 0x8, 0x4), ("b2b3", 0x4, 0x8)])
def test_df800_direction_depends_on_the_open_setting(setting: str, forward: int, reverse: int) -> None:
    """The direction field is never 11, which toggles."""
    commands = profiles.load("df800").commands
    assert commands is not None and "forward" not in commands.bits
    bits = commands.resolved({"direction_field": setting}).bits
    assert (bits["forward"].value, bits["reverse"].value) == (forward, reverse)
    assert (bits["jog_forward"].value, bits["jog_reverse"].value) == (forward | 3, reverse | 3)
    assert all(bit.value & 0xC != 0xC for bit in bits.values())


def test_df800_start_and_stop_are_those_of_the_worked_frames() -> None:
    commands = profiles.load("df800").commands
    assert commands is not None
    assert (commands.bits["start"].value, commands.bits["stop"].value, commands.bits["reset"].value) == (2, 1, 0x10)
    assert (commands.register, commands.setpoint_register) == (0x2000, 0x2001)


def test_df800_claims_no_status_and_no_scale_for_its_monitors() -> None:
    profile = profiles.load("df800")
    assert profile.status is None and "status" not in profile.capabilities
    assert {s.uncertain for s in profile.signals.values()} == {"profiles.scale_unpublished"}
    assert i18n.text("profiles.scale_unpublished", "zh") != "profiles.scale_unpublished"
    assert profile.modbus is not None
    assert (profile.modbus.error_form, profile.modbus.max_read) == ("short", 4)


def test_dzb100_faults_carry_the_keypads_labels() -> None:
    profile = profiles.load("dzb100")
    labels = [profile.faults[code].label for code in range(1, 19)]
    assert labels == [
        "E009",
        "E00A",
        "E00E",
        "E008",
        "E007",
        "E00D",
        "E012",
        "E015",
        "E014",
        "E004",
        "E006",
        "E005",
        "E017",
        "E001",
        "E001",
        "CF2",
        "E016",
        "E013",
    ]
    assert profile.fault(14).text.zh == "低电压"
    assert "42" in profile.fault(42).text.en


def test_c320_fault_codes_carry_the_keypads_label() -> None:
    assert profiles.load("c320").fault(12).label == "Fu.12"


def test_dzb100_codings_start_undetermined() -> None:
    settings = profiles.load("dzb100").options
    assert {settings[f"{what}_coding"] for what in ("setpoint", "query", "parameter")} == {"unknown"}


TRAPS = {
    "c320": {"T01", "T02", "T03", "T04", "T05", "T06", "T07", "T21"},
    "dzb100": {"T08", "T09", "T10", "T11", "T20"},
    "vc660": {"T12", "T13", "T14"},
    "df800": {"T15", "T16", "T17"},
}


@pytest.mark.parametrize("model", TRAPS)
def test_the_traps_of_a_manual_are_the_caveats_of_its_model(model: str) -> None:
    assert {caveat.id for caveat in profiles.load(model).caveats} >= TRAPS[model]


@pytest.mark.parametrize("model", MODELS)
def test_every_open_question_has_default_reason_and_a_way_to_settle_it(model: str) -> None:
    profile = profiles.load(model)
    assert profile.open_questions
    for question in profile.open_questions:
        assert question.reason.en and question.procedure.en
        assert (question.name in profile.options) == (question.where is None)


@pytest.mark.parametrize("model", profiles.models())
def test_the_words_that_an_open_question_assumes_are_in_both_languages(model: str) -> None:
    """Regression: Chinese pages of Lenze drives said "refused until unlocked"."""
    for question in profiles.load(model).open_questions:
        if isinstance(question.value, Text):
            assert question.value.en != question.value.zh
        elif question.where is not None:
            assert not re.search("[a-z]", str(question.value)), question


def parameter_vectors() -> list[tuple[str, dict[str, Any]]]:
    lines = [line for path in sorted(VECTORS.glob("*.jsonl")) for line in path.read_text().splitlines()]
    return [
        (v["id"], v) for v in map(json.loads, lines) if "parameter" in v["fields"] and v["fields"].get("accepted", True)
    ]


@pytest.mark.parametrize(
    ("name", "vector"), parameter_vectors(), ids=lambda value: value if isinstance(value, str) else ""
)
def test_the_address_of_a_worked_frame_is_that_of_the_parameter_it_names(name: str, vector: dict[str, Any]) -> None:
    fields = vector["fields"]
    profile: DriveProfile = profiles.load(vector["model"])
    if vector["model"] == "dzb100":
        assert notation.parse_notation(f"{fields['parameter']:02d}", profile.notation) == (
            "parameter",
            fields["parameter"],
        )
    elif vector["model"] == "c320":
        locator = notation.parse_notation(fields["parameter"], profile.notation)
        assert locator == ("parameter", fields["group"] << 8 | fields["item"])
    else:
        assert notation.parse_notation(fields["parameter"], profile.notation) == ("holding", fields["register"])


def test_a_fault_that_is_not_described_still_has_its_number_in_both_languages() -> None:
    bare = replace(profiles.load("vc660"), faults={}, fault_text=None, fault_label="")
    assert (bare.fault(5).text.en, bare.fault(5).text.zh) == (
        "fault 5, not described in the manual",
        "故障 5，手册未说明",
    )


@pytest.mark.parametrize("name", profiles.models())
def test_a_fault_is_named_once_behind_the_word_fault(name: str) -> None:
    """Regression: "F251 fault 251 of the drive's fault table", "Fault: fault Fu.12", "OVERCURRENT overcurrent"."""
    profile = profiles.load(name)
    for fault in (profile.fault(code) for code in (*profile.faults, 251)):
        for language, text in fault.text.by_language().items():
            shown = join_fault_after_word(fault.label, text)
            words = shown.casefold().split()
            assert words.count("251") <= 1 and len(re.findall(r"251(?!\d)", shown)) <= 1, (language, shown)
            assert len(words) == 1 or words[0] != words[1], shown
            assert not re.match(r"(fault|故障) ?[A-Z]*\.?\d", shown), shown


@pytest.mark.parametrize("name", profiles.models())
def test_no_reading_or_fault_of_an_included_model_stands_without_its_source(name: str) -> None:
    """A fault without evidence counts as the user's own."""
    profile = profiles.load(name)
    named = {f"fault {code}": fault.evidence for code, fault in profile.faults.items()}
    named |= {signal.name: signal.evidence for signal in profile.signals.values()}
    for what, evidence in named.items():
        assert evidence is not None and evidence.kind != "user", f"{what}: name the manual or program as its evidence"


@pytest.mark.parametrize("model", profiles.models())
def test_a_measured_value_is_not_read_as_a_fault_number(model: str) -> None:
    """Regression: 2110 is the fault of a Vacon 10 and the DC link voltage of a Vacon 20, shown as fault 540."""
    profile = profiles.load(model)
    measured = {signal.locator[1]: name for name, signal in profile.signals.items() if signal.unit}
    faults = profile.status.fault_registers if profile.status else ()
    assert not {measured[register] for register in faults if register in measured}


@pytest.mark.parametrize("model", [name for name in profiles.models() if "P00.11" in profiles.load(name).parameters])
def test_a_goodrive_whose_manual_gives_the_ramp_times_reads_them_before_a_run(model: str) -> None:
    profile = profiles.load(model)
    sister_only = {"gd100", "galt_g200"}  # their manuals were not read: a rejected read would say nothing
    assert profile.ramp_notations == (None if model in sister_only else ("P00.11", "P00.12"))


RANGES_OF_NO_MANUAL = (
    ("c320", "F0.2"),
    ("c320", "F1.10"),
    ("c320", "F6.12"),
    ("dzb100", "10"),
    ("dzb100", "23"),
    ("df800", "F1.00"),
    ("df800", "F1.07"),
    ("df800", "F1.08"),
    ("df800", "F7.02"),
    ("vc660", "F00.02"),
)


@pytest.mark.parametrize(("model", "parameter"), RANGES_OF_NO_MANUAL)
def test_a_range_that_no_manual_gives_is_not_shown_as_the_manuals(model: str, parameter: str) -> None:
    """The manual has a value in an example and no limits: those are what the 16 bits hold, or assumed."""
    source = profiles.load(model).parameters[parameter].evidence.source
    assert re.search("range .*(not published|assumed)", source.en) and re.search("范围.*(未公布|假定)", source.zh)


@pytest.mark.parametrize(
    ("model", "question"),
    [("c320", "emergency_end"), ("dzb100", "run_command"), ("dzb100", "fault_record"), ("df800", "jog_end")],
)
def test_what_the_manual_leaves_open_and_drivebus_assumes_is_an_open_question(model: str, question: str) -> None:
    assert question in {open_question.name for open_question in profiles.load(model).open_questions}


def test_the_nibble_option_does_not_call_the_checksum_of_example_4_5_packed() -> None:
    """Vector c320-4.5-request-hex: the sum 12H is printed 00 00 01 02. Only that of 4.6 is packed."""
    vectors = [json.loads(line) for line in (VECTORS / "c320.jsonl").read_text(encoding="utf-8").splitlines()]
    printed = {vector["id"]: bytes.fromhex(vector["hex"]) for vector in vectors}
    assert printed["c320-4.5-request-hex"][-5:-1] == bytes((0, 0, 1, 2))
    assert sum(printed["c320-4.5-request-hex"][1:-5]) == 0x12
    assert sum(printed["c320-4.6-request-hex"][1:-5]) == printed["c320-4.6-request-hex"][-2] == 0x1E
    for model in ("c320", "e550"):
        question = next(question for question in profiles.load(model).open_questions if question.name == "nibble")
        assert (
            "4.5 is nibbles to its checksum" in question.reason.en
            and "4.5 的请求连校验和也是半字节" in question.reason.zh
        )


def test_the_first_digit_of_q03_is_the_run_command_in_both_languages() -> None:
    """DZB100 note 2.2 (5): 运转命令. The English text called it an echo."""
    text = profiles.load("dzb100").signals["state"].text
    assert text.en.startswith("run command") and text.zh.startswith("运转命令")


def test_a_frequency_that_the_guide_does_not_name_is_not_given_a_name() -> None:
    """VC660 guide, part 6: F00.02 is written as 30.00 and 40.00 and named nowhere."""
    profile = profiles.load("vc660")
    for parameter in ("F00.00", "F00.02"):
        text = profile.parameters[parameter].text
        assert "not named in the guide" in text.en and "指南未命名" in text.zh


@pytest.mark.parametrize(("model", "delay"), [("e300", "F4.2"), ("e550", "F4.02")])
def test_what_keeps_a_related_model_silent_is_among_its_keypad_settings(model: str, delay: str) -> None:
    """E300 manual page 36, E550 manual page 61: protocol, reply delay and, on the E550, replies switched off."""
    english = " ".join(text.en for text in profiles.load(model).keypad)
    assert "third digit 0" in english and f"{delay}: reply delay, 0 to 1000 ms" in english
    assert ("sends no replies" in english) is (model == "e550")


@pytest.mark.parametrize(("model", "notation"), [("vc660", "F06.06"), ("e300", "F4.2"), ("e550", "F4.02")])
def test_a_drive_with_a_longer_reply_delay_is_called_late_and_not_silent(model: str, notation: str) -> None:
    """``status`` names its replies as late."""
    [step] = [step for step in profiles.load(model).keypad if step.en.startswith(notation)]
    assert "too late" in step.en and "silent" not in step.en
    assert "迟到" in step.zh and "无应答" not in step.zh
