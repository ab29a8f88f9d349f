"""Every cell of the fault matrix has a check and texts, and planted faults fail their cells."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from generator import fault_matrix

from drivebus.bus import prepared_request
from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoDetector
from drivebus.bus.station import Station, StationEvent
from drivebus.bus.trace import TraceEvent
from drivebus.bus.transaction import Transaction
from drivebus.bus.unsolicited import UnsolicitedBytes
from drivebus.drives import Drive, bus_stop, permissives
from drivebus.drives.context import Preflight
from drivebus.drives.dialects import dzb100, sunfar
from drivebus.drives.dialects.command_word import CommandBits
from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.jog_session import JogSession
from drivebus.drives.operations import setpoint
from drivebus.drives.operations import status as comm_loss
from drivebus.drives.operations.status import CommLossReport
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.stop_supervisor import StopSupervisor
from drivebus.families.huanyang.dialect import HuanyangDialect
from drivebus.families.mitsubishi.dialect import MitsubishiDialect
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import StationTiming
from verification.campaign import CampaignRun
from verification.campaigns import matrix
from verification.fault_matrix.cell import COVERED, TABLE

CELLS_BY_NAME = {cell.name: cell for cell in matrix.ALL_CELLS}


def run_cell_once(name: str) -> CampaignRun:
    campaign_run = CampaignRun(campaign="matrix", seed=1, budget=1)
    held = matrix.run_cell(campaign_run, CELLS_BY_NAME[name], 0)
    assert held is not bool(campaign_run.violations)
    return campaign_run


def test_every_cell_has_a_check_and_texts_in_both_languages() -> None:
    """27 faults, six protocols, C320 and DF800 in both encodings. The C320 has no scale row; the computer link has no
    broadcast, no EEPROM and no scale row."""
    assert len(TABLE) == 27
    assert len(CELLS_BY_NAME) == 27 * len(COVERED) - 5
    for row in TABLE.values():
        texts = [row["fault"], row["shown"], *row["cells"].values(), row.get("missing", row["shown"])]
        assert all(text["en"] and text["zh"] for text in texts)
        assert any(cell.get("partly") for cell in row["cells"].values()) <= ("missing" in row)


def test_all_cells_run_before_the_next_seed() -> None:
    campaign_run = CampaignRun(campaign="matrix", seed=1, budget=3)
    matrix.run(campaign_run)
    assert campaign_run.figures["cells"] == {name: {"cases": 1, "held": 1} for name in list(CELLS_BY_NAME)[:3]}
    assert matrix.CAMPAIGN.full_budget % matrix.CAMPAIGN.ci_budget == 0


def test_an_exception_fails_the_cell() -> None:
    def breaks(at: Any) -> None:
        raise RuntimeError("broken")

    campaign_run = CampaignRun(campaign="matrix", seed=1, budget=1)
    assert not matrix.run_cell(campaign_run, replace(CELLS_BY_NAME["batches/vc660"], check=breaks), 0)
    assert "RuntimeError: broken" in campaign_run.violations[0]


# --- planted faults: one line of the product is wrong, and the cell that is about it fails ---------------------------

PlantedFault = Callable[[pytest.MonkeyPatch], None]


def replace_attribute(target: Any, name: str, value: Any) -> PlantedFault:
    return lambda patch: patch.setattr(target, name, value)


def both(*plants: PlantedFault) -> PlantedFault:
    def plant(patch: pytest.MonkeyPatch) -> None:
        for fault in plants:
            fault(patch)

    return plant


def no_lateness(self: Station, now: float) -> None:
    self._change(StationEvent.SUSPICION)
    self.suspect_since = self.quarantined_until = now


def nothing(*_: Any, **__: Any) -> None:
    return None


def forget(unsolicited: UnsolicitedBytes, now: float) -> list[TraceEvent]:
    unsolicited.reset()
    return []


def anything_goes(
    request: prepared_request.PreparedRequest, stations: Mapping[int, Station]
) -> prepared_request.PreparedRequest:
    request.effect = Effect.STOP
    return request


def as_before(self: BusCore, address: int) -> Any:
    return self.stations[address].state.presence


def says_yes(*_: Any, **__: Any) -> bool:
    return True


def says_no(*_: Any, **__: Any) -> bool:
    return False


def confirmed_at_once(op: Any, *_: Any, **__: Any) -> Any:
    yield from op.sync()
    return op.outcome(OutcomeStatus.CONFIRMED, "drives.setpoint_confirmed", frequency_hz=1.0)


def hunts(self: Transaction) -> bool:
    """Search for a reply anywhere in the received bytes."""
    self.buffer = self.buffer[1:]
    self.received_count -= 1
    self.bytes_needed = 1
    return bool(self.buffer)


def newest_alone(self: ReadingPairs, name: str) -> tuple[int, int] | None:
    raw = self.latest[name].raw if name in self.latest else None
    return None if raw is None else (raw, raw)


def unechoed(self: Transaction, data: bytes, now: float) -> bytes:
    return data


def deaf_to_marks(received: Any) -> Any:
    return lambda self, data, now, marks=0: received(self, data, now)


def impatient(self: Transaction, now: float) -> None:
    self.ends_at = now + self.prepared.gap_s


def without_adapter(self: StationTiming, line: Any, reply_bytes: int) -> float:
    return self.reply_delay_s + line.seconds(self.reply_delay_characters + reply_bytes)


def free_of_charge(self: EepromBudget, notation: str, day: str) -> Any:
    yield from ()


def stops_anyway(monitor: Any) -> Any:
    def watched(self: Drive, *arguments: Any, **named: Any) -> Any:
        self._task = asyncio.ensure_future(self.stop())  # type: ignore[attr-defined]
        return monitor(self, *arguments, **named)

    return watched


def lasting(arm: Any) -> Any:
    return lambda self, left_s: arm(self, 60.0)


def it_will_stop(op: Any) -> Any:
    yield from op.sync()
    return CommLossReport(True, "drives.comm_loss_stops", {"time": "1", "notation": "", "action": "", "value": 1})


async def taken_for_stopped(drive: Drive, *_: Any) -> Outcome:
    return Outcome(status=OutcomeStatus.CONFIRMED, key="drives.stop_confirmed", params={"state": "stopped"})


def one_word(self: CommandBits, pulse: int, level: int) -> tuple[int, ...]:
    return (pulse | level,)


def replays(self: BusCore, error: Any, now: float) -> list[Any]:
    """Queue the interrupted request again with its permit."""
    self.is_open = False
    transaction, self.transaction = self.transaction, None
    if transaction is not None:
        self.scheduler.requeue(transaction.prepared)
    return []


PLANTED_FAULTS: list[tuple[str, str, PlantedFault]] = [
    ("no_answer_read/vc660", "reads go once", replace_attribute(prepared_request, "READ_ATTEMPTS", 1)),
    ("no_answer_read/dzb100", "no quarantine", replace_attribute(Station, "mark_suspect", no_lateness)),
    ("no_answer_setpoint/vc660", "no read-back", replace_attribute(setpoint, "read_back_setpoint", confirmed_at_once)),
    (
        "no_answer_start/c320-ascii",
        "starts are resent",
        replace_attribute(prepared_request.PreparedRequest, "_max_write_attempts", lambda self: 3),
    ),
    (
        "no_answer_start/df800-rtu",
        "starts are resent",
        replace_attribute(prepared_request.PreparedRequest, "_max_write_attempts", lambda self: 3),
    ),
    ("no_answer_stop/vc660", "a stop is given up", replace_attribute(StopSupervisor, "start_repetition", nothing)),
    (
        "late_same_item/df800-ascii",
        "late answers uncounted",
        replace_attribute(UnsolicitedBytes, "classify_buffer", forget),
    ),
    ("late_other_item/vc660", "no doubt", replace_attribute(Station, "mark_suspect", nothing)),
    ("other_address/c320-hex", "no foreign master", replace_attribute(UnsolicitedBytes, "has_foreign_master", says_no)),
    ("truncated/df800-rtu", "no deadline", replace_attribute(Transaction, "_update_end", impatient)),
    (
        "trailing/c320-ascii",
        "a bad link may start",
        replace_attribute(permissives, "unmet_start_permissives", lambda *_: ()),
    ),
    ("garbage/vc660", "hunting", replace_attribute(Transaction, "_skip_leading_noise", hunts)),
    (
        "bit_flip/dzb100",
        "parity is ignored",
        replace_attribute(Transaction, "on_data", deaf_to_marks(Transaction.on_data)),
    ),
    ("bit_flip/dzb100", "one read decides", replace_attribute(ReadingPairs, "raw_pair", newest_alone)),
    ("digit_swap/fr-e500", "one read decides", replace_attribute(ReadingPairs, "raw_pair", newest_alone)),
    ("digit_swap/c320-hex", "one read decides", replace_attribute(ReadingPairs, "raw_pair", newest_alone)),
    (
        "echo/df800-rtu",
        "an echo is an answer",
        both(
            replace_attribute(EchoDetector, "filter_for", nothing),
            replace_attribute(EchoDetector, "accepts", says_yes),
            replace_attribute(Transaction, "_strip_before_tx_end", unechoed),
        ),
    ),
    ("echo/vc660", "a mirrored reply is an answer", replace_attribute(EchoDetector, "accepts", says_yes)),
    ("echo/df800-ascii", "a mirrored reply is an answer", replace_attribute(EchoDetector, "accepts", says_yes)),
    ("error_answer/dzb100", "no refusal", replace_attribute(dzb100.Dzb100Dialect, "rejection", nothing)),
    (
        "status_fault/c320-ascii",
        "values of a fault are good",
        replace_attribute(sunfar, "without_item_echo", lambda reading: reading),
    ),
    ("duplicate_address/dzb100", "no alarm", replace_attribute(Station, "has_duplicate_address", says_no)),
    ("foreign_master/df800-ascii", "no alarm", replace_attribute(UnsolicitedBytes, "has_foreign_master", says_no)),
    ("broadcast_other/c320-ascii", "no rule", replace_attribute(prepared_request, "_check_broadcast", anything_goes)),
    ("broadcast_stop/vc660", "no verification", replace_attribute(bus_stop, "_stop", taken_for_stopped)),
    ("cut_last_byte/c320-ascii", "nobody is silent", replace_attribute(Station, "mark_offline", nothing)),
    ("batches/c320-ascii", "no allowance", replace_attribute(StationTiming, "timeout_s", without_adapter)),
    ("adapter_lost/c320-ascii", "replay", replace_attribute(BusCore, "on_port_lost", replays)),
    ("adapter_lost/vc660", "still called present", replace_attribute(BusCore, "presence", as_before)),
    ("host_restart/vc660", "a stop by itself", replace_attribute(Drive, "monitor", stops_anyway(Drive.monitor))),
    ("comm_loss/dzb100", "it will stop", replace_attribute(comm_loss, "comm_loss_behaviour", it_will_stop)),
    ("eeprom_burst/df800-rtu", "no budget", replace_attribute(EepromBudget, "consume", free_of_charge)),
    ("toggle/vc660", "pulses stay", replace_attribute(CommandBits, "_pulse_and_levels", one_word)),
    ("toggle/df800-rtu", "no allow-list", replace_attribute(ModbusDialect, "is_allowed", says_yes)),
    ("toggle/huanyang-hy", "no allow-list", replace_attribute(HuanyangDialect, "is_allowed", says_yes)),
    ("toggle/fr-e500", "no allow-list", replace_attribute(MitsubishiDialect, "is_allowed", says_yes)),
    ("toggle/dzb100", "a lease without end", replace_attribute(JogSession, "_arm", lasting(JogSession._arm))),
    ("scale/dzb100", "no cap", replace_attribute(dzb100, "is_within_cap", says_yes)),
    ("scale/vc660", "any read-back", replace_attribute(ModbusDialect, "setpoint_matches", says_yes)),
    ("scale/huanyang-hy", "any read-back", replace_attribute(HuanyangDialect, "setpoint_matches", says_yes)),
    ("error_answer/fr-e500", "no refusal", replace_attribute(MitsubishiDialect, "rejection", nothing)),
    (
        "duplicate_address/huanyang-hy",
        "a reply is a foreign request",
        replace_attribute(Station, "decode_reply_to", nothing),
    ),
    ("late_same_item/fr-e500", "no doubt", replace_attribute(Station, "mark_suspect", nothing)),
    ("scale/df800-rtu", "no pre-flight", replace_attribute(Preflight, "passed", True)),
]


@pytest.mark.parametrize(
    ("name", "fault", "plant"), PLANTED_FAULTS, ids=[f"{name} {fault}" for name, fault, _ in PLANTED_FAULTS]
)
def test_a_planted_fault_fails_its_cell(
    name: str, fault: str, plant: PlantedFault, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run_cell_once(name).violations == []
    plant(monkeypatch)
    violations = run_cell_once(name).violations
    assert violations, fault
    assert not [text for text in violations if "AttributeError" in text or "TypeError" in text], (
        "the fault itself broke"
    )


def test_every_row_has_a_planted_fault() -> None:
    assert {name.partition("/")[0] for name, _, _ in PLANTED_FAULTS} == set(TABLE)


# --- the page ---------------------------------------------------------------------------------------------------------

ROOT = Path(__file__).resolve().parents[2]
REPORT = Path("docs") / "reports" / "campaign-matrix.json"


def test_the_committed_report_ran_every_cell() -> None:
    found = json.loads((ROOT / REPORT).read_text(encoding="utf-8"))["figures"]["cells"]
    assert found.keys() == CELLS_BY_NAME.keys()
    assert min(cell["cases"] for cell in found.values()) == matrix.SEEDS_PER_CELL


@pytest.mark.parametrize(("held", "mark"), [(19, "✘"), (None, "?")])
def test_the_page_shows_a_cell_that_failed_and_one_that_did_not_run(
    held: int | None, mark: str, tmp_path: Path
) -> None:
    report = json.loads((ROOT / REPORT).read_text(encoding="utf-8"))
    if held is None:
        del report["figures"]["cells"]["batches/df800-ascii"]
    else:
        report["figures"]["cells"]["batches/df800-ascii"]["held"] = held
    (tmp_path / REPORT).parent.mkdir(parents=True)
    (tmp_path / REPORT).write_text(json.dumps(report), encoding="utf-8")
    texts = {"en": "39 of 40 held", "zh": "40 个中 39 个成立"} if held else {"en": "not run", "zh": "未运行"}
    for language, text in texts.items():
        assert f"{mark} ({text})" in fault_matrix.page_parts(tmp_path, language)["table"]
