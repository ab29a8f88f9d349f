"""Reading and writing parameters: RAM by default, EEPROM counted, everything read back."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.drives.context import DriveContext, DriveLimits
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.parameter_write import check_writes, confirmation_needed
from drivebus.drives.operations.parameters import read_values, write_values
from drivebus.drives.operations.preflight import read_preflight
from drivebus.drives.operations.status import comm_loss_behaviour
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.store import FileStore, MemoryStore
from drivebus.errors import (
    CapabilityError,
    CodeError,
    ConfigurationError,
    ConfirmationRequired,
    DrivebusError,
    EepromBudgetExceeded,
    LimitError,
    NotPermitted,
    PreflightError,
    ProfileError,
    StartInhibited,
)
from drivebus.profiles.notation import find_entries, parse_value
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.values import Quality, Reading
from fixtures.drives import FakeC320, FakeModbus, PureBus, SimulatedDrives, dialect_for, run_virtual


class ParameterBench:
    """Fake drive with its bus and store; ``write`` and ``read`` as a user calls them."""

    def __init__(self, model: str, station: Any, store: Any = None, budget: int = 20) -> None:
        self.dialect = dialect_for(model)
        self.store = store if store is not None else MemoryStore()
        self.bus = PureBus(dialect=self.dialect, station=station, store=self.store)
        self.memory = DriveContext(dialect=self.dialect, eeprom_budget=EepromBudget(self.store, "port/1", budget))

    def write(self, values: Mapping[str, float | str], save: bool = False, force: bool = False) -> Outcome:
        return self.bus.run(write_values(OperationContext(self.memory), values, save=save, force=force))

    def read(self, *names: str) -> dict[str, Reading]:
        return self.bus.run(read_values(OperationContext(self.memory), names))

    def writes(self) -> list[Any]:
        return self.bus.sent(sunfar.SunfarWriteParameter) + self.bus.sent(modbus.WriteRegister)


def test_a_write_goes_to_ram_and_is_read_back_behind_a_sync_probe() -> None:
    bench = ParameterBench("c320", FakeC320())
    outcome = bench.write({"F0.2": 30.0})
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.write_confirmed")
    written, probe, back = [ask.request for ask in bench.bus.requests]
    assert written == sunfar.SunfarWriteParameter(1, 0, 2, 3000, save=False)
    assert isinstance(probe, sunfar.SunfarReadParameter) and probe.group != 0
    assert back == sunfar.SunfarReadParameter(1, 0, 2)


def test_vc660_saves_at_its_own_address_and_only_on_request() -> None:
    bench = ParameterBench("vc660", FakeModbus())
    bench.write({"F00.02": 30.0})
    bench.write({"F00.02": 31.0}, save=True)
    assert [(r.register, r.value) for r in bench.writes()] == [(0x0002, 3000), (0x8002, 3100)]


@pytest.mark.parametrize("model", ["dzb100", "df800"])
def test_a_drive_that_can_only_write_its_eeprom_needs_save(model: str) -> None:
    bench = ParameterBench(model, FakeModbus())
    with pytest.raises(CapabilityError) as caught:
        bench.write({{"dzb100": "10", "df800": "F1.07"}[model]: 15.0})
    assert caught.value.key == "drives.save_needed"
    assert not bench.bus.requests


def test_a_save_of_the_stored_value_is_skipped() -> None:
    bench = ParameterBench("c320", FakeC320(parameters={(0, 1): 2, (0, 2): 3000}))
    outcome = bench.write({"F0.2": 30.0}, save=True)
    assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.write_skipped")
    assert not bench.writes()


def test_a_save_is_not_skipped_after_a_ram_only_write() -> None:
    """RAM holds 30 Hz already; the content of the EEPROM is unknown, and reading back shows RAM."""
    bench = ParameterBench("c320", FakeC320())
    bench.write({"F0.2": 30.0})
    outcome = bench.write({"F0.2": 30.0}, save=True)
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.save_acknowledged")
    assert [r.save for r in bench.writes()] == [False, True]
    assert bench.write({"F0.2": 30.0}, save=True).key == "drives.write_skipped"


@pytest.mark.parametrize("lost", [None, NotPermitted("bus.start_inhibited", station=1)])
def test_a_save_that_was_lost_after_a_ram_only_write_is_not_confirmed_by_ram(lost: Exception | None) -> None:
    """The next save is not skipped either: the EEPROM may still hold the old value."""
    fake = FakeC320()

    def losing(request: Any) -> Any:
        return lost if isinstance(request, sunfar.SunfarWriteParameter) and request.save else fake(request)

    bench = ParameterBench("c320", fake)
    bench.write({"F0.2": 30.0})
    bench.bus.station = losing
    if lost is None:
        outcome = bench.write({"F0.2": 30.0}, save=True)
        assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.save_unknown")
    else:
        with pytest.raises(NotPermitted):
            bench.write({"F0.2": 30.0}, save=True)
    bench.bus.station = fake
    assert bench.write({"F0.2": 30.0}, save=True).key == "drives.save_acknowledged"
    assert bench.write({"F0.2": 30.0}, save=True).key == "drives.write_skipped"


def test_the_budget_of_a_day_holds_and_the_next_day_has_its_own() -> None:
    bench = ParameterBench("c320", FakeC320(), budget=3)
    for number in range(3):
        bench.write({"F0.2": 10.0 + number}, save=True)
    with pytest.raises(EepromBudgetExceeded) as caught:
        bench.write({"F0.2": 40.0}, save=True)
    params = caught.value.params
    assert (caught.value.key, params["count"], params["budget"]) == ("drives.eeprom_budget", 3, 3)
    assert len(bench.writes()) == 3
    bench.bus.conditions = replace(bench.bus.conditions, day="2026-01-03")
    assert bench.write({"F0.2": 40.0}, save=True).succeeded


def test_a_clock_set_back_gives_no_new_budget() -> None:
    bench = ParameterBench("c320", FakeC320(), budget=1)
    bench.write({"F0.2": 10.0}, save=True)
    bench.bus.conditions = replace(bench.bus.conditions, day="2025-12-31")
    with pytest.raises(EepromBudgetExceeded) as caught:
        bench.write({"F0.2": 11.0}, save=True)
    assert (caught.value.key, caught.value.params["day"]) == ("drives.eeprom_clock", "2026-01-02")
    assert "2026-01-02" in caught.value.text("en") and "2026-01-02" in caught.value.text("zh")


def test_writes_under_a_clock_set_back_count_for_the_later_day() -> None:
    bench = ParameterBench("c320", FakeC320(), budget=2)
    for number, day in enumerate(("2026-01-02", "2025-12-31")):
        bench.bus.conditions = replace(bench.bus.conditions, day=day)
        bench.write({"F0.2": 10.0 + number}, save=True)
    bench.bus.conditions = replace(bench.bus.conditions, day="2026-01-02")
    with pytest.raises(EepromBudgetExceeded):
        bench.write({"F0.2": 40.0}, save=True)


def test_the_budget_outlives_the_program(tmp_path: Path) -> None:
    for number in range(2):
        ParameterBench("c320", FakeC320(), FileStore(tmp_path / "s.json"), 2).write({"F0.2": 10.0 + number}, save=True)
    with pytest.raises(EepromBudgetExceeded):
        ParameterBench("c320", FakeC320(), FileStore(tmp_path / "s.json"), 2).write({"F0.2": 40.0}, save=True)


@pytest.mark.parametrize("found", [-1, 2.0, "5", True, None])
def test_a_budget_is_a_whole_number(found: Any) -> None:
    with pytest.raises(ConfigurationError) as caught:
        DriveLimits(eeprom_writes_per_day=found)
    assert (caught.value.key, caught.value.params["found"]) == ("drives.eeprom_writes_per_day", found)


@pytest.mark.parametrize("name", ["minimum_hz", "maximum_hz"])
def test_a_frequency_limit_is_a_number(name: str) -> None:
    """NaN, as of a computation without data, was accepted, and the drive ran up to the limit of its model."""
    with pytest.raises(ConfigurationError) as caught:
        DriveLimits(**{name: float("nan")})
    assert (caught.value.key, caught.value.params) == ("drives.limit_is_nan", {"name": name})


def test_the_users_own_budget_holds_over_restarts(tmp_path: Path) -> None:
    """Counted whatever the budget is: one that is raised goes on where the old one ended, 0 saves nothing."""

    async def saved(budget: int, value: float) -> bool:
        limits = DriveLimits(eeprom_writes_per_day=budget)
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive(limits=limits, store=FileStore(tmp_path / "s.json"))
            try:
                return (await drive.write({"F0.2": value}, save=True)).succeeded
            except EepromBudgetExceeded as error:
                assert error.params["budget"] == budget
                assert not bench.station().memory.eeprom_writes
                return False

    tries = [(0, 10.0), (2, 11.0), (2, 12.0), (2, 13.0), (3, 14.0), (3, 15.0), (0, 16.0)]
    assert [run_virtual(saved(*attempt)) for attempt in tries] == [False, True, True, False, True, False, False]


def test_a_save_is_counted_before_it_is_sent() -> None:
    """A write that may have happened counts."""
    bench = ParameterBench("c320", FakeC320())
    wear = EepromBudget(bench.store, "port/1")
    seen: list[int] = []
    bench.bus.on_request = lambda ask: seen.append(wear.count("F0.2").today)
    bench.write({"F0.2": 10.0}, save=True)
    place = next(i for i, ask in enumerate(bench.bus.requests) if isinstance(ask.request, sunfar.SunfarWriteParameter))
    assert seen[place] == 1


def test_a_record_that_can_not_be_read_is_a_used_up_budget() -> None:
    store = MemoryStore()
    store.put("eeprom/port/1/F0.2", "{broken")
    with pytest.raises(EepromBudgetExceeded):
        ParameterBench("c320", FakeC320(), store).write({"F0.2": 10.0}, save=True)


@pytest.mark.parametrize(
    ("model", "name", "value", "error", "key"),
    [
        ("c320", "F0.2", 700.0, LimitError, "drives.parameter_range"),
        ("c320", "F0.2", -1.0, LimitError, "drives.parameter_range"),
        ("c320", "F0.2", 30.004, LimitError, "drives.parameter_step"),
        ("dzb100", "77", 3.0, LimitError, "drives.parameter_choice"),
        ("vc660", "F00.00", 1.0, CapabilityError, "drives.not_writable"),
        ("vc660", "F00.03", 1.0, CapabilityError, "drives.not_writable"),
        ("vc660", "3002H", 1.0, CapabilityError, "drives.signal_not_written"),
        ("vc660", "0x200B", 1.0, CapabilityError, "drives.register_not_listed"),
        ("c320", "F3.5", 1.0, CapabilityError, "drives.not_described"),
        ("c320", "output_frequency", 1.0, CapabilityError, "drives.signal_not_written"),
        ("c320", "nonsense", 1.0, ProfileError, "drives.unknown_names"),
    ],
)
def test_what_may_not_be_written_is_refused_before_sending(
    model: str, name: str, value: float, error: type[DrivebusError], key: str
) -> None:
    bench = ParameterBench(model, FakeC320() if model == "c320" else FakeModbus())
    with pytest.raises(error) as caught:
        bench.write({name: value}, save=model == "dzb100")
    assert caught.value.key == key
    assert not bench.bus.requests


@pytest.mark.parametrize(
    ("model", "name", "key"),
    [
        ("c320", "F2.07", "drives.not_described"),
        ("dzb100", "05", "drives.not_described"),
        ("df800", "F2.00", "drives.not_described"),
        ("vc660", "F00.00", "drives.not_writable"),
        ("vc660", "0x200B", "drives.register_not_listed"),
    ],
)
def test_the_refusal_of_a_write_gives_the_reason_and_the_way_out(model: str, name: str, key: str) -> None:
    with pytest.raises(CapabilityError) as caught:
        check_writes(dialect_for(model), {name: 1.0})
    assert caught.value.key == key
    assert ("profile of your own" in caught.value.text()) is (key == "drives.not_described")


MODBUS_MODELS = [model for model in profiles.models() if profiles.load(model).family == "modbus"]


@pytest.mark.parametrize("model", MODBUS_MODELS)
def test_a_write_to_the_command_word_or_the_set_frequency_names_the_commands_that_write_it(model: str) -> None:
    profile = profiles.load(model)
    keys = {"drives.register_is_setpoint": profile.setpoint_locators()}
    if profile.commands is not None and profile.commands.space == "holding":
        keys["drives.register_is_command"] = profile.command_locators()
    for key, locators in keys.items():
        assert locators
        for _, register in locators:
            with pytest.raises(CapabilityError) as caught:
                check_writes(dialect_for(model), {f"0x{register:04X}": "0080H"})
            assert caught.value.key == key
            words = {"en": ("write it (run", "written by run"), "zh": ("专用命令写入（run", "只由 run")}
            for language, either in words.items():
                assert any(text in caught.value.text(language) for text in either)


@pytest.mark.parametrize("save", [False, True])
@pytest.mark.parametrize(("model", "name"), [("df800", "2000H"), ("df800", "2001H"), ("vc660", "2000H")])
def test_a_write_to_a_command_register_is_named_before_its_memory(model: str, name: str, save: bool) -> None:
    """DF800 writes to EEPROM only: its refusal does not ask for ``save`` first."""
    bench = ParameterBench(model, FakeModbus())
    with pytest.raises(CapabilityError, match=r"is the command word|is the set frequency"):
        bench.write({name: "0080H"}, save=save)
    assert not bench.bus.requests


def test_a_parameter_is_written_once_a_profile_of_its_own_describes_it(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    text = '[parameters."F2.7"]\ntext = { en = "a", zh = "一" }\nevidence = "user"\n'
    own.write_text(f'format = 1\nextends = "c320"\nmodel = "own"\n{text}', encoding="utf-8")
    assert check_writes(dialect_for(str(own)), {"F2.07": 6.0})[0].raw == 6


def test_nothing_is_written_when_one_of_several_is_wrong() -> None:
    bench = ParameterBench("c320", FakeC320())
    with pytest.raises(LimitError):
        bench.write({"F0.2": 10.0, "F6.12": 256.0})
    assert not bench.bus.requests


@pytest.mark.parametrize(
    ("model", "name", "text", "word"),
    [
        ("c320", "F1.10", "0010", 0x0010),  # the manual's example 4.5
        ("c320", "F1.10", "0010H", 0x0010),
        ("c320", "F1.10", "0x10", 0x0010),
        ("c320", "F9.4", "0010H", 0x0010),
        ("c320", "F0.2", "0BB8H", 3000),
        ("dzb100", "78", "02", 2),
    ],
)
def test_a_value_in_the_notation_of_the_manual_is_the_word_that_the_manual_sends(
    model: str, name: str, text: str, word: int
) -> None:
    value = parse_value(text)
    assert check_writes(dialect_for(model), {name: value})[0].raw == word
    if model == "c320":
        bench = ParameterBench(model, FakeC320())
        assert bench.write({name: value}).status is OutcomeStatus.CONFIRMED
        assert bench.writes()[0].data == word


def test_a_digit_code_is_shown_with_all_its_digits() -> None:
    bench = ParameterBench("c320", FakeC320())
    outcome = bench.write({"F1.10": 10.0})
    assert (outcome.text(), bench.writes()[0].data) == ("F1.10 = 0010, read back", 0x0010)
    assert bench.write({"F9.4": "0010H"}).text() == "F9.4 = 0010H, read back"


def test_digits_behind_a_zero_are_rejected_with_both_meanings_where_they_are_ambiguous() -> None:
    bench = ParameterBench("c320", FakeC320())
    with pytest.raises(LimitError) as caught:
        bench.write({"F9.4": "0010"})
    assert caught.value.key == "drives.parameter_digits"
    assert "write 10 " in caught.value.text() and "0010H" in caught.value.text()
    assert not bench.bus.requests


@pytest.mark.parametrize(
    ("model", "name", "value", "nearest"),
    [
        ("c320", "F1.10", "2.5", "0002"),
        ("c320", "F6.12", 3.6, 4),
        ("c320", "F0.2", "10.004", 10.0),
        ("dzb100", "10", "15.04", 15.0),
    ],
)
def test_a_value_between_two_steps_of_its_parameter_is_rejected_and_not_rounded(
    model: str, name: str, value: float | str, nearest: float | str
) -> None:
    """Rounded, 2.5 as the code of a function would choose another function."""
    with pytest.raises(LimitError) as caught:
        check_writes(dialect_for(model), {name: value})
    assert (caught.value.key, caught.value.params["nearest"]) == ("drives.parameter_step", nearest)


@pytest.mark.parametrize(
    ("value", "shown"), [("1e-5", "0000"), (9.99999, "0010"), ("10", "0010"), ("0010", "0010"), ("0x10", "0x10")]
)
def test_a_write_is_reported_with_the_value_that_is_sent(value: float | str, shown: str) -> None:
    """A value within the rounding of another was confirmed: "F1.10 = 9.99999, read back", where 0010 was written."""
    [write] = check_writes(dialect_for("c320"), {"F1.10": value})
    assert write.value == shown


def test_a_negative_value_of_a_digit_code_is_shown_as_it_was_given() -> None:
    with pytest.raises(LimitError) as caught:
        check_writes(dialect_for("c320"), {"F1.10": -1})
    assert caught.value.params["value"] == -1, "it was -001"


def test_a_step_of_a_tenth_takes_what_its_sum_gives() -> None:
    assert check_writes(dialect_for("dzb100"), {"10": 0.1 + 0.2})[0].raw == 3


@pytest.mark.parametrize("text", ["1_0", "２", "٢", "nan", "inf", "1e", "", "0x1_0"])
def test_a_text_that_only_python_reads_as_a_number_is_no_value(text: str) -> None:
    """``float("1_0")`` is ten, where 1.0 may have been meant."""
    with pytest.raises(ValueError, match=f"^{text}$"):
        parse_value(text)


@pytest.mark.parametrize("value", ["1772H", "FFFFH", "1e", "00AAH", "1_0", "２"])
def test_a_word_outside_the_range_or_coding_of_its_parameter_is_rejected(value: str) -> None:
    beyond = value in ("1772H", "FFFFH")
    with pytest.raises(LimitError) as caught:
        check_writes(dialect_for("c320"), {"F6.12" if beyond else "F1.10": value})
    assert caught.value.key == ("drives.parameter_range" if beyond else "drives.parameter_word")


def with_group_sizes(model: str, folder: Path) -> str:
    """Return a model whose every parameter has an address: the group sizes of the VC660 are not published."""
    if model != "vc660":
        return model
    sizes = "\n".join(f"F{group:02d} = 20" for group in range(7))
    own = folder / "sized.toml"
    own.write_text(f'format = 1\nextends = "vc660"\nmodel = "sized"\n[group_sizes]\n{sizes}\n', encoding="utf-8")
    return str(own)


@pytest.mark.parametrize(
    ("model", "name", "value"),
    [("dzb100", "78", 0.0), ("df800", "F7.02", 0.0), ("vc660", "F06.03", 0.0), ("vc660", "F06.03", "0H")],
)
@pytest.mark.parametrize("force", [False, True])
def test_the_broadcast_address_is_never_written(
    model: str, name: str, value: float | str, force: bool, tmp_path: Path
) -> None:
    """The manual of the DF800 has no broadcast, so that what a drive does at its address 0 is not known."""
    bench = ParameterBench(with_group_sizes(model, tmp_path), FakeModbus())
    with pytest.raises(LimitError) as caught:
        bench.write({name: value}, save=True, force=force)
    key = "drives.write_address_zero" if model == "df800" else "drives.write_broadcast"
    assert (caught.value.key, caught.value.params["notation"]) == (key, name)
    assert not bench.bus.requests


@pytest.mark.parametrize(
    ("model", "name", "value", "key"),
    [
        ("dzb100", "78", 2.0, "drives.confirm_address"),
        ("dzb100", "77", 1.0, "drives.confirm_serial"),
        ("df800", "F7.02", 5.0, "drives.confirm_address"),
        ("df800", "F7.00", 1.0, "drives.confirm_serial"),
        ("df800", "F7.01", 3.0, "drives.confirm_serial"),
        ("vc660", "F06.04", 6.0, "drives.confirm_serial"),
        ("vc660", "F06.05", 2.0, "drives.confirm_serial"),
        ("vc660", "F06.06", 1000.0, "drives.confirm_reply_delay"),
        ("vc660", "F06.06", 25.0, "drives.confirm_reply_delay"),
    ],
)
def test_a_write_after_which_the_drive_may_not_be_reached_waits_for_a_confirmation(
    model: str, name: str, value: float, key: str, tmp_path: Path
) -> None:
    bench = ParameterBench(with_group_sizes(model, tmp_path), FakeModbus())
    with pytest.raises(ConfirmationRequired) as caught:
        bench.write({name: value}, save=True)
    assert caught.value.key == key and name in caught.value.text("zh") and "Way back" in caught.value.text()
    assert not bench.bus.requests
    if model == "df800":
        assert bench.write({name: value}, save=True, force=True).succeeded
        assert len(bench.writes()) == 1


def test_a_reply_delay_within_what_the_profile_expects_needs_no_confirmation(tmp_path: Path) -> None:
    bench = ParameterBench(with_group_sizes("vc660", tmp_path), FakeModbus())
    assert bench.write({"F06.06": 24.0}).succeeded
    assert len(bench.writes()) == 1


@pytest.mark.parametrize("expected_ms", [9, 13, 18, 24, 26, 36, 43])
def test_a_reply_delay_that_is_just_what_the_profile_expects_needs_no_confirmation(
    expected_ms: int, tmp_path: Path
) -> None:
    """9 × 0.001 is more than 0.009 in binary fractions."""
    profile = Path(with_group_sizes("vc660", tmp_path))
    with profile.open("a", encoding="utf-8") as own:
        own.write(f"[timing]\nreply_delay_s = {expected_ms / 1000}\n")
    bench = ParameterBench(str(profile), FakeModbus())
    assert bench.write({"F06.06": float(expected_ms)}).succeeded
    with pytest.raises(ConfirmationRequired):
        bench.write({"F06.06": expected_ms + 1.0})


@pytest.mark.parametrize(
    ("model", "name", "bus", "other"),
    [
        ("vc660", "F00.01", 4.0, 3.0),
        ("df800", "F1.01", 5.0, 1.0),
        ("df800", "F1.02", 2.0, 0.0),
        ("dzb100", "00", 2.0, 0.0),
        ("dzb100", "01", 3.0, 0.0),
        ("skf8000", "P0-02", 2.0, 0.0),
        ("skf8000", "P0-03", 9.0, 0.0),
        ("c320", "F0.1", 2.0, 0.0),
    ],
)
def test_a_write_that_takes_control_from_the_bus_waits_for_a_confirmation(
    model: str, name: str, bus: float, other: float
) -> None:
    dialect = dialect_for(model)
    needed = confirmation_needed(dialect, check_writes(dialect, {name: other})[0])
    assert needed is not None and needed.key == "drives.confirm_source"
    assert f"Way back: write {name} = {bus:g}" in needed.text() and f"写 {name} = {bus:g}" in needed.text("zh")
    assert confirmation_needed(dialect, check_writes(dialect, {name: bus})[0]) is None
    assert confirmation_needed(dialect, check_writes(dialect, {name: f"{int(other):04X}H"})[0]) is not None


def test_without_the_confirmation_the_source_of_commands_is_not_written() -> None:
    bench = ParameterBench("df800", FakeModbus(registers={102: 2}))
    with pytest.raises(ConfirmationRequired):
        bench.write({"F1.02": 0.0}, save=True)
    assert not bench.bus.requests
    assert bench.write({"F1.02": 0.0}, save=True, force=True).succeeded


def test_the_present_address_needs_no_confirmation() -> None:
    assert confirmation_needed(dialect_for("df800"), check_writes(dialect_for("df800"), {"F7.02": 1.0})[0]) is None


def test_a_drive_that_takes_its_new_address_at_once_accepted_the_write() -> None:
    class Moves(FakeModbus):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.silent = self.silent or isinstance(request, modbus.WriteRegister)
            return reply

    outcome = ParameterBench("df800", Moves()).write({"F7.02": 5.0}, save=True, force=True)
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.write_unreachable")


@pytest.mark.parametrize(
    ("model", "name", "value", "is_described"),
    [
        ("vc660", "F00.01", 2.0, True),  # the factory setting
        ("vc660", "F00.01", 3.0, False),
        ("c320", "F4.0", 0.0, False),
        ("c320", "F4.0", 1.0, True),
        ("c320", "F0.1", 0.0, False),
        ("df800", "F1.02", 0.0, False),
        ("df800", "F1.01", 1.0, False),
    ],
)
def test_values_that_a_manual_names_as_examples_are_no_limit(
    model: str, name: str, value: float, is_described: bool
) -> None:
    bench = ParameterBench(model, FakeC320() if model == "c320" else FakeModbus(registers={1: 4, 101: 5, 102: 2}))
    outcome = bench.write({name: value}, save=model == "df800", force=True)
    assert outcome.status is OutcomeStatus.CONFIRMED
    assert ("drives.parameter_undescribed" in dict(outcome.notes)) is not is_described


def test_a_write_that_reads_back_differently_failed() -> None:
    class Keeps(FakeC320):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.parameters[0, 2] = 5000
            return reply

    outcome = ParameterBench("c320", Keeps()).write({"F0.2": 30.0})
    assert (outcome.status, outcome.key, outcome.params["found"]) == (
        OutcomeStatus.FAILED,
        "drives.write_differs",
        50.0,
    )


def test_a_digit_code_that_reads_back_differently_is_shown_as_it_was_typed() -> None:
    """*0016 was sent, 0005H reads back* left open whether the two are of one notation."""

    class Keeps(FakeC320):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.parameters[1, 10] = 0x0005
            return reply

    typed = {"0016": "F1.10: 0016 was sent, 0005 reads back", "0016H": "F1.10: 0016H was sent, 0005H reads back"}
    for value, text in typed.items():
        assert ParameterBench("c320", Keeps()).write({"F1.10": value}).text("en") == text


def test_a_write_with_a_reserved_response_code_is_not_called_written() -> None:
    """Code 5 of a C320 is reserved: its reply is invalid, the value that reads back decides, a note names it."""

    class RepliesFive(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.SunfarWriteParameter):
                return CodeError("protocols.sunfar.response", expected=("0-4", "6-8"), found=5)
            return super().__call__(request)

    outcome = ParameterBench("c320", RepliesFive(parameters={(0, 1): 2, (0, 2): 5000})).write({"F0.2": 30.0})
    assert outcome.status is OutcomeStatus.FAILED
    assert outcome.text("en") == "F0.2: 30.0 Hz was sent, 50.0 Hz reads back"
    assert outcome.note_texts("en") == [
        "the reply to the write was not accepted: response code 5, which the manual reserves, is not one of 0-4, 6-8"
    ]
    assert outcome.note_texts("zh") == ["对该写入的应答未被采信：变频器响应码 5 为手册保留的代码，不在 0-4、6-8 之内"]


def test_an_unanswered_write_is_decided_by_reading_it() -> None:
    class Loses(FakeC320):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            return None if isinstance(request, sunfar.SunfarWriteParameter) else reply

    assert ParameterBench("c320", Loses()).write({"F0.2": 30.0}).status is OutcomeStatus.CONFIRMED


def test_no_value_is_nothing_to_write_and_one_is_not() -> None:
    bench = ParameterBench("c320", FakeC320())
    assert bench.write({}).key == "drives.nothing_to_write" and not bench.bus.requests
    assert bench.write({"F0.2": 30.0}).key == "drives.write_confirmed"


def test_a_drive_that_falls_silent_leaves_the_write_unknown() -> None:
    class Dies(FakeC320):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.silent = self.silent or isinstance(request, sunfar.SunfarWriteParameter)
            return reply

    outcome = ParameterBench("c320", Dies()).write({"F0.2": 30.0})
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.write_unknown")
    assert "could not be read back (station 1: no reply" in outcome.text("en") and "（站 1" in outcome.text("zh")


def test_a_write_whose_read_back_the_drive_rejects_says_so() -> None:
    class RejectsReads(FakeModbus):
        def __call__(self, request: Any) -> Any:
            is_read = isinstance(request, modbus.ReadRegisters) and self.written
            return modbus.ExceptionReply(1, 3, 2) if is_read else super().__call__(request)

    outcome = ParameterBench("vc660", RejectsReads()).write({"F00.02": 30.0})
    assert outcome.key == "drives.write_unknown" and "(the drive rejects the read)" in outcome.text("en")


def test_a_rejected_write_keeps_the_notes_of_earlier_ones_and_names_its_next_step() -> None:
    """Exceptions 2 and 3 belong to writes, and their next step was lost there."""
    bench = ParameterBench("vc660", FakeModbus(rejections={0x2007: 3}))
    outcome = bench.write({"2006H": 5.0, "2007H": 1.0, "2008H": 1.0})
    assert (outcome.status, outcome.params["code"]) == (OutcomeStatus.REFUSED, 3)
    keys = [key for key, _ in outcome.notes]
    assert keys == ["drives.write_acknowledged", "drives.modbus_remedy_3", "drives.write_unsent"]


def test_a_refused_write_says_why() -> None:
    class Locked(FakeC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sunfar.SunfarWriteParameter):
                return sunfar.SunfarReply(
                    address=1,
                    response=sunfar.SunfarResponse.PASSWORD,
                    state=sunfar.SunfarState.STOPPED,
                    group=0,
                    item=2,
                    data=0,
                )
            return super().__call__(request)

    outcome = ParameterBench("c320", Locked()).write({"F0.2": 30.0})
    assert (outcome.status, outcome.key) == (OutcomeStatus.REFUSED, "drives.sunfar_response_3")


def test_a_write_only_register_is_acknowledged_at_best() -> None:
    outcome = ParameterBench("vc660", FakeModbus()).write({"2006H": 5.0})
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.write_acknowledged")


@pytest.mark.parametrize("register", [f"200{n}H" for n in range(2, 10)])
def test_every_control_register_of_vc660_is_written_and_acknowledged_on_a_fresh_port(register: str) -> None:
    """The reply mirrors the write: a probe before it shows that it is no echo."""

    async def written() -> Outcome:
        async with SimulatedDrives("vc660") as bench:
            return await bench.drive().write({register: 1.0, "2007H": 1.0}, force=True)

    outcome = run_virtual(written())
    assert (outcome.status, outcome.key) == (OutcomeStatus.ACKNOWLEDGED, "drives.write_acknowledged")
    assert [params["notation"] for _, params in outcome.notes] == list(dict.fromkeys([register, "2007H"]))


def test_an_input_terminal_is_written_only_after_a_confirmation() -> None:
    bench = ParameterBench("vc660", FakeModbus())
    with pytest.raises(ConfirmationRequired) as caught:
        bench.write({"2006H": 1.0, "2002H": 1.0})
    assert (caught.value.key, caught.value.params["notation"]) == ("drives.confirm_inputs", "2002H")
    assert not bench.bus.requests


def test_an_input_terminal_is_not_written_while_starts_are_inhibited() -> None:
    bench = ParameterBench("vc660", FakeModbus())
    bench.bus.conditions = replace(bench.bus.conditions, start_inhibited=True)
    with pytest.raises(StartInhibited):
        bench.write({"2002H": 1.0}, force=True)
    assert not bench.writes()


def test_a_control_register_without_a_reply_is_unknown_and_names_what_was_not_sent() -> None:
    class Loses(FakeModbus):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            return None if isinstance(request, modbus.WriteRegister) else reply

    bench = ParameterBench("vc660", Loses())
    outcome = bench.write({"2006H": 1.0, "2007H": 2.0})
    assert (outcome.status, outcome.key) == (OutcomeStatus.UNKNOWN, "drives.write_unanswered")
    assert [(key, params["notation"]) for key, params in outcome.notes] == [("drives.write_unsent", "2007H")]
    assert [r.register for r in bench.writes()] == [0x2006]


def test_a_control_register_of_a_silent_drive_is_not_written() -> None:
    bench = ParameterBench("vc660", FakeModbus(silent=True))
    with pytest.raises(PreflightError) as caught:
        bench.write({"2006H": 1.0})
    assert caught.value.key == "drives.not_written"
    assert not bench.writes()


def test_a_parameter_that_cannot_be_compared_before_it_is_saved_is_not_written_and_named_with_the_reason() -> None:
    """The error was about the source of commands, with which F1.10 has nothing to do."""
    bench = ParameterBench("c320", FakeC320(silent=True))
    with pytest.raises(PreflightError) as caught:
        bench.write({"F1.10": 1.0}, save=True)
    assert caught.value.key == "drives.setting_unread"
    assert caught.value.params["notation"] == "F1.10" and str(caught.value.params["problem"])
    assert not bench.writes()


def test_a_control_register_is_not_saved() -> None:
    bench = ParameterBench("vc660", FakeModbus())
    with pytest.raises(CapabilityError) as caught:
        bench.write({"2006H": 1.0}, save=True)
    assert caught.value.key == "drives.not_saved"
    assert not bench.bus.requests


def test_every_written_parameter_is_named_in_the_notes() -> None:
    outcome = ParameterBench("c320", FakeC320()).write({"F0.2": 30.0, "F1.10": 16.0})
    assert [params["notation"] for _, params in outcome.notes] == ["F0.2", "F1.10"]


def test_parameters_and_signals_are_read_by_any_of_their_names() -> None:
    bench = ParameterBench("c320", FakeC320(output=1234, parameters={(0, 2): 3000}))
    found = bench.read("F0.02", "output_frequency", "d.0", "F3.5")
    assert (found["F0.02"].value, found["F0.02"].raw) == (30.0, 3000)
    assert found["output_frequency"].value == found["d.0"].value == 12.34
    assert found["F3.5"].raw == 0


def test_unknown_names_are_each_named_with_similar_ones_and_nothing_is_read() -> None:
    """The first one was named alone, without a word on the others."""
    bench = ParameterBench("c320", FakeC320())
    with pytest.raises(ProfileError) as caught:
        bench.read("F0.1", "output_frequence", "F0.300")
    _, unknown = find_entries(bench.dialect.profile, ("output_frequence", "F0.300"))
    assert caught.value.params["names"] == tuple(unknown)
    for language, begin in (("en", "nothing was sent: "), ("zh", "未发送任何数据：")):
        text = caught.value.text(language)
        assert text.startswith(begin) and "output_frequency" in text
        assert all(error.text(language) in text for error in unknown.values())
    assert not bench.bus.requests


def test_the_unknown_names_of_a_write_are_each_named_and_nothing_is_written() -> None:
    """The first one was named alone, although a read names each."""
    bench = ParameterBench("c320", FakeC320())
    with pytest.raises(ProfileError) as caught:
        bench.write({"F1.10": 1.0, "F0.300": 1.0, "F1.999": 1.0})
    assert (caught.value.key, caught.value.params["names"]) == ("drives.unknown_names", ("F0.300", "F1.999"))
    assert "c320 has no F0.300" in caught.value.text() and "c320 has no F1.999" in caught.value.text()
    assert not bench.bus.requests


def test_a_parameter_that_reads_0_in_a_fault_is_rejected() -> None:
    """The reply shows neither the item nor whether the read was executed."""
    bench = ParameterBench(
        "c320", FakeC320(state=sunfar.SunfarState.FAULT, fault_code=3, parameters={(0, 1): 0, (0, 2): 3000})
    )
    found = bench.read("F0.1", "F0.2")
    assert (found["F0.1"].value, found["F0.2"].value) == (None, 30.0)


def test_a_parameter_that_a_reply_in_a_fault_does_not_name_is_uncertain() -> None:
    reading = ParameterBench("c320", FakeC320(state=sunfar.SunfarState.FAULT, fault_code=3)).read("F0.1")["F0.1"]
    assert (reading.value, reading.quality, reading.reason) == (2.0, Quality.UNCERTAIN, "drives.item_not_echoed")


@pytest.mark.parametrize(("model", "name", "word"), [("df800", "F1.00", 5000), ("c320", "F9.4", 50)])
def test_a_parameter_without_a_published_scale_is_uncertain(model: str, name: str, word: int) -> None:
    station = FakeC320(parameters={(9, 4): word}) if model == "c320" else FakeModbus(registers={100: word})
    reading = ParameterBench(model, station).read(name)[name]
    assert (reading.raw, reading.quality) == (word, Quality.UNCERTAIN)
    assert reading.reason == "profiles.scale_unpublished"


@pytest.mark.parametrize(
    ("coding", "quality", "value"),
    [
        ("unknown", Quality.UNCERTAIN, 9.9),
        ("hex-0.1", Quality.GOOD, 9.9),
        ("decimal-0.1", Quality.GOOD, 6.3),
    ],
)
def test_the_current_of_dzb100_is_uncertain_until_the_query_coding_is_known(
    coding: str, quality: Quality, value: float
) -> None:
    dialect = dialect_for("dzb100", query_coding=coding)
    reply = dzb100.Dzb100Reply(head="Q", address=1, index=2, data=0x0063, accepted=True)
    reading = dialect.decode_readings(dzb100.Dzb100Query(1, 2), reply, 0.0)["output_current"]
    assert (reading.quality, reading.value) == (quality, value)


@pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6, 7, 8, 10, 11])
def test_an_exception_has_the_words_of_the_manual(code: int) -> None:
    rejection = dialect_for("vc660").rejection(modbus.ExceptionReply(1, 6, code))
    assert rejection is not None and rejection.code == code
    assert rejection.key == f"drives.modbus_exception_{code}" and rejection.explains_code
    words = {1: "无效命令码", 2: "无效数据地址", 3: "无效参数值", 4: "命令执行失败"}
    text = i18n.text(rejection.key, "zh", code=code)
    assert words.get(code, "异常码") in text and str(code) in text


def test_a_write_only_register_is_not_read() -> None:
    bench = ParameterBench("vc660", FakeModbus())
    assert bench.read("2006H")["2006H"].reason == "drives.write_only"
    assert not bench.bus.requests


def test_a_silent_drive_reads_as_nothing_with_the_reason() -> None:
    found = ParameterBench("c320", FakeC320(silent=True)).read("F0.2")
    assert (found["F0.2"].value, found["F0.2"].reason) == (None, "drives.no_answer")


# --- pre-flight ---------------------------------------------------------------------------------------------------


def test_the_preflight_reports_satisfied_unmet_and_unreadable_preconditions() -> None:
    bench = ParameterBench("vc660", FakeModbus(registers={1: 2}))
    found = bench.bus.run(read_preflight(OperationContext(bench.memory)))
    assert [m.notation for m in found.unmet] == ["F00.01"]
    assert [notation for notation, _ in found.unreadable] == ["F01.00"]
    assert not found.passed


def test_the_preflight_reads_the_ramps_where_the_profile_names_them() -> None:
    bench = ParameterBench("df800", FakeModbus(registers={101: 5, 102: 2, 107: 150, 108: 40}))
    found = bench.bus.run(read_preflight(OperationContext(bench.memory)))
    assert found.satisfied == ("F1.01", "F1.02")
    assert (bench.memory.acceleration_s, bench.memory.deceleration_s) == (15.0, 4.0)


def test_a_drive_without_a_reply_passes_no_preflight() -> None:
    bench = ParameterBench("c320", FakeC320(silent=True))
    with pytest.raises(PreflightError) as caught:
        bench.bus.run(read_preflight(OperationContext(bench.memory)))
    assert caught.value.key == "drives.preflight_unread"


def test_the_reason_of_an_unread_precondition_has_the_language_of_its_sentence() -> None:
    """The Chinese sentence had an English reason."""
    bench = ParameterBench("c320", FakeC320(silent=True))
    with pytest.raises(PreflightError) as caught:
        bench.bus.run(read_preflight(OperationContext(bench.memory)))
    reason = caught.value.__cause__
    assert isinstance(reason, DrivebusError)
    assert all(reason.text(language) in caught.value.text(language) for language in ("en", "zh"))


# --- the store ----------------------------------------------------------------------------------------------------


def test_a_file_store_keeps_values_and_replaces_the_file_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "s.json"
    store = FileStore(path)
    assert store.get("a") is None
    store.put("a", "1")
    store.put("b", "2")
    assert (FileStore(path).get("a"), FileStore(path).get("b")) == ("1", "2")
    assert json.loads(path.read_text())["format"] == 1
    assert sorted(p.name for p in path.parent.iterdir()) == ["s.json", "s.lock"]


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 2, "values": {}}', '{"format": 1, "values": {"a": 1}}'])
def test_a_store_of_another_format_is_refused_and_never_overwritten(tmp_path: Path, text: str) -> None:
    path = tmp_path / "s.json"
    path.write_text(text)
    for access in (lambda: FileStore(path).get("a"), lambda: FileStore(path).put("a", "1")):
        with pytest.raises(ConfigurationError) as caught:
            access()
        assert caught.value.key == "drives.store_unreadable"
        assert "values" not in text or caught.value.params["problem"].key == "drives.store_format"
    assert path.read_text() == text


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "s.json"
    FileStore(path).put("a", "1")

    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(ConfigurationError, match="No space") as caught:
        FileStore(path).put("a", "2")
    assert (caught.value.key, caught.value.params["file"]) == ("drives.store_unwritable", str(path))
    monkeypatch.undo()
    assert FileStore(path).get("a") == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s.json", "s.lock"]


def test_an_update_that_raises_changes_nothing(tmp_path: Path) -> None:
    def refuse(old: str | None) -> str:
        raise LookupError(old)

    for store in (MemoryStore(), FileStore(tmp_path / "s.json")):
        store.put("a", "1")
        with pytest.raises(LookupError, match="1"):
            store.update("a", refuse)
        assert store.get("a") == "1"


CHARGE_MANY = """
import sys
from drivebus.drives.store import FileStore
from drivebus.drives.operations.steps import run_pure
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.errors import EepromBudgetExceeded
store, counted = FileStore(sys.argv[1]), 0
for n in range(25):
    try:
        charge = EepromBudget(store, "port/1", int(sys.argv[2])).consume("F0.2", "2026-01-02")
        run_pure(charge, lambda step: store.update(step.key, step.change))
        counted += 1
    except EepromBudgetExceeded:
        pass
print(counted)
"""


@pytest.mark.parametrize(("budget", "expected"), [(1000, 50), (30, 30)])
def test_two_programs_that_save_the_same_parameter_lose_no_count(tmp_path: Path, budget: int, expected: int) -> None:
    """Together they do not save more often than the budget allows."""
    path = tmp_path / "s.json"
    command = [sys.executable, "-c", CHARGE_MANY, str(path), str(budget)]
    programs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    counted = [int(program.communicate(timeout=60)[0]) for program in programs]
    assert sum(counted) == EepromBudget(FileStore(path), "port/1").count("F0.2").total == expected


class Msvcrt:
    """Windows' lock of a byte, held by another program for the first ``busy`` tries of ten seconds each."""

    LK_LOCK, LK_UNLCK = 1, 0

    def __init__(self, busy: int, error: int = errno.EDEADLK) -> None:
        self.busy, self.error = busy, error
        self.calls: list[tuple[int, int]] = []

    def locking(self, fd: int, mode: int, count: int) -> None:
        self.calls.append((mode, count))
        if mode == self.LK_LOCK and len(self.calls) <= self.busy:
            raise OSError(self.error, "locked")


def on_windows(monkeypatch: pytest.MonkeyPatch, msvcrt: Msvcrt) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", msvcrt)


def test_windows_waits_for_the_lock_and_releases_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    msvcrt = Msvcrt(busy=2)
    on_windows(monkeypatch, msvcrt)
    store = FileStore(tmp_path / "s.json")
    store.update("a", lambda old: f"{len(msvcrt.calls)}")
    assert store.get("a") == "3", "changed before it held the lock"
    assert msvcrt.calls == [(1, 1), (1, 1), (1, 1), (0, 1)]


def test_a_lock_that_windows_refuses_is_an_error_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_windows(monkeypatch, Msvcrt(busy=1, error=errno.EBADF))
    with pytest.raises(ConfigurationError, match="locked"):
        FileStore(tmp_path / "s.json").put("a", "1")
    assert not (tmp_path / "s.json").exists()


PUT_MANY = """
import sys
from drivebus.drives.store import FileStore
for n in range(20):
    FileStore(sys.argv[1]).put(f"{sys.argv[2]}{n}", str(n))
"""


def test_two_programs_lose_no_values_of_each_other(tmp_path: Path) -> None:
    path = str(tmp_path / "s.json")
    workers = [subprocess.Popen([sys.executable, "-c", PUT_MANY, path, name]) for name in "ab"]
    assert [worker.wait(60) for worker in workers] == [0, 0]
    store = FileStore(path)
    assert all(store.get(f"{name}{n}") == str(n) for name in "ab" for n in range(20))


def test_a_put_waits_for_another_program_that_is_writing(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    path = tmp_path / "s.json"
    with (tmp_path / "s.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        writer = subprocess.Popen([sys.executable, "-c", PUT_MANY, str(path), "a"])
        with pytest.raises(subprocess.TimeoutExpired):
            writer.wait(1.0)
        assert not path.exists()
        fcntl.flock(lock, fcntl.LOCK_UN)
        assert writer.wait(60) == 0
    assert FileStore(path).get("a19") == "19"


# --- what a drive does when its host dies -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time_raw", "action", "trips_values", "trips", "key"),
    [
        (30, 2, (2, 3), True, "drives.comm_loss_stops"),
        (30, 1, (2, 3), False, "drives.comm_loss_runs_on"),
        (30, 2, (), None, "drives.comm_loss_unknown"),
        (0, 2, (2, 3), False, "drives.comm_loss_off"),
    ],
)
def test_an_undocumented_communication_loss_behaviour_is_unknown(
    time_raw: int, action: int, trips_values: tuple[int, ...], trips: bool | None, key: str
) -> None:
    bench = ParameterBench("c320", FakeC320(parameters={(9, 4): time_raw, (9, 3): action}))
    rule = replace(bench.dialect.profile.comm_loss, trips_values=trips_values)
    bench.dialect.profile = replace(bench.dialect.profile, comm_loss=rule)
    found = bench.bus.run(comm_loss_behaviour(OperationContext(bench.memory)))
    assert (found.stops_on_comm_loss, found.key) == (trips, key)


def test_an_unreadable_communication_loss_timer_is_unknown() -> None:
    bench = ParameterBench("c320", FakeC320(silent=True))
    assert bench.bus.run(comm_loss_behaviour(OperationContext(bench.memory))).key == "drives.comm_loss_unread"


def test_the_default_store_lives_in_the_users_state_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from drivebus.drives.store import default_path

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_path() == tmp_path / "drivebus" / "store.json"


def test_an_impossible_value_is_named_without_decimals_that_were_not_given() -> None:
    with pytest.raises(LimitError) as caught:
        check_writes(dialect_for("vc660"), {"2006H": 8.0})
    assert (caught.value.key, caught.value.text("en")) == ("drives.parameter_range", "2006H can be 0 to 7; found 8")
