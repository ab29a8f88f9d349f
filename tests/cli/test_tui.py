"""The live view: rows, tables, keys of the full screen, JSON documents, captures, and the demo's plant on ptys."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from textual.widgets._footer import FooterKey

from drivebus import i18n, ports, profiles
from drivebus.bus import Bus
from drivebus.capture.dbcap import BytesRecord, Capture, CaptureHeader
from drivebus.cli import output
from drivebus.cli.commands import monitor
from drivebus.cli.commands.init import ModelQuestions, _bus_answer
from drivebus.cli.commands.monitor import _report_left_out
from drivebus.cli.demo.plant import PtyDemoPlant
from drivebus.cli.main import cli
from drivebus.cli.output import table, width, wrap
from drivebus.cli.scanning import select_alike
from drivebus.cli.tui.app import MonitorApp
from drivebus.cli.tui.bus_source import BusRowSource
from drivebus.cli.tui.capture_source import CapturePlayer
from drivebus.cli.tui.plain import bus_text, drive_text
from drivebus.cli.tui.rows import COLUMN_SIGNALS, BusRow, DriveRow, drive_row
from drivebus.cli.tui.tables import CellTable, bus_cells, bus_columns, drive_cells, drive_columns
from drivebus.cli.tui.threaded import ThreadedRowSource
from drivebus.commissioning import scan
from drivebus.drives import Drive
from drivebus.drives.state import DriveState, DriveStatus
from drivebus.errors import HeaderError, PortLost
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.port import find_simulated_bus
from drivebus.values import Quality, Reading, missing_reading

pytestmark = pytest.mark.usefixtures("clean_simulated_buses")


class FakeRowSource:
    """Row source of two drives and one bus that never change."""

    title = "two drives"
    finished = False

    def __init__(self) -> None:
        self.closed = False

    async def start(self) -> None: ...

    async def close(self) -> None:
        self.closed = True

    def now(self) -> float:
        return 100.0

    def drives(self) -> list[DriveRow]:
        good = {
            "output_frequency": Reading(value=12.5, unit="Hz", source_time=99.0),
            "output_current": missing_reading("x", "A"),
        }
        odd = {"output_frequency": Reading(value=3.0, unit="Hz", quality=Quality.UNCERTAIN, source_time=50.0)}
        return [
            DriveRow(
                key="a",
                name="fan 1",
                bus="A",
                model="c320",
                address=1,
                state="running",
                direction="forward",
                readings=good,
                presence="online",
                oldest_value_at=99.0,
            ),
            DriveRow(
                key="b",
                name="fan 2",
                bus="A",
                model="c320",
                address=2,
                readings=odd,
                presence="offline",
                oldest_value_at=50.0,
            ),
        ]

    def buses(self) -> list[BusRow]:
        return [
            BusRow(
                name="A",
                settings="9600 8E1",
                load=0.5,
                transactions_per_s=12.0,
                errors={"NoReply": 2, "late": 0},
            )
        ]

    def messages(self) -> list[str]:
        return ["something happened"]


class RecordedCommands:
    """Key commands that record their calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.calls.append((name, *arguments))


def test_a_value_that_is_not_reported_is_a_dash_and_never_a_zero() -> None:
    row = FakeRowSource().drives()[0]
    assert row.cell("output_current") == "–"
    assert row.cell("set_frequency") == "–"
    assert row.cell("output_frequency") == "12.50"


STRAY = HeaderError("bus.stray_before", station=1, count=1, bytes="00")


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("reason", "unusable_reply", "presence", "state", "shown"),
    [
        ("drives.no_answer", STRAY, "never_seen", "live.presence.unusable", "bus.stray_before"),
        ("drives.reserved_bits", None, "online", "live.state.unknown", "drives.reserved_bits"),
        ("drives.not_read", None, "never_seen", "live.presence.never_seen", None),
        ("drives.stale", None, "offline", "live.presence.offline", None),
        ("drives.reserved_bits", None, "offline", "live.presence.offline", None),  # silent since that reply
        ("drives.no_run_status", None, "online", "live.state.unknown", None),
    ],
)
def test_a_drive_whose_replies_are_not_accepted_is_not_called_unseen_and_an_unknown_state_has_its_reason(
    reason: str,
    unusable_reply: Exception | None,
    presence: str,
    state: str,
    shown: str | None,
    language: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(output, "language", lambda: language)
    status = DriveStatus(state=DriveState.UNKNOWN, reason=reason, unusable_reply=unusable_reply)
    row = drive_row(status, key="a", name="fan 1", bus="A", model="vc660", address=1, presence=presence)
    text = None if shown is None else i18n.text(shown, language, **STRAY.params)
    assert (row.state_text(), row.fault_cell(), row.to_json(1.0)["reason"]) == (output.text(state), text or "", text)
    assert drive_text(row, 1.0).endswith(text or "–") and row.to_json(1.0)["fault"] is None


def test_a_known_state_or_another_reply_is_named_before_replies_that_come_twice() -> None:
    def reason(presence: str = "online", **status: Any) -> str | None:
        found = DriveStatus(**{"state": DriveState.UNKNOWN, "reason": "drives.stale", **status})
        names = {"key": "a", "name": "fan 1", "bus": "A", "model": "vc660"}
        return drive_row(found, address=1, has_duplicate_address=True, presence=presence, **names).reason

    assert reason() == i18n.text("drives.duplicate", output.language(), station=1)
    assert reason(state=DriveState.RUNNING, reason=None) is None
    assert reason("offline") is reason(reason="drives.port_lost") is None
    assert reason(unusable_reply=STRAY) == i18n.text("bus.stray_before", output.language(), **STRAY.params)


def test_a_commanded_frequency_has_a_star_if_the_drive_reports_none() -> None:
    row = DriveRow(key="a", name="fan 1", bus="A", model="c320", address=1, commanded_hz=30.0)
    assert row.cell("set_frequency") == "30.00*"


def test_an_uncertain_value_has_a_question_mark_and_an_offline_drive_no_answer() -> None:
    row = FakeRowSource().drives()[1]
    assert row.cell("output_frequency") == "3.00?"
    assert row.state_text() == "OFFLINE"
    assert row.age_text(100.0) == "50.0"


@pytest.mark.parametrize(
    ("label", "text", "shown", "narrow"),
    [
        ("Fu.12", "fault Fu.12: see the manual", "fault Fu.12: see the manual", "Fu.12"),
        ("E009", "over-current", "E009 over-current", "E009"),
        ("", "under-voltage", "under-voltage", "under-voltage"),
    ],
)
def test_a_fault_is_shown_once_and_also_without_a_label_on_the_keypad(
    label: str, text: str, shown: str, narrow: str
) -> None:
    row = replace(FakeRowSource().drives()[0], state="fault", fault_label=label, fault_text=text)
    assert drive_text(row, 100.0).endswith(f"  {shown}")
    for cells, expected in ((160, shown), (80, narrow)):
        columns = drive_columns(cells)
        cell = drive_cells(row, 100.0, columns)[list(columns).index("fault")].plain.strip()
        assert expected.startswith(cell.rstrip("…").strip()) and cell
    assert row.to_json(100.0)["fault"] == {"label": label, "text": text}
    assert FakeRowSource().drives()[0].to_json(100.0)["fault"] is None


@pytest.mark.parametrize("cells", [*range(40, 60), 60, 70, 80, 120])
def test_the_columns_fit_the_terminal(cells: int) -> None:
    assert sum(drive_columns(cells).values()) <= cells
    assert sum(bus_columns(cells).values()) <= cells


def test_a_narrow_terminal_hides_the_least_important_columns() -> None:
    assert set(drive_columns(80)) == {"name", "state", "direction", *COLUMN_SIGNALS, "fault", "age"}
    assert {"state", "output_frequency", "fault", "age"} <= set(drive_columns(60))
    assert "output_voltage" not in drive_columns(72)
    assert {"name", "state", "output_frequency", "age"} <= set(drive_columns(40)), (
        "an age beyond the edge hides old values"
    )
    assert {"bus", "link", "errors"} <= set(bus_columns(40))


async def test_a_terminal_that_becomes_narrow_keeps_the_selected_drive_and_the_age_visible() -> None:
    commands = RecordedCommands()
    screen = MonitorApp(FakeRowSource(), commands)
    async with screen.run_test(size=(120, 24)) as pilot:
        await pilot.pause(0.4)
        await pilot.press("down")
        await pilot.resize_terminal(60, 24)
        await pilot.pause(0.4)
        await pilot.press("s")
        table = screen.query_one("#drives", CellTable)
        assert len(table.get_row_at(0)) == len(drive_columns(60))
        assert not table.show_horizontal_scrollbar
    assert commands.calls == [("stop", "b")]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_every_state_fits_its_column_in_both_languages(language: str) -> None:
    from drivebus.drives import DriveState

    output.parse_global_options(["--lang", language])
    columns = drive_columns(80)
    for state in DriveState:
        row = DriveRow(
            key="a", name="x", bus="A", model="m", address=1, state=str(state), direction="reverse", presence="online"
        )
        assert width(row.state_text()) < columns["state"]
        assert width(row.direction_text()) < columns["direction"]
    for name, cells in columns.items():
        assert width(output.text(f"live.drive.{name}")) <= cells


def test_chinese_takes_two_cells_and_no_line_begins_with_a_comma_or_ends_with_a_bracket() -> None:
    assert width("变频器 1") == 8
    lines = wrap("变频器报告的内容，状态、方向、故障。", 9)
    assert all(width(line) <= 10 for line in lines)
    assert not any(line[0] in "，。、" for line in lines)
    assert wrap("配置文件（PLANT.toml），见“设置”。", 12) == ["配置文件", "（PLANT.toml），", "见“设置”。"]
    shown = table(["名称", "b"], [["风机", "1"], ["x", "22"]]).splitlines()
    assert len({width(line[: line.rindex(" ") + 1]) for line in shown}) == 1


async def test_twelve_drives_four_buses_and_messages_fit_a_terminal_of_80_by_24() -> None:
    """The usual size of a new terminal shows the demo without scroll bars."""

    class Plant(FakeRowSource):
        def drives(self) -> list[DriveRow]:
            return [replace(super(Plant, self).drives()[0], key=str(n)) for n in range(12)]

        def buses(self) -> list[BusRow]:
            return super().buses() * 4

    screen = MonitorApp(Plant(), RecordedCommands())
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.6)
        for table in screen.query(CellTable):
            assert (table.max_scroll_x, table.max_scroll_y) == (0, 0), table.id
        assert screen.query_one("#messages").size.height >= 2


async def test_the_newest_message_is_whole_however_long_it_is() -> None:
    """Regression: at 80 by 24 the last line of the demo ended with "Its drives keep running, without"."""

    class Talking(FakeRowSource):
        def messages(self) -> list[str]:
            return ["0:25  old news"] * 30 + [
                "0:27  the adapter is pulled out " + "and drives keep running " * 4 + "END"
            ]

    screen = MonitorApp(Talking())
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.6)
        messages = screen.query_one("#messages")
        lines = [messages.render_line(y).text.rstrip() for y in range(messages.size.height)]
        assert lines[-1].startswith(" " * 6) and lines[-1].endswith("END")
        assert any(line.startswith("0:27  the adapter") for line in lines[:-1])
        assert lines[0] == "0:25  old news"


@pytest.mark.parametrize("language", ["en", "zh"])
async def test_no_message_is_shown_without_its_beginning(language: str) -> None:
    """Regression: the end of an older message stood above the newest ones, as if it were one itself."""
    words = {"en": "the drive accepted the frequency and can't show it; ", "zh": "变频器已接受频率，无法读回；"}

    class Talking(FakeRowSource):
        def messages(self) -> list[str]:
            return ["0:25  " + words[language] * 4, *[f"0:{second}  news" for second in range(26, 44)]]

    screen = MonitorApp(Talking())
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.6)
        area = screen.query_one("#messages")
        height = area.size.height
        screen._source.messages = lambda: Talking().messages()[:height]  # type: ignore[method-assign]
        await pilot.pause(0.6)
        lines = [line for y in range(height) if (line := area.render_line(y).text.strip())]
        assert lines[-1].endswith("news") and all(line.startswith("0:") for line in lines)


async def test_a_long_port_in_the_title_is_cut_and_not_left_out() -> None:
    """Regression: the title wrapped, and "drives: 4 ·" was the end of its only line."""
    source = FakeRowSource()
    source.title = "reads only · drives: 4 · sim://c320@1-3?line_quality=loss=0.1,flip=0.01,late=0.1:0.4 · 9600 8E1"
    screen = MonitorApp(source)
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.4)
        shown = screen.query_one("#title").render_line(0).text.rstrip()
    assert shown.endswith("…") and "sim://c320@1-3" in shown


async def test_ctrl_c_ends_the_live_view_without_a_question() -> None:
    screen = MonitorApp(FakeRowSource())
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.4)
        await pilot.press("ctrl+c")
    assert not screen.is_running and not screen._notifications


async def test_keys_command_the_selected_drive_and_q_ends() -> None:
    source, commands = FakeRowSource(), RecordedCommands()
    screen = MonitorApp(source, commands)
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.4)
        await pilot.press("r", "down", "s", "plus", "minus", "x", "space")
        assert screen.query_one("#drives", CellTable).get_row_at(0)[1].plain == "running"
        await pilot.press("q")
    assert commands.calls == [
        ("run", "a"),
        ("stop", "b"),
        ("change_frequency", "b", 5.0),
        ("change_frequency", "b", -5.0),
        ("reset", "b"),
        ("stop_all",),
    ]
    assert source.closed


@pytest.mark.parametrize("language", ["en", "zh"])
async def test_a_narrow_terminal_shows_the_keys_that_stop_and_end(language: str) -> None:
    """At 40 cells the stop of all drives and the end stood beyond the edge."""
    output.parse_global_options(["--lang", language])
    screen = MonitorApp(FakeRowSource(), RecordedCommands())
    async with screen.run_test(size=(40, 24)) as pilot:
        await pilot.pause(0.4)
        visible = {key.action for key in screen.query(FooterKey) if key.region.right <= 40}
        assert {"stop", "stop_all", "quit"} <= visible
    output.parse_global_options(["--lang", "en"])


async def test_a_monitor_has_no_command_keys() -> None:
    screen = MonitorApp(FakeRowSource())
    async with screen.run_test(size=(80, 24)) as pilot:
        await pilot.press("r", "s", "plus", "space")
        bound = {binding.action for _, binding in screen._bindings}
    assert not {"run", "stop", "faster", "stop_all"} & bound


async def test_a_source_runs_in_its_own_thread_and_its_failure_is_raised() -> None:
    class Broken(FakeRowSource):
        async def start(self) -> None:
            raise PortLost("ports.lost", port="x", reason="y")

    source = FakeRowSource()
    threaded = ThreadedRowSource(source, RecordedCommands())
    await threaded.start()
    await until(lambda: bool(threaded.drives()))
    assert [row.name for row in threaded.drives()] == ["fan 1", "fan 2"]
    await threaded.close()
    assert source.closed
    with pytest.raises(PortLost):
        await ThreadedRowSource(Broken()).start()


async def test_rows_whose_source_has_failed_are_not_shown_as_if_they_were_current() -> None:
    """The last rows stayed on the screen, with the ages that they had at the failure."""

    class Failing(FakeRowSource):
        is_broken = False

        def drives(self) -> list[DriveRow]:
            if self.is_broken:
                raise ValueError("broken")
            return super().drives()

    source = Failing()
    threaded = ThreadedRowSource(source)
    await threaded.start()
    await until(lambda: bool(threaded.drives()))
    source.is_broken = True
    with pytest.raises(ValueError, match="broken"):
        await until(lambda: not threaded.drives())
    await threaded.close()
    assert source.closed


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition, at most until the timeout of the test."""
    while not condition():  # noqa: ASYNC110
        await asyncio.sleep(0.02)


async def test_a_monitor_names_the_loss_of_the_adapter_and_its_return() -> None:
    """Nothing is reported of an adapter that is there all the time."""
    source = BusRowSource(ports.open_port("sim://vc660@1?name=m"), [(profiles.load("vc660"), "rtu", 1)], "m")
    await source.start()
    [announced] = source.messages()
    assert source.buses()[0].up and source.messages() == [announced]
    for change, message in (
        (find_simulated_bus("m").unplug, "The adapter was lost; it is opened again as soon as it is back."),
        (find_simulated_bus("m").replug, "The adapter is back."),
    ):
        before = len(source.messages())
        change()
        await until(lambda before=before: bool(source.buses()) and len(source.messages()) > before)  # type: ignore[misc]
        assert source.messages()[-1].startswith(message) and len(source.messages()) == before + 1
    await source.close()


async def test_a_bus_of_the_plant_on_ptys_is_unplugged_and_plugged_and_its_folder_is_deleted() -> None:
    pytest.importorskip("pty")
    plant = PtyDemoPlant()
    await plant.start()
    try:
        folder = Path(plant.urls[2].partition("://")[2].partition("?")[0]).parent
        async with Bus(ports.open_port(plant.urls[2])) as bus:
            drive = Drive(bus, "vc660", 1)
            assert (await drive.status()).state == "stopped"
            plant.apply({"do": "unplug", "bus": 2})
            await until(lambda: not bus.is_open)
            plant.apply({"do": "plug", "bus": 2})
            await until(lambda: bus.is_open)
            assert (await drive.status()).state == "stopped"
            drive.close()
    finally:
        await plant.close()
    assert not folder.exists()


def test_monitor_streams_documents_without_a_terminal_and_commands_nothing() -> None:
    words = [
        "monitor",
        "sim://vc660@1-2",
        "--model",
        "vc660",
        "--address",
        "1-2",
        "--duration",
        "1.5",
        "--period",
        "0.5",
    ]
    result = CliRunner().invoke(cli, [*words, "--json"])
    assert result.exit_code == 0, result.output
    last = [json.loads(line) for line in result.stdout.splitlines()][-1]
    assert [row["state"] for row in last["drives"]] == ["stopped", "stopped"]
    assert last["buses"][0]["transactions_per_s"] > 0


def test_monitor_reads_detected_drives_with_the_profile_of_the_option(tmp_path: Path) -> None:
    """The user's own file has a signal that its base, whose model name it contains, does not have."""
    own = tmp_path / "mine.toml"
    own.write_text(
        'format = 1\nextends = "c320"\naddresses = [1, 2]\n[signals.output_current]\nnotation = "d.2"\nunit = "A"\n'
        'factor = 0.1\ndecimals = 1\ntext = { en = "current", zh = "电流" }\nevidence = "user"\n'
    )
    words = ["monitor", "sim://c320@1?baud=9600&format=8E1", "--model", str(own), "--encoding", "ascii"]
    result = CliRunner().invoke(cli, [*words, "--duration", "1.5", "--period", "0.5", "--json"])
    assert result.exit_code == 0, result.output
    last = [json.loads(line) for line in result.stdout.splitlines()][-1]
    assert [row["readings"]["output_current"]["value"] for row in last["drives"]] == [0.0]


def recorded() -> Capture:
    """Two polls of a VC660: one answered, one not."""
    request, reply = bytes.fromhex("0103300200012ACA"), bytes.fromhex("010302138 8B512".replace(" ", ""))
    records = (
        BytesRecord(0.0, "tx", request),
        BytesRecord(0.02, "rx", reply[:3]),
        BytesRecord(0.03, "rx", reply[3:]),
        BytesRecord(0.5, "tx", request),
        BytesRecord(1.0, "tx", request),
        BytesRecord(1.02, "rx", reply[:-1] + b"\x00"),
    )
    return Capture(CaptureHeader(SerialSettings(9600), "path:x"), records)


def test_a_capture_counts_missing_and_damaged_replies() -> None:
    player = CapturePlayer(recorded(), [(profiles.load("vc660"), "rtu")])
    for record in player.capture.records:
        assert isinstance(record, BytesRecord)
        player.on_record(record)
    row = player.drives[1].row("online")
    assert row.cell("output_frequency") == "50.00"
    assert row.oldest_value_at == pytest.approx(0.03)
    assert dict(player.activity.errors) == {"NoReply": 1, "ChecksumError": 1}


@pytest.mark.parametrize(("language", "again"), [("en", "again"), ("zh", "重新")])
@pytest.mark.parametrize("command", ["monitor", "init"])
def test_a_drive_found_in_another_encoding_alone_is_to_be_searched_again(
    command: str, language: str, again: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A C320 whose reply in the encoding of the others was lost was to be moved to a bus of its own."""
    monkeypatch.setattr(output, "language", lambda: language)
    first, second = (
        scan.DetectedDrive(
            models=("c320",),
            setpoint_steps_hz={},
            family="sunfar",
            encoding=encoding,
            address=address,
            settings=SerialSettings.parse(9600, "8E1"),
            exchange=(b"", b""),
        )
        for address, encoding in ((1, "ascii"), (2, "hex"))
    )
    if command == "monitor":
        assert select_alike([first, second], _report_left_out) == [first]
    else:
        bus = _bus_answer("sim://c320@1-2", [first, second], (), ModelQuestions(is_interrupted=True))
        assert [drive.address for drive in bus.drives] == [1]
    note = capsys.readouterr().err
    assert again in note and ("encoding" if language == "en" else "编码") in note


def test_monitor_shows_a_drive_that_answers_in_two_encodings_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A C320 answers in two encodings; a drive of another family is named in a note."""
    settings = SerialSettings.parse(9600, "8E1")

    async def silence(*_: object) -> scan.SniffResult:
        return scan.SniffResult(0, 0, b"", 2.0)

    async def found(passes: object, open_port: object, progress: scan.ScanProgress, *_: object) -> None:
        detected = [("sunfar", "ascii", 1), ("sunfar", "ascii", 2), ("sunfar", "hex", 1), ("modbus", "rtu", 9)]
        models = {"sunfar": ("c320",), "modbus": ("vc660",)}
        progress.found += [
            scan.DetectedDrive(
                models=models[family],
                setpoint_steps_hz={},
                family=family,
                encoding=encoding,
                address=address,
                settings=settings,
                exchange=(b"", b""),
            )
            for family, encoding, address in detected
        ]

    monkeypatch.setattr(scan, "sniff", silence)
    monkeypatch.setattr(scan, "scan", found)
    words = ["monitor", "sim://c320@1-2", "--duration", "1.5", "--period", "0.5", "--json"]
    result = CliRunner().invoke(cli, [*words, "--lang", "en"])
    assert result.exit_code == 0, result.output
    rows = [json.loads(text) for text in result.stdout.splitlines() if '"drives"' in text][-1]["drives"]
    assert [row["state"] for row in rows] == ["stopped", "stopped"]
    noted = " ".join(result.stderr.split())
    assert i18n.text("monitor.left_out", address=9, models="vc660") in noted
    assert noted.count("is left out") == 1


def test_an_assumed_model_is_marked_in_the_table() -> None:
    """Regression: only a message before the table said so."""
    row = DriveRow(key="a", name="c320 1", bus="A", model="c320", address=1)
    shown = [
        drive_cells(variant, 0.0, drive_columns(80))[0].plain for variant in (row, replace(row, is_model_assumed=True))
    ]
    assert [name.strip() for name in shown] == ["c320 1", "c320? 1"]


@pytest.mark.parametrize("as_json", [False, True])
def test_monitor_lists_look_alikes_before_it_goes_on_with_the_first(
    monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    """A single line on standard error named the first model; the full-screen view hid that line."""
    settings = SerialSettings.parse(9600, "8E1")

    async def found(*_: object) -> list[scan.DetectedDrive]:
        steps = {"c320": 0.01, "e350": 0.1}
        return [
            scan.DetectedDrive(
                models=tuple(steps), setpoint_steps_hz=steps, family="sunfar", encoding="ascii", address=1,
                settings=settings, exchange=(b"", b""),
            )
        ]  # fmt: skip

    monkeypatch.setattr(monitor, "search", found)
    words = ["monitor", "sim://c320@1", "--duration", "0.5", "--lang", "en", *(["--json"] if as_json else [])]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    table = " ".join(result.stderr.split())
    assert "c320 / e350" in table and "c320 count 0.01 Hz; e350 count 0.1 Hz: see the name plate" in table
    assumed = "Address 1: c320 is assumed. The bus can't tell it from e350: see the name plate."
    for sentence in (assumed, output.text("monitor.assumed")):
        assert (json.dumps({"event": sentence}) if as_json else sentence) in result.stdout
    assert ('"model_assumed": true' if as_json else "  c320? 1 ") in result.stdout


def test_monitor_that_is_interrupted_while_it_searches_prints_what_it_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search of 49 minutes began without a word of its duration, and Ctrl-C discarded its drives."""
    drive = scan.DetectedDrive(
        models=("vc660",),
        setpoint_steps_hz={},
        family="modbus",
        encoding="rtu",
        address=7,
        settings=SerialSettings.parse(9600, "8N1"),
        exchange=(b"", b""),
    )

    async def find(passes: Any, open_port: Any, progress: scan.ScanProgress, *rest: Any, **options: Any) -> None:
        progress.found.append(drive)
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(60.0)

    monkeypatch.setattr(scan, "scan", find)
    monkeypatch.setattr(monitor, "LISTEN_S", 0.0)
    result = CliRunner().invoke(cli, ["monitor", "sim://vc660@7", "--lang", "en"])
    noted = " ".join(result.stderr.split())
    assert result.exit_code == 130, result.output
    assert i18n.text("monitor.search") in noted and "all of them at most" in noted
    assert "Interrupted: this was found so far. ADDRESS MODEL ENCODING SERIAL NOTE 7 vc660 rtu 9600 8N1" in noted


def test_monitor_does_not_blame_silent_drives_beside_another_master(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing was sent, and yet the message was that no drive answered."""

    async def foreign(*_: object) -> scan.SniffResult:
        return scan.SniffResult(count=8, seconds=2.0, line_errors=0, first=b"\x01\x03")

    monkeypatch.setattr(scan, "sniff", foreign)
    result = CliRunner().invoke(cli, ["monitor", "sim://vc660@7", "--lang", "en"])
    assert (result.exit_code, "another master is active" in " ".join(result.stderr.split())) == (1, True)
    assert "No drive answered" not in result.output


def test_monitor_plays_a_capture_file_to_its_end(tmp_path: Path) -> None:
    from drivebus.capture.dbcap import CaptureWriter

    path = tmp_path / "line.dbcap"
    writer = CaptureWriter(path, CaptureHeader(SerialSettings(9600), "path:x"), now=0.0)
    for record in recorded().records:
        assert isinstance(record, BytesRecord)
        writer.write_bytes(record.time_s, record.direction, record.data)
    writer.close()
    result = CliRunner().invoke(cli, ["monitor", str(path), "--speed", "20", "--json"])
    assert result.exit_code == 0, result.output
    documents = [json.loads(line) for line in result.stdout.splitlines()]
    assert documents[-1]["drives"][0]["readings"]["output_frequency"]["value"] == 50.0
    assert any("End of the capture" in document.get("event", "") for document in documents)
    cut_off = "The capture was cut off: its last line is missing."
    assert cut_off not in result.stdout
    path.write_bytes(path.read_bytes()[:-3])
    assert cut_off in CliRunner().invoke(cli, ["monitor", str(path), "--speed", "20", "--json"]).stdout


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_rows_of_a_plain_view_are_broken_between_their_values_where_a_terminal_is_narrow(
    language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row of a drive has 105 columns and more, and a terminal of 80 broke it within a value.

    In a file or a pipe it is one line.
    """
    output.parse_global_options(["--lang", language])
    drive = replace(FakeRowSource().drives()[0], state="fault", fault_label="E009", fault_text="over-current " * 9)
    bus = BusRow(name="line", settings="9600 8N1", errors={"NoReply": 33_333, "late": 222_222, "collision": 5})
    whole = [drive_text(drive, 100.0), bus_text(bus)]
    monkeypatch.setattr(output, "terminal_width", lambda _: 79)
    for row, broken in zip(whole, (drive_text(drive, 100.0), bus_text(bus)), strict=True):
        lines = broken.splitlines()
        assert "\n" not in row and width(row) > 79 >= max(width(line) for line in lines)
        assert all(line.startswith("    ") for line in lines[1:])
        assert " ".join(broken.split()) == " ".join(row.split())
    values = [f"{output.text(f'live.drive.{name}')} {drive.cell(name):>6}" for name in COLUMN_SIGNALS]
    assert all(value in drive_text(drive, 100.0) for value in values)


def test_a_long_bus_name_keeps_its_end_and_a_gap_before_the_settings() -> None:
    row = BusRow(name="tcp:192.168.100.50:4001", settings="9600 8N1")
    shown = bus_cells(row, bus_columns(80))[0].plain
    assert shown.endswith(":4001")
    assert width(shown) < bus_columns(80)["bus"]


@pytest.mark.parametrize(
    ("language", "counters", "expected"),
    [
        ("en", {"NoReply": 3}, "no reply 3"),
        ("en", {"late": 2, "NoReply": 33, "collision": 5}, "no reply 33, 7 more"),
        ("en", {"NoReply": 33_333, "late": 222_222, "collision": 5}, "255560 in all"),
        ("zh", {"late": 2, "NoReply": 33, "collision": 5}, "无应答 33，另有 7"),
    ],
)
def test_counters_that_a_narrow_terminal_cannot_hold_are_counted_and_never_cut(
    language: str, counters: dict[str, int], expected: str
) -> None:
    """Regression: a noisy line at 80 columns showed "no reply 33, line …"."""
    output.parse_global_options(["--lang", language])
    columns = bus_columns(80)
    shown = bus_cells(BusRow(name="line", settings="9600 8N1", errors=counters), columns)[-1].plain
    assert shown == f" {expected}" and width(shown) <= columns["errors"]
    whole = BusRow(name="line", settings="9600 8N1", errors=counters).errors_text()
    assert all(str(count) in whole for count in counters.values())


def test_the_stations_of_a_killed_parent_end_and_delete_their_folder() -> None:
    """The end of their standard input ends the process of the stations."""

    async def abandon(plant: PtyDemoPlant) -> None:
        await plant.start()
        assert plant._child is not None and plant._child.stdin is not None
        plant._child.stdin.close()
        await asyncio.wait_for(plant._child.wait(), 10)

    plant = PtyDemoPlant()
    asyncio.run(abandon(plant))
    assert plant._folder is not None
    assert not Path(plant._folder.name).exists()
    plant._folder.cleanup()


@pytest.mark.parametrize(("language", "words"), [("en", "reads only"), ("zh", "只读")])
def test_a_narrow_terminal_cuts_the_port_off_the_title_and_not_that_it_only_reads(language: str, words: str) -> None:
    title = i18n.text("monitor.title", language, port="sim://vc660@" + "1," * 30, serial="9600 8N1", count=31)
    assert words in title[:40]
