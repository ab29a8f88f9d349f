"""The scan finds who is there and how the line is set, in virtual time; it only ever reads."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, ports, profiles
from drivebus.bus import Bus
from drivebus.cli import output
from drivebus.cli.errors import ExitCode
from drivebus.cli.scan_output import print_scan
from drivebus.cli.scanning import ScanRequest
from drivebus.commissioning import scan, scan_plan
from drivebus.commissioning.scan import DetectedDrive, ScanProgress
from drivebus.commissioning.scan_plan import ScanPass
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import ChecksumError
from drivebus.profiles.load import included_models
from drivebus.protocols.checksum import crc16
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.port import find_simulated_bus
from drivebus.testing import virtual_time
from drivebus.testing.bus_script import ScriptedPort, Wire, silent_wire

ROOT = Path(__file__).resolve().parents[2]
ALL = ("c320", "dzb100", "vc660", "df800")


pytestmark = pytest.mark.usefixtures("clean_simulated_buses")


def plan(*models: str, **options: Any) -> list[ScanPass]:
    return scan_plan.plan_scan([profiles.load(model) for model in models or ALL], **options)


def default_plan(**options: Any) -> list[ScanPass]:
    """Return the passes of a scan without options."""
    return ScanRequest(port="sim://vc660@1", **options).plan()


def walk(link: str, passes: list[ScanPass], **options: Any) -> tuple[list[DetectedDrive], ScanProgress]:
    """Scan a simulated line in virtual time."""
    progress = ScanProgress(total_s=sum(scan_pass.duration_s for scan_pass in passes))

    def open_port(settings: SerialSettings) -> ports.Port:
        return ports.open_port(link, baud=settings.baud, format=settings.format)

    return virtual_time.run(scan.scan(passes, open_port, progress, **options)), progress


@pytest.mark.parametrize(
    ("link", "model", "encoding", "address", "settings"),
    [
        ("sim://c320@3?name=a&drives=9600-8E1", "c320", "ascii", 3, "9600 8E1"),
        ("sim://c320@5?name=a&drives=19200-8N1", "c320", "ascii", 5, "19200 8N1"),
        ("sim://dzb100@2?name=a&drives=4800-8E1", "dzb100", "ascii", 2, "4800 8E1"),
        ("sim://vc660@4?name=a&drives=19200-8N1", "vc660", "rtu", 4, "19200 8N1"),
        ("sim://df800@1?name=a&drives=9600-8N1", "df800", "rtu", 1, "9600 8N1"),
    ],
)
def test_each_family_is_found_with_its_address_and_line_settings(
    link: str, model: str, encoding: str, address: int, settings: str
) -> None:
    found, _ = walk(link, plan(addresses=range(1, 6)))
    sure = next(drive for drive in found if drive.valid_reply)
    assert (sure.models[0], sure.encoding, sure.address, str(sure.settings)) == (model, encoding, address, settings)


def test_a_c320_answers_in_both_of_its_encodings_and_is_listed_once() -> None:
    found, _ = walk("sim://c320@1?name=a&drives=9600-8E1", plan("c320", addresses=(1,), bauds=(9600,)))
    assert [drive.encoding for drive in found if drive.valid_reply] == ["ascii"]


@pytest.mark.parametrize("model", ["c320", "c300", "e300", "e350", "e500", "e550"])
def test_models_with_the_same_frames_are_listed_together_with_their_steps(model: str) -> None:
    """Their setpoints differ by a factor of ten, so that no one of them may be named; the E350's is only assumed."""
    models = scan_plan.with_look_alikes([profiles.load("c320")])
    passes = scan_plan.plan_scan(models, addresses=(1,), bauds=(9600,), formats=("8E1",), encodings=("ascii",))
    [found], _ = walk(f"sim://{model}@1?name=a&drives=9600-8E1", passes)
    assert found.doubtful and found.valid_reply and "e350" in found.models
    assert found.setpoint_steps_hz == {"c320": 0.01, "c300": 0.01, "e300": 0.1, "e500": 0.1, "e550": 0.1}


LIKELY_LIMIT_S = 180.0


def test_the_likely_settings_and_addresses_come_first_and_take_less_than_three_minutes() -> None:
    passes = default_plan()
    likely_s, total_s = scan_plan.durations_s(passes)
    assert likely_s < LIKELY_LIMIT_S < total_s
    first = [scan_pass for scan_pass in passes if scan_pass.is_likely]
    assert passes[: len(first)] == first
    for model in ALL:
        profile = profiles.load(model)
        wanted = {
            (encoding, str(SerialSettings.parse(baud, format)), address)
            for encoding in profile.encodings
            for baud in (9600, 19200, 4800, 38400)  # the manual of a C320 ends at 19200, that of a DZB100 at 4800
            for format in profile.serial.formats
            for address in range(1, 9)
        }
        searched = {
            (scan_pass.candidates[0].encoding, str(scan_pass.settings), address)
            for scan_pass in first
            for address in scan_pass.addresses
            if profile in [candidate.profile for candidate in scan_pass.candidates]
        }
        assert wanted <= searched, model
    every = [
        (scan_pass.candidates[0].kind, str(scan_pass.settings), address)
        for scan_pass in passes
        for address in scan_pass.addresses
    ]
    assert len(every) == len(set(every)), "no address is probed twice"


@pytest.mark.parametrize("model", ["c320", "dzb100"])
def test_a_drive_at_a_baud_rate_that_its_manual_does_not_have_is_found_at_the_likely_addresses(model: str) -> None:
    found, progress = walk(f"sim://{model}@8?name=a&drives=38400-8E1", default_plan(addresses=range(1, 9)))
    assert [(drive.models[0], drive.address, str(drive.settings)) for drive in found] == [(model, 8, "38400 8E1")]
    assert progress.done_s < LIKELY_LIMIT_S
    documented = profiles.load(model).serial.bauds
    for part in plan(model):
        assert part.is_documented is (part.settings.baud in documented), part.settings
        assert part.is_documented or (part.is_likely and max(part.addresses) == 8), part.settings
    assert {part.settings.baud for part in plan(model, bauds=(2400,))} == {2400}


def test_the_settings_of_the_manuals_are_tried_before_the_other_likely_ones() -> None:
    documented = [scan_pass.is_documented for scan_pass in default_plan() if scan_pass.is_likely]
    assert documented == sorted(documented, reverse=True) and not all(documented)


def test_the_readme_announces_the_duration_of_a_scan() -> None:
    likely_s, total_s = scan_plan.durations_s(default_plan())
    minutes = math.ceil(total_s / 60)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"settings; 2 min, at most {minutes} min" in readme and 60 < likely_s <= 95


def test_a_vc660_is_not_taken_for_the_df800_whose_registers_it_has_too() -> None:
    passes = plan("df800", "vc660", addresses=(1,), encodings=("rtu",), bauds=(9600,), formats=("8N1",))
    found, _ = walk("sim://vc660@1?name=a&drives=9600-8N1", passes)
    assert [drive.models for drive in found] == [("vc660",)]


def test_a_df800_that_rejects_the_status_register_of_others_is_still_found() -> None:
    passes = plan("vc660", "df800", addresses=(1,), encodings=("rtu",), bauds=(9600,), formats=("8N1",))
    found, _ = walk("sim://df800@1?name=a&drives=9600-8N1", passes)
    assert [drive.models for drive in found] == [("df800",)]


def test_an_empty_line_takes_as_long_as_planned() -> None:
    passes = plan("c320", addresses=range(1, 9), bauds=(9600,), formats=("8E1",))

    async def timed() -> float:
        begun = asyncio.get_running_loop().time()
        port = "sim://c320@30?name=a&drives=9600-8E1"
        progress = ScanProgress(total_s=0.0)
        await scan.scan(passes, lambda s: ports.open_port(port, baud=s.baud, format=s.format), progress)
        return asyncio.get_running_loop().time() - begun

    assert virtual_time.run(timed()) == pytest.approx(sum(scan_pass.duration_s for scan_pass in passes), rel=0.1)


def test_after_a_reply_no_other_serial_settings_are_tried() -> None:
    """A pair of wires has one setting."""
    found, progress = walk(
        "sim://vc660@1?name=a&drives=9600-8N1", plan("vc660", addresses=range(1, 4), bauds=(9600, 19200))
    )
    assert {str(drive.settings) for drive in found} == {"9600 8N1"}
    assert progress.left_s == pytest.approx(0.0, abs=1e-6)


def test_factory_settings_are_tried_first() -> None:
    passes = plan("c320", "vc660")
    for likely in (True, False):
        factory = [scan_pass.has_factory_settings for scan_pass in passes if scan_pass.is_likely is likely]
        assert factory == sorted(factory, reverse=True)
    assert {str(scan_pass.settings) for scan_pass in passes if scan_pass.has_factory_settings} == {
        "9600 8E1",
        "9600 8N1",
    }


def test_the_broadcast_address_is_never_probed() -> None:
    for part in plan():
        broadcasts = {candidate.profile.broadcast for candidate in part.candidates}
        assert not broadcasts & set(part.addresses)


@pytest.mark.parametrize("model", profiles.models())
def test_the_question_is_a_pure_read_of_every_model_in_every_encoding(model: str) -> None:
    profile = profiles.load(model)
    for encoding in profile.encodings:
        dialect = create_dialect(profile, max(1, profile.addresses[0]), encoding=encoding)
        assert (
            dialect.station_config.effect_of(
                dialect.station_config.codec.encode_request(scan_plan.probe_request(dialect))
            )
            is Effect.NONE
        )


def test_a_scan_has_no_effect_on_running_motors_and_drives() -> None:
    """Poll and read frames have no command effect in any station."""
    link = "sim://c320@1-2?name=quiet&drives=9600-8E1"

    async def go() -> list[tuple[int, int]]:
        port = ports.open_port(link, baud=9600, format="8E1")
        async with Bus(port):
            for station in find_simulated_bus("quiet").stations:
                station.keypad_run(20.0)
        before = [(s.motor.starts, sum(s.memory.ram_writes.values())) for s in find_simulated_bus("quiet").stations]
        passes = plan(addresses=range(1, 4))
        opener = lambda s: ports.open_port(link, baud=s.baud, format=s.format)  # noqa: E731
        await scan.scan(passes, opener, ScanProgress(total_s=0.0), keep_going=True)
        after = [(s.motor.starts, sum(s.memory.ram_writes.values())) for s in find_simulated_bus("quiet").stations]
        assert after == before
        return after

    assert virtual_time.run(go()) == [(1, 0), (1, 0)]


def test_what_was_found_stays_when_the_scan_is_cancelled() -> None:
    link = "sim://c320@1?name=a&drives=9600-8E1"
    passes = plan("c320", encodings=("ascii",), bauds=(9600,), formats=("8E1",))
    progress = ScanProgress(total_s=sum(scan_pass.duration_s for scan_pass in passes))

    async def aborted() -> None:
        opener = lambda s: ports.open_port(link, baud=s.baud, format=s.format)  # noqa: E731
        task = asyncio.create_task(scan.scan(passes, opener, progress))
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    virtual_time.run(aborted())
    assert [drive.address for drive in progress.found] == [1]
    assert progress.left_s > 0


def test_another_master_is_detected_before_anything_is_sent() -> None:
    link = "sim://c320@1?name=shared&drives=9600-8E1"

    async def go() -> tuple[int, int]:
        other = ports.open_port(link, baud=9600, format="8E1")
        async with Bus(other) as bus:
            dialect = create_dialect(profiles.load("c320"), 1)
            bus.add_station(dialect.station_config)
            from drivebus.bus import Poll

            bus.start_polling(1, [Poll(dialect.state_reads()[0], 0.2)], lambda answer: None)
            mine = ports.open_port(link, baud=9600, format="8E1")
            received = await scan.sniff(mine, 2.0)
            return received.count, len(received.first)

    count, first = virtual_time.run(go())
    assert count >= 10 * (14 + 18)
    assert 64 >= first > 0


def test_no_reply_is_reported_as_no_reply() -> None:
    async def go() -> int:
        return (await scan.sniff(ports.open_port("sim://c320@1?name=a"), 2.0)).count

    assert virtual_time.run(go()) == 0


EIGHT = ("vc660", "df800", "gd10", "skf8000", "eds300", "ms300", "vf51", "optidrive_e3")


def scan_9600(
    models: tuple[str, ...], link: str, addresses: list[int], encodings: list[str] | None = None
) -> tuple[list[DetectedDrive], float]:
    """Scan at 9600 8N1; the seconds are of the virtual clock."""
    passes = plan(*models, addresses=addresses, encodings=encodings, fixed=SerialSettings.parse(9600, "8N1"))

    async def timed() -> tuple[list[DetectedDrive], float]:
        started_at = asyncio.get_running_loop().time()
        found = await scan.scan(passes, lambda line: ports.open_port(link), ScanProgress(total_s=1.0))
        return found, asyncio.get_running_loop().time() - started_at

    return virtual_time.run(timed())


FIRST_EIGHT = ("c320", "c300", "e300", "e500", "e550", "dzb100", "vc660", "df800")


@pytest.mark.parametrize("model", ["vc660", "gd10", "skf8000"])
def test_a_scan_of_every_model_takes_at_most_twice_the_time_of_the_first_eight(model: str) -> None:
    """An address costs what its slowest protocol waits; only one that answers is asked for each map."""
    link = f"sim://{model}@1-6?drives=9600-8N1&baud=9600&format=8N1&name="
    addresses = list(range(1, 32))
    few_s, all_s = (
        scan_9600(names, link + str(len(names)), addresses)[1] for names in (FIRST_EIGHT, tuple(profiles.models()))
    )
    assert all_s <= 2.0 * few_s


def test_an_address_that_answers_is_asked_once_for_each_map_in_50_ms() -> None:
    """Models with the same request are probed once."""
    link = "sim://vc660@1?drives=9600-8N1&baud=9600&format=8N1&name=maps"
    loaded = [profiles.load(name) for name in profiles.models()]
    rtu = [profile for profile in loaded if profile.family == "modbus" and "rtu" in profile.encodings]
    maps = {str(scan_plan.probe_request(create_dialect(profile, 1, encoding="rtu"))) for profile in rtu}
    seconds = scan_9600(tuple(profile.model for profile in rtu), link, [1], encodings=["rtu"])[1]
    assert len(maps) < len(rtu) / 4 and seconds <= 0.05 * len(maps)


@pytest.mark.parametrize(
    ("model", "first", "others"),
    [
        ("skf8000", "md500_plus", {"vc660", "gd10", "eds800"}),
        ("pi500", "spe_b", {"vc660", "skf8000", "eds800"}),
        ("eds800", "eds1300", {"vc660", "gd10"}),
        ("vc660", "vc660", {"skf8000", "pi500", "gd10", "df800"}),
    ],
)
def test_further_reads_distinguish_models_with_the_same_status(model: str, first: str, others: set[str]) -> None:
    """The registers of the readings differ; a status register that may be a parameter is named last."""
    link = f"sim://{model}@1?drives=9600-8N1&baud=9600&format=8N1&name=alike"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert found.models[0] == first and model in found.models and not others & {*found.models}


def test_a_df800_is_listed_beside_models_whose_status_register_is_one_of_its_parameters() -> None:
    """It was named a model of another maker, whose status is at 5."""
    link = "sim://df800@1?drives=9600-8N1&baud=9600&format=8N1&name=parameters"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert "df800" in found.models and found.doubtful


def test_a_scan_names_no_model_whose_status_can_not_have_the_value_that_was_read() -> None:
    """A Goodrive at rest reads 0 at 3000H, which is no state of the MD380 map."""
    found, _ = scan_9600(EIGHT, "sim://gd10@1?drives=9600-8N1&baud=9600&format=8N1&name=one", [1], encodings=["rtu"])
    assert "gd10" in found[0].models and "skf8000" not in found[0].models


@pytest.mark.parametrize(("model", "named"), [("gd300", ("gd300",)), ("gd200", ("gd200", "gd200l"))])
def test_a_code_names_the_model_among_those_with_the_same_registers(model: str, named: tuple[str, ...]) -> None:
    """Eight Goodrives and others answer the same reads; 2103H tells which one it is."""
    link = f"sim://{model}@1?drives=9600-8N1&baud=9600&format=8N1&name=code"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert found.models == named and found.doubtful is (len(named) > 1)


@pytest.mark.parametrize("model", ["huanyang_h2a", "huanyang_p2a"])
def test_a_byte_count_of_two_bytes_names_the_models_that_reply_so(model: str) -> None:
    """Command, state and their registers are those of the MD380 map."""
    link = f"sim://{model}@1?drives=9600-8N1&baud=9600&format=8N1&name=long"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert found.models == ("huanyang_h2a", "huanyang_p2a") and found.valid_reply


def test_a_drive_with_the_standard_byte_count_is_not_taken_for_one_with_two_bytes() -> None:
    link = "sim://skf8000@1?drives=9600-8N1&baud=9600&format=8N1&name=short"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert "skf8000" in found.models and not {"huanyang_h2a", "huanyang_p2a"} & {*found.models}


@pytest.mark.parametrize(("model", "named"), [("vf_s15", ("vf_s15",)), ("vf_s11", ("vf_s11", "vf_s15"))])
def test_the_series_code_names_a_vf_s15(model: str, named: tuple[str, ...]) -> None:
    """The source of the VF-S11 does not say what it has at FB07H."""
    link = f"sim://{model}@1?drives=9600-8N1&baud=9600&format=8N1&name=series"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [1], encodings=["rtu"])
    assert found.models == named


@pytest.fixture(scope="module")
def passes_at_2() -> list[ScanPass]:
    return default_plan(addresses=(2,))


@pytest.mark.parametrize("model", included_models())
def test_a_scan_without_options_names_each_model_at_its_factory_setting(
    model: str, passes_at_2: list[ScanPass]
) -> None:
    """The default knew two Modbus models and named 27 others as one of them."""
    line = profiles.load(model).serial
    found, _ = walk(f"sim://{model}@2?name=own&drives={line.baud}-{line.format}", passes_at_2)
    named = [drive for drive in found if drive.models]
    assert [model in drive.models for drive in named] == [True]
    assert named[0].doubtful or named[0].models == (model,)


def test_a_scan_without_options_keeps_to_the_settings_of_common_models_and_factory_settings() -> None:
    """Every setting of every model took 80 minutes instead of 40."""
    likely_s, total_s = scan_plan.durations_s(default_plan())
    assert likely_s <= 95 and total_s < 50 * 60
    settings = {(scan_pass.candidates[0].encoding, str(scan_pass.settings)) for scan_pass in default_plan()}
    assert ("rtu", "115200 8N1") in settings and ("rtu", "57600 8N1") not in settings
    assert ("ascii", "9600 7N2") in settings and ("ascii", "19200 7N2") not in settings
    named = {str(scan_pass.settings) for scan_pass in default_plan(models=("acs550",))}
    assert "57600 8N1" in named


def test_common_models_are_asked_for_first() -> None:
    first = {scan_pass.candidates[0].kind: scan_pass.candidates[0].profile.model for scan_pass in default_plan()}
    assert first[("modbus", "rtu")] == "vc660" and first[("modbus", "ascii")] == "df800"
    assert first[("sunfar", "ascii")] == "c320"


def test_binary_frames_are_not_sent_with_7_data_bits() -> None:
    passes = plan("ms300")
    assert {scan_pass.candidates[0].encoding for scan_pass in passes if scan_pass.settings.data_bits == 7} == {"ascii"}
    assert {scan_pass.candidates[0].encoding for scan_pass in passes} == {"ascii", "rtu"}


def test_a_probe_waits_for_the_slowest_model_searched_for() -> None:
    """A DF800 may take 100 ms; the probe of the VC660 before it waited for 24 ms."""
    settings = SerialSettings.parse(9600, "8N1")
    [both] = plan("vc660", "df800", addresses=(1,), encodings=("rtu",), fixed=settings)
    [alone] = plan("df800", addresses=(1,), fixed=settings, encodings=("rtu",))
    assert both.duration_s == pytest.approx(alone.duration_s, rel=0.01)
    dialect = create_dialect(profiles.load("vc660"), 1, encoding="rtu")
    assert both.station_config(dialect).timing.reply_delay_s == profiles.load("df800").timing.reply_delay_s


def scan_device(reply: Any, after_s: float = 0.01, **options: Any) -> tuple[list[DetectedDrive], int]:
    """Scan address 2 at 9600 8N1 without options; ``reply`` makes the device's bytes of a request to it.

    Return what was found, and the number of requests.
    """
    settings = SerialSettings.parse(9600, "8N1")
    passes = scan_plan.plan_scan(*options.pop("models"), **options, addresses=(2,), encodings=("rtu",), fixed=settings)

    def wire(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        return [(ended_at + after_s, reply(frame))]

    port = ScriptedPort(wire, settings)
    found = virtual_time.run(scan.scan(passes, lambda line: port, ScanProgress(total_s=1.0)))
    return found, len(port.sent)


def modbus_plan() -> dict[str, Any]:
    common, others = scan_plan.default_models()
    keep = [[profile for profile in models if profile.family == "modbus"] for models in (common, others)]
    return {"models": (keep[0],), "others": keep[1]}


def test_an_exception_to_every_read_is_a_device_of_another_model_and_no_noise() -> None:
    """Regression: 02 83 02 30 F1, the well-formed exception of an unknown Modbus device, was called noise."""

    def refuse(frame: bytes) -> bytes:
        head = bytes([frame[0], frame[1] | 0x80, 2])
        return head + crc16(head).to_bytes(2, "little")

    (found,), requests = scan_device(refuse, **modbus_plan())
    assert found.valid_reply and found.doubtful and found.models == () and requests > 20
    assert found.exchange[1] == bytes.fromhex("02 83 02 30 F1")


def test_noise_at_an_address_ends_its_probes_after_four() -> None:
    (found,), requests = scan_device(lambda frame: b"\x55\xaa\x00", **modbus_plan())
    assert not found.valid_reply and found.models == () and requests == scan.MAX_UNREADABLE_REPLIES == 4


class NoisyPort(ScriptedPort):
    """A port that receives ``burst`` every ``period_s`` up to a time, whatever is sent."""

    def __init__(self, burst: bytes, period_s: float, wire: Wire = silent_wire, until: float = math.inf) -> None:
        super().__init__(wire, SerialSettings.parse(9600, "8N1"))
        self.burst, self.period_s, self.until = burst, period_s, until

    async def open(self, receiver: Any) -> None:
        await super().open(receiver)
        asyncio.get_running_loop().call_soon(self._disturb, self.openings)

    def _disturb(self, opening: int) -> None:
        loop = asyncio.get_running_loop()
        if self._receiver is not None and loop.time() < self.until:
            self._deliver(self.burst, opening)
            loop.call_later(self.period_s, self._disturb, opening)


@pytest.mark.parametrize("addresses", [range(1, 3), range(1, 9), range(1, 31)])
@pytest.mark.parametrize(
    ("burst", "period_s"), [(b"\x55", 0.001), (b"\x55", 0.02), (b"\x55\xaa", 0.05), (b"\x55" * 400, 0.5)]
)
def test_noise_at_most_doubles_the_announced_time_and_adds_five_seconds(
    burst: bytes, period_s: float, addresses: range, capsys: pytest.CaptureFixture[str]
) -> None:
    """A scan of 7 s took 16 to 56 s, and did not say that requests were never sent."""
    common, others = scan_plan.default_models()
    port = NoisyPort(burst, period_s)
    passes = scan_plan.plan_scan(common, others=others, addresses=addresses, fixed=port.settings)
    progress = ScanProgress(total_s=sum(scan_pass.duration_s for scan_pass in passes))

    async def timed() -> float:
        await scan.scan(passes, lambda line: port, progress)
        return asyncio.get_running_loop().time()

    assert 0 < virtual_time.run(timed()) < 2 * scan_plan.durations_s(passes)[1] + scan.NOISE_ALLOWANCE_S + 1.0
    probes = sum(scan_pass.probe_count for scan_pass in passes)
    assert (progress.unsent == probes) is (len(port.sent) == 0) is (period_s == 0.001)
    print_scan("x", progress, None, ExitCode.FAILED)
    assert ("Requests that were not sent" in capsys.readouterr().err) is (progress.unsent > 0)


def test_a_drive_is_found_after_noise_that_takes_less_than_its_time() -> None:
    def stopped(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        head = bytes([2, 3, 2, 0, 3])
        return [(ended_at + 0.01, head + crc16(head).to_bytes(2, "little"))]

    port = NoisyPort(b"\x55", 0.001, stopped, until=0.9)
    passes = plan("vc660", addresses=(2,), fixed=port.settings)
    (found,) = virtual_time.run(scan.scan(passes, lambda line: port, ScanProgress(total_s=1.0)))
    assert found.models == ("vc660",) and found.valid_reply


@pytest.mark.parametrize("is_always", [False, True])
def test_a_damaged_reply_does_not_let_another_model_be_named(is_always: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A VC660 whose first status reply held a stray byte was called one of fifteen other models, and not a VC660."""
    probe, damaged = scan._probe, list[bytes]()

    async def damage(bus: Bus, station: Any, request: Any, expires_at: float | None) -> Any:
        result = await probe(bus, station, request, expires_at)
        if result.sent[2:4] == b"\x30\x00" and (is_always or not damaged):
            damaged.append(result.sent)
            result = replace(result, reply=None, error=ChecksumError("bus.other_reply"))
        return result

    monkeypatch.setattr(scan, "_probe", damage)
    link = "sim://vc660@2?drives=9600-8N1&baud=9600&format=8N1&name=damaged"
    (found,), _ = scan_9600(tuple(profiles.models()), link, [2], encodings=["rtu"])
    assert ("vc660" in found.models) is not is_always
    assert len(damaged) == (2 + scan.MAX_REPEATED_READS if is_always else 1)


@pytest.mark.parametrize(
    ("language", "note"),
    [("en", "a reply from address 0 to a request for 2: check"), ("zh", "对站号 2 的请求收到站号 0 的应答：")],
)
def test_a_reply_from_another_address_is_reported_and_not_taken_for_silence(
    language: str, note: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A VC660 that replies as address 0 was reported as a line without drives."""

    def from_address_0(frame: bytes) -> bytes:
        head = bytes([0, 3, 2, 0, 1])
        return head + crc16(head).to_bytes(2, "little")

    (found,), _ = scan_device(from_address_0, models=([profiles.load("vc660")],))
    assert (found.address, found.replied_address, found.models, found.valid_reply) == (2, 0, (), False)
    assert not found.replied_late
    monkeypatch.setattr(output, "language", lambda: language)
    print_scan("x", ScanProgress(total_s=1.0, found=[found]), None, ExitCode.FAILED)
    assert "".join(note.split()) in "".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("damage", "key"),
    [
        (lambda reply: b"\x00" + reply, "bus.stray_before"),
        (lambda reply: reply + b"\x00", "bus.trailing"),
        (lambda reply: reply + reply, "bus.second_reply"),
        (lambda reply: reply[:-1], None),
        (lambda reply: b"\x55\xaa\x00", None),
    ],
)
def test_a_scan_names_a_whole_reply_that_is_not_accepted_with_its_remedy_and_no_noise(
    damage: Callable[[bytes], bytes],
    key: str | None,
    language: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`scan` reported noise where `status` named the stray byte."""

    def stopped(frame: bytes) -> bytes:
        head = bytes([2, 3, 2, 0, 1])
        return damage(head + crc16(head).to_bytes(2, "little"))

    monkeypatch.setattr(output, "language", lambda: language)
    (found,), _ = scan_device(stopped, after_s=0.02, models=([profiles.load("vc660")],))
    assert (found.valid_reply, found.models, getattr(found.unusable_reply, "key", None)) == (False, (), key)
    print_scan("x", ScanProgress(total_s=1.0, found=[found]), None, ExitCode.FAILED)
    shown = "".join(capsys.readouterr().out.split())
    named = [] if found.unusable_reply is None else [found.unusable_reply.text(language), output.text(f"hint.{key}")]
    for text in named or [output.text("scan.no_valid_reply")]:
        assert "".join(text.split()) in shown
    assert ("".join(output.text("scan.no_valid_reply").split()) in shown) is (key is None)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_model_that_fits_only_partly_because_its_replies_come_twice_is_not_called_another_model(
    language: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first reply came once; "probably another model" sent its reader to the name plate."""
    numbers = count()

    def twice_later(frame: bytes) -> bytes:
        head = bytes([2, 3, 2 * frame[5], *[0] * (2 * frame[5] - 1), 1])
        reply = head + crc16(head).to_bytes(2, "little")
        return reply * (1 if next(numbers) == 0 else 2)

    monkeypatch.setattr(output, "language", lambda: language)
    (found,), _ = scan_device(twice_later, after_s=0.04, models=([profiles.load("vc660")],))
    assert (found.models, found.fits_partly) == (("vc660",), True)
    print_scan("x", ScanProgress(total_s=1.0, found=[found]), None, ExitCode.DONE)
    shown = "".join(capsys.readouterr().out.split())
    for text in (i18n.text("bus.second_reply", language, station=2), output.text("hint.bus.second_reply")):
        assert "".join(text.split()) in shown
    assert "".join(output.text("scan.partly").split()) not in shown


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_late_reply_to_an_earlier_request_of_the_scan_is_named(
    language: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A VC660 with a reply delay of 150 ms was listed as a wrong address of station 4."""
    settings = SerialSettings.parse(9600, "8N1")
    passes = plan("vc660", addresses=(1, 2, 3, 4), encodings=("rtu",), fixed=settings)
    head = bytes([2, 3, 2, 0, 1])

    def wire(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        late_s = passes[0].duration_s / 4 * 1.3  # in the middle of the request to address 4
        return [(ended_at + late_s, head + crc16(head).to_bytes(2, "little"))] if frame[0] == 2 else []

    port = ScriptedPort(wire, settings)
    (found,) = virtual_time.run(scan.scan(passes, lambda line: port, ScanProgress(total_s=1.0)))
    assert (found.replied_address, found.replied_late, found.models, found.valid_reply) == (2, True, (), False)
    assert found.address > 2
    monkeypatch.setattr(output, "language", lambda: language)
    print_scan("x", ScanProgress(total_s=1.0, found=[found]), None, ExitCode.FAILED)
    note = output.text("scan.late_reply", found=2, address=found.address)
    assert "F06.06" in note and "".join(note.split()) in "".join(capsys.readouterr().out.split())


def test_a_model_that_fits_only_partly_is_not_named_without_doubt() -> None:
    """Its status register answers, its other registers don't: it was the only one of those searched for."""

    def status_only(frame: bytes) -> bytes:
        is_status = frame[1:6] == bytes.fromhex("03 30 00 00 01")
        head = bytes([2, 3, 2, 0, 1]) if is_status else bytes([2, frame[1] | 0x80, 2])
        return head + crc16(head).to_bytes(2, "little")

    (found,), _ = scan_device(status_only, models=([profiles.load("vc660")],))
    assert found.models == ("vc660",) and found.fits_partly and found.doubtful


def test_the_announced_time_of_a_device_that_answers_is_kept() -> None:
    """It is asked for every model."""
    [likely] = default_plan(addresses=(2,), encoding="rtu", bauds=(9600,), formats=("8N1",))[:1]
    assert likely.candidates[0].profile.family == "modbus"
    link = "sim://vc660@2?drives=9600-8N1&baud=9600&format=8N1&name=announced"
    seconds = scan_9600(tuple(profiles.models()), link, [2], encodings=["rtu"])[1]
    assert seconds <= scan_plan.device_duration_s(likely) + likely.duration_s < 6
