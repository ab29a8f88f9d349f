"""Texts for users: values with the decimals of the keypad, outcomes, tables that fit the terminal."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.cli import output
from drivebus.cli import output as text_layout
from drivebus.cli.errors import ExitCode
from drivebus.cli.formatting import fault_text, format_reading, format_value, outcome_text, status_text
from drivebus.cli.output import format_duration
from drivebus.cli.scan_output import ScanProgressBar, assumed_models_texts, print_scan
from drivebus.commissioning.scan import DetectedDrive, ScanProgress, SniffResult
from drivebus.drives.dialects.base import Identity
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.state import DriveState, DriveStatus, Fault
from drivebus.errors import HeaderError
from drivebus.serial_settings import SerialSettings
from drivebus.values import Quality, Reading, Text, missing_reading

VC660 = profiles.load("vc660")


@pytest.mark.parametrize(
    ("signal", "value", "shown"),
    [
        ("output_frequency", 25.0, "25.00 Hz"),
        ("output_current", 2.5, "2.5 A"),
        ("dc_bus_voltage", 537.0, "537 V"),
        ("set_speed", None, "–"),
    ],
)
def test_a_value_has_the_decimals_of_its_scale(signal: str, value: Any, shown: str) -> None:
    entry = VC660.signals[signal]
    assert format_value(value, entry.unit if value is not None else "", entry) == shown


def test_a_value_finer_than_its_scale_is_not_rounded() -> None:
    assert format_value(0.25, "V", VC660.signals["dc_bus_voltage"]) == "0.25 V"


def test_a_word_of_bits_is_also_shown_in_hexadecimal() -> None:
    reading = Reading(value=10.0, unit="", raw=10)
    assert format_reading(reading, VC660.signals["input_terminals"]) == "10 (000AH)"
    assert format_reading(missing_reading("drives.no_answer"), VC660.signals["input_terminals"]) == "–"


@pytest.mark.parametrize(
    ("status", "key"),
    [
        (OutcomeStatus.CONFIRMED, "outcome.confirmed"),
        (OutcomeStatus.ACKNOWLEDGED, "outcome.acknowledged"),
    ],
)
def test_an_outcome_begins_with_its_own_status_in_words(status: OutcomeStatus, key: str) -> None:
    text = outcome_text(Outcome(status=status, key="drives.stop_confirmed"))
    assert text == i18n.text(key, text=i18n.text("drives.stop_confirmed"))


def test_an_outcome_is_printed_once_with_further_notes_below() -> None:
    params = {"notation": "F1.10", "value": 1, "unit": ""}
    notes: Any = (("drives.write_confirmed", params), ("drives.disagree", {}))
    outcome = Outcome(status=OutcomeStatus.CONFIRMED, key="drives.write_confirmed", params=params, notes=notes)
    text = outcome_text(outcome)
    assert text.startswith("Confirmed: ")
    assert text.count("F1.10") == 1
    assert len(text.splitlines()) == 2


@pytest.mark.parametrize(
    ("language", "bits"),
    [
        ("en", "bits that are set: ready, running, emergency stop under way"),
        ("zh", "置位的位：变频器就绪、运行中、紧急停车过程中"),
    ],
)
def test_the_status_word_names_its_bits(language: str, bits: str) -> None:
    output.parse_global_options(["--lang", language])
    readings = {"state": Reading(value=25.0, raw=0x0019, source_time=1.0)}
    assert bits in status_text(DriveStatus(state=DriveState.DECELERATING, readings=readings), 2.0, VC660)
    status = DriveStatus(state=DriveState.STOPPED, readings={"state": Reading(value=0.0, raw=0, source_time=1.0)})
    assert bits.partition(" ready")[0].partition("变频器")[0] not in status_text(status, 2.0, VC660)


def test_signals_have_a_chinese_meaning_beside_their_name() -> None:
    output.parse_global_options(["--lang", "zh"])
    status = DriveStatus(
        state=DriveState.STOPPED, readings={"dc_bus_voltage": Reading(value=537.0, unit="V", source_time=1.0)}
    )
    page = status_text(status, 2.0, VC660)
    assert "dc_bus_voltage" in page and "母线电压" in page and "537 V" in page


def test_a_reply_that_is_not_accepted_stands_beside_the_state_with_its_remedy() -> None:
    """Through a service a status is no error, and the remedy that the unconfirmed stop refers to was missing."""
    stray = HeaderError("bus.stray_before", station=1, count=1, bytes="00")
    unknown = DriveStatus(state=DriveState.UNKNOWN, reason="drives.no_answer", unusable_reply=stray)
    remedy = i18n.text("hint.bus.stray_before")
    assert " ".join(remedy.split()) in " ".join(status_text(unknown, 2.0, VC660).split())
    assert remedy[:20] not in status_text(replace(unknown, unusable_reply=None), 2.0, VC660)


def test_a_warning_stands_beside_the_state_with_its_bits() -> None:
    readings = {"warning_word": Reading(value=33.0, raw=0x0021, quality=Quality.GOOD)}
    page = status_text(DriveStatus(state=DriveState.STOPPED, readings=readings), 2.0, VC660)
    assert "bits set in the warning word: 0, 5 (0021H)" in page.split("\n\n")[0]
    none = {"warning_word": Reading(value=0.0, raw=0, quality=Quality.GOOD)}
    assert "Warning" not in status_text(DriveStatus(state=DriveState.STOPPED, readings=none), 2.0, VC660)


def test_a_fault_whose_text_has_its_label_is_named_once() -> None:
    assert fault_text(Fault(9, "Fu.12", Text("fault Fu.12", "故障 Fu.12"))) == "fault Fu.12"
    assert fault_text(Fault(9, "E009", Text("over-current", "过电流"))) == "E009 over-current"
    two_bits = Text("fault bit 4, not published; fault bit 5, not published", "位 4 故障；位 5 故障")
    assert fault_text(Fault(4, "bit 4 + bit 5", two_bits)) == two_bits.en
    assert fault_text(Fault(4, "bit 4 + bit 6", two_bits)) == f"bit 4 + bit 6 {two_bits.en}"


@pytest.mark.parametrize("cells", [40, 60, 80, 120])
def test_a_table_fits_the_terminal_without_losing_a_word(cells: int) -> None:
    rows = [["output_voltage", "0 V", "uncertain: raw word: the manual does not publish its scale"], ["x", "y", ""]]
    shown = text_layout.table(["SIGNAL", "VALUE", "NOTE"], rows, cells)
    assert max(text_layout.width(line) for line in shown.splitlines()) <= cells
    assert " ".join(shown.split()).replace("uncertain:", "", 1).count("uncertain") == 0
    assert all(part in shown for part in rows[0][2].split())


@pytest.mark.parametrize("maker", ["Powtran Technology, Dalian", "手册未注明（富凌类，台州）"])
def test_columns_that_do_not_fit_beside_each_other_stand_below_each_other(maker: str) -> None:
    """Regression: `drivebus models` broke each line of a terminal with 80 columns."""
    rows = [["pi500", maker, "PI500 series", "rtu", "draft"], ["x", "y", "z", "ascii, rtu", "simulated"]]
    lines = text_layout.table(["MODEL", "MAKER", "DRIVE", "ENCODINGS", "GRADE"], rows, 40).splitlines()
    assert max(text_layout.width(line) for line in lines) <= 40
    assert [line.split()[0] for line in lines] == ["MODEL", "DRIVE", "pi500", "PI500", "x", "z"]
    columns = {
        text_layout.width(line[: line.index(word)])
        for line, word in zip(lines[1::2], ["ENC", "rtu", "asc"], strict=True)
    }
    assert len(columns) == 1


@pytest.mark.parametrize("cells", [24, 39, 50])
def test_a_value_of_a_narrow_table_is_not_separated_from_its_unit(cells: int) -> None:
    """A terminal with 40 columns had ``0.0`` at the end of one line and ``A`` on the next one."""
    rows = [
        ["fault_word_0", "故障字 0（0～15，位 0 为欠压）", "0 (0000H)", "0.00 s", ""],
        ["output_current", "输出电流", "0.0 A", "0.15 s", "不确定：比例尚未标定：暂按十六进制 0.1 解读"],
    ]
    shown = text_layout.table(["信号", "含义", "数值", "距今", "说明"], rows, cells)
    assert max(text_layout.width(line) for line in shown.splitlines()) <= cells
    assert all(value in shown for row in rows for value in row[2:4])
    assert "".join("".join(rows[1]).split()) in "".join(shown.split())


@pytest.mark.parametrize(("seconds", "shown"), [(0.2, "1 s"), (2.4, "2 s"), (1910.0, "31 min 50 s")])
def test_a_duration_is_at_least_one_second(seconds: float, shown: str) -> None:
    assert format_duration(seconds) == shown


@pytest.mark.parametrize(
    ("steps_hz", "doubtful", "note"),
    [
        ({"c320": 0.01}, False, ""),
        ({"c320": 0.01, "c300": 0.01}, True, "alike on the bus: see the name plate"),
        (
            {"c320": 0.01, "ms300": None},
            True,
            "alike on the bus, but c320 count 0.01 Hz; ms300 take a share of the maximum frequency",
        ),
    ],
)
def test_a_scan_notes_how_models_that_look_alike_count_their_frequency(
    capsys: pytest.CaptureFixture[str], steps_hz: dict[str, float | None], doubtful: bool, note: str
) -> None:
    drive = DetectedDrive(
        models=tuple(steps_hz), setpoint_steps_hz=steps_hz, family="modbus", encoding="rtu", address=3,
        settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip
    assert drive.doubtful is doubtful
    print_scan("x", ScanProgress(total_s=1.0, found=[drive]), None, ExitCode.DONE)
    shown = " ".join(capsys.readouterr().out.split())
    assert ("alike" in shown) is doubtful and "".join(note.split()) in "".join(shown.split())


def test_the_identity_of_a_drive_that_reports_a_model_code_names_the_models() -> None:
    """The line was empty for a GD10."""
    identity = Identity(model="gd200 / gd300", reported=True, models=("gd200", "gd300"))
    status = DriveStatus(state=DriveState.STOPPED, direction=None, readings={})
    lines = status_text(status, 0.0, profiles.load("gd200"), identity).splitlines()
    assert lines[-1].split() == [i18n.text("status.identity", text_layout.language()), "gd200", "/", "gd300"]


def test_a_scan_notes_a_look_alike_whose_step_no_source_gives_beside_one_step_that_is_known(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """They were called alike without a word about the frequency."""
    drive = DetectedDrive(
        models=("t13", "fr_d700_modbus"), setpoint_steps_hz={"fr_d700_modbus": 0.01}, family="modbus", encoding="rtu",
        address=3, settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip
    print_scan("x", ScanProgress(total_s=1.0, found=[drive]), None, ExitCode.DONE)
    note = "alike on the bus, but fr_d700_modbus count 0.01 Hz; the step of t13 is not published"
    assert note.replace(" ", "") in "".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("models", "fits_partly", "note"),
    [
        ((), False, "a device of this protocol (modbus) answers and rejects the reads of every model searched for"),
        (("vc660",), True, "answers the status register, but not with a state of this model"),
    ],
)
def test_a_scan_notes_a_device_that_no_model_fits(
    capsys: pytest.CaptureFixture[str], models: tuple[str, ...], fits_partly: bool, note: str
) -> None:
    drive = DetectedDrive(
        models=models, setpoint_steps_hz={}, family="modbus", encoding="rtu", address=3, fits_partly=fits_partly,
        settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip
    print_scan("x", ScanProgress(total_s=1.0, found=[drive]), None, ExitCode.DONE)
    shown = "".join(capsys.readouterr().out.split())
    assert note.replace(" ", "") in shown and "noise" not in shown
    assert (models[0] if models else "noknownmodel") in shown


@pytest.mark.parametrize(("language", "note"), [("en", "bytes, but no valid reply"), ("zh", "收到字节但无有效应答")])
def test_a_scan_says_once_that_addresses_sent_bytes_without_a_valid_reply(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, language: str, note: str
) -> None:
    """Regression: a disturbed bus of one address had a row for each encoding and format that was tried."""

    def unreadable(address: int, baud: int, format: str, encoding: str = "rtu") -> DetectedDrive:
        return DetectedDrive(
            models=(), setpoint_steps_hz={}, family="modbus", encoding=encoding, address=address, valid_reply=False,
            settings=SerialSettings.parse(baud, format), exchange=(b"", b""),
        )  # fmt: skip

    monkeypatch.setattr(output, "language", lambda: language)
    everywhere = [unreadable(n, 9600, tried) for tried in ("8N1", "8E1") for n in (1, 2, 3, 9)]
    found = [*everywhere, unreadable(5, 9600, "8N1", "ascii"), unreadable(5, 9600, "8N1"), unreadable(5, 19200, "8N1")]
    print_scan("x", ScanProgress(total_s=1.0, found=found), None, ExitCode.FAILED)
    shown = capsys.readouterr().out
    assert shown.count(note) == 2
    rows = [line.split() for line in shown.splitlines()]
    assert [row for row in rows if row[0] == "1-3,9" and "8N1/8E1" in row and "rtu" in row]
    joined = " ".join(shown.split())
    assert "9600 8N1" in joined and "19200 8N1" in joined and "ascii" in joined


def test_a_scan_says_once_that_another_address_replied_in_each_encoding(capsys: pytest.CaptureFixture[str]) -> None:
    def foreign(address: int, encoding: str) -> DetectedDrive:
        return DetectedDrive(
            models=(), setpoint_steps_hz={}, family="sunfar", encoding=encoding, address=address, valid_reply=False,
            settings=SerialSettings.parse(9600, "8E1"), exchange=(b"", b""), replied_address=2,
        )  # fmt: skip

    found = [foreign(1, "ascii"), foreign(1, "hex"), foreign(3, "ascii")]
    print_scan("x", ScanProgress(total_s=1.0, found=found), None, ExitCode.FAILED)
    shown = " ".join(capsys.readouterr().out.split())
    assert "ascii, hex" in shown and shown.count("from address 2 to a request for 1") == 1
    assert shown.count("from address 2 to a request for 3") == 1


def test_a_scan_says_once_that_another_address_replied_in_each_format(capsys: pytest.CaptureFixture[str]) -> None:
    """Regression: a pty does not compare the parity, and one drive with a wrong address had three rows."""
    foreign = replace(detected(1), valid_reply=False, replied_address=2)
    found = [replace(foreign, settings=SerialSettings.parse(9600, each)) for each in ("8E1", "8N1", "8O1")]
    print_scan("x", ScanProgress(total_s=1.0, found=found), None, ExitCode.FAILED)
    shown = " ".join(capsys.readouterr().out.split())
    assert "rtu 9600 8E1/8N1/8O1" in shown and shown.count("from address 2 to a request for 1") == 1


def test_a_scan_gives_the_remedy_of_a_stray_byte_only_where_its_table_names_that_byte(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A drive that was found at the second read had a remedy below the table that nothing in it referred to."""
    stray = HeaderError("bus.stray_before", station=1, count=1, bytes="00")
    remedy = " ".join(i18n.text("hint.bus.stray_before").split())
    for drive, is_named in ((detected(1), True), (detected(1, "vc660"), False)):
        found = replace(drive, valid_reply=not is_named, unusable_reply=stray)
        print_scan("x", ScanProgress(total_s=1.0, found=[found]), None, ExitCode.DONE)
        shown = " ".join(capsys.readouterr().out.split())
        assert (remedy in shown, "stray" in shown) == (is_named, is_named)


def detected(address: int, *models: str, fits_partly: bool = False) -> DetectedDrive:
    return DetectedDrive(
        models=models, setpoint_steps_hz={}, family="modbus", encoding="rtu", address=address,
        fits_partly=fits_partly, settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip


def test_a_scan_names_each_drive_once_when_it_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    monkeypatch.setattr(output.ProgressBar, "print_above", lambda bar, line: lines.append(line))
    progress = ScanProgress(total_s=1.0)
    with ScanProgressBar() as bar:
        for found in ([], [detected(1, "gd10")], [detected(9, "gd10", "gd20")], []):
            progress.found += found
            bar.on_progress(progress)
    serial = {"settings": "9600 8N1", "encoding": "rtu"}
    models = {1: "gd10", 9: "gd10 / gd20"}
    assert lines == [i18n.text("scan.found", models=models[each], address=each, **serial) for each in models]


def test_a_model_that_is_assumed_is_named_with_what_else_it_may_be() -> None:
    alike = [detected(address, "shihlin_se2", "svd_p") for address in (2, 9)]
    assert assumed_models_texts([detected(1, "gd10"), *alike, detected(3, "vc660", fits_partly=True)]) == [
        "Address 2, 9: shihlin_se2 is assumed. The bus can't tell it from svd_p: see the name plate.",
        "Address 3: vc660 is assumed, but it does not answer as it should: see the name plate.",
    ]


def test_a_scan_that_sent_nothing_does_not_report_missing_replies(capsys: pytest.CaptureFixture[str]) -> None:
    """After foreign traffic no request was sent, so nothing is known about the wiring."""
    progress = ScanProgress(total_s=10.0)
    print_scan("x", progress, SniffResult(489, 0, b"", 2.0), ExitCode.FAILED)
    assert capsys.readouterr().out == ""
    progress.done_s = 10.0
    print_scan("x", progress, None, ExitCode.FAILED)
    assert "No drive answered" in capsys.readouterr().out


@pytest.mark.parametrize("cells", range(20, 60))
def test_a_url_with_chinese_placeholders_is_not_broken(cells: int) -> None:
    """Regression: the help in Chinese broke ``tcp://主机:端口`` behind the slashes."""
    urls = ("tcp://主机:端口", "sim://c320@1")
    text = f"PORT 可以是设备路径、COM3、{urls[0]}，或用 {urls[1]} 表示模拟变频器（{urls[0]}）。"
    lines = output.wrap(text, cells)
    assert sum(line.count(urls[0]) for line in lines) == 2 and sum(urls[1] in line for line in lines) == 1
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
