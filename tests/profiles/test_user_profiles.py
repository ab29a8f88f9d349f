"""A user's own files do on a simulated drive what they are for: sizes of groups, status monitors, a monitor table."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus import Bus, Drive, profiles
from drivebus.commissioning.decode.describe import describe_frame
from drivebus.drives.state import Fault
from drivebus.errors import ProfileError
from drivebus.ports import open_port
from drivebus.profiles.model import Evidence
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import find_simulated_bus
from drivebus.testing.virtual_time import run
from drivebus.values import Quality, Text

SIZES = 'format = 1\nextends = "vc660"\nmodel = "spindle"\n[group_sizes]\nF00 = 30\nF01 = 20\n'
MONITOR = """
format = 1
extends = "c320"
[signals.output_current]
notation = "d.2"
text = { en = "output current", zh = "输出电流" }
unit = "A"
factor = 0.1
decimals = 1
evidence = "user: chapter 4.3"
"""
STATUS = """
format = 1
extends = "df800"
capabilities = ["run", "stop", "set_frequency", "reset_fault", "read", "write", "save", "status"]
[status]
register = 0x0001
bits = { running = 0x0001, output_reverse = 0x0002, fault = 0x0004 }
evidence = "user: list of monitors"
[signals.output_frequency]
notation = "F0.00"
text = { en = "output frequency", zh = "输出频率" }
unit = "Hz"
factor = 0.01
decimals = 2
evidence = "user: list of monitors"
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty home with the directory for own profiles."""
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    directory = tmp_path / ".config" / "drivebus" / "profiles"
    directory.mkdir(parents=True)
    return directory


def test_the_group_sizes_of_vc660_give_its_parameters_their_registers(own: Path) -> None:
    (own / "spindle.toml").write_text(SIZES, encoding="utf-8")
    assert "spindle" in profiles.models()

    async def scenario(model: str) -> tuple[int | None, list[object]]:
        async with Bus(open_port("sim://vc660@1")) as bus:
            drive = Drive(bus, model, 1)
            requests: list[object] = []
            bus.trace(lambda event: requests.append(event.message) if event.direction == "sent" else None)
            return (await drive.read(["F01.00"]))["F01.00"].raw, requests

    raw, requests = run(scenario("spindle"))
    assert raw == 2
    assert 30 in [getattr(request, "register", None) for request in requests]
    with pytest.raises(ProfileError):
        run(scenario("vc660"))


def test_a_monitor_of_ones_own_is_a_signal_of_c320(own: Path) -> None:
    path = own / "pump.toml"
    path.write_text(MONITOR, encoding="utf-8")

    async def scenario() -> None:
        async with Bus(open_port("sim://c320@1?ramp=1")) as bus:
            drive = Drive(bus, path, 1)
            await drive.run(30.0, wait=True)
            reading = (await drive.status()).readings["output_current"]
            assert (reading.unit, reading.quality) == ("A", Quality.GOOD)
            assert reading.raw and reading.value == pytest.approx(reading.raw / 10)
            await drive.stop()

    run(scenario())


FAULT = """
format = 1
extends = "c320"
[faults.1]
label = "Fu.1"
text = { en = "overload", zh = "过载" }
cause = { en = "The filter is clogged.", zh = "滤网堵塞。" }
remedy = { en = "Replace the filter.", zh = "更换滤网。" }
evidence = "user: maintenance log"
"""


def test_cause_and_remedy_of_ones_own_are_in_the_status_and_in_a_decoded_frame(own: Path) -> None:
    path = own / "fan.toml"
    path.write_text(FAULT, encoding="utf-8")
    assert profiles.load(path).faults[1].evidence == Evidence("user", Text("maintenance log", "maintenance log"))
    frame = bytes.fromhex("2A 30 30 30 32 30 30 30 31 30 30 30 30 30 32 34 33 0D")
    fields = describe_frame(path, frame, direction="response").fields
    assert (fields["fault_cause"].en, fields["fault_remedy"].zh) == ("The filter is clogged.", "更换滤网。")
    bare = describe_frame("c320", frame, direction="response").fields
    assert "fault_cause" not in bare and "fault_remedy" not in bare

    async def scenario() -> Fault | None:
        async with Bus(open_port("sim://c320@1?name=own-fault")) as bus:
            find_simulated_bus("own-fault").station(1).trip(next(iter(Trip)))
            return (await Drive(bus, path, 1).status()).fault

    fault = run(scenario())
    assert fault is not None and fault.cause is not None and fault.remedy is not None
    assert (fault.cause.zh, fault.remedy.en) == ("滤网堵塞。", "Replace the filter.")


def test_a_df800_with_its_status_monitors_has_a_state(own: Path) -> None:
    path = own / "fan.toml"
    path.write_text(STATUS, encoding="utf-8")

    async def scenario(model: str | Path) -> tuple[str, Quality]:
        async with Bus(open_port("sim://df800@1")) as bus:
            status = await Drive(bus, model, 1).status()
            return str(status.state), status.readings["output_frequency"].quality

    assert run(scenario(path)) == ("stopped", Quality.GOOD)
    assert run(scenario("df800")) == ("unknown", Quality.BAD)


def test_a_byte_order_mark_is_skipped(own: Path) -> None:
    (own / "mine.toml").write_text('format = 1\nextends = "vc660"\n', encoding="utf-8-sig")
    assert profiles.load(own / "mine.toml").family == "modbus"


def test_a_file_that_can_not_be_read_is_rejected_like_any_other(own: Path) -> None:
    (own / "gone.toml").symlink_to(own / "nowhere")
    with pytest.raises(ProfileError) as caught:
        profiles.load("gone")
    assert (caught.value.params["diagnostics"][0].kind, Path(caught.value.params["file"]).name) == (
        "unreadable",
        "gone.toml",
    )
