"""The campaign ``matrix``: every cell has a case and words, one seed is one run, planted faults fail their cells."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus.bus import job, rights, unasked
from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoKeeper
from drivebus.bus.listener import Listener
from drivebus.bus.state import BusState
from drivebus.bus.stations import Station
from drivebus.bus.transaction import Transaction
from drivebus.drives import Drive, busstop, commloss, dzb, gate, setpoint, sifang
from drivebus.drives.book import Book
from drivebus.drives.command_word import CommandWord
from drivebus.drives.commloss import CommLossReport
from drivebus.drives.lease import JogLease
from drivebus.drives.memory import Preflight
from drivebus.drives.modbus import ModbusDialect
from drivebus.drives.state import Outcome, OutcomeWord
from drivebus.drives.wear import Wear
from drivebus.lab.campaign import Session, perform
from drivebus.lab.campaigns import matrix
from drivebus.lab.cells.table import TABLE
from drivebus.lab.kinds import KINDS
from drivebus.message import Effect, StationTiming

CELLS = {cell.name: cell for cell in matrix.CELLS}


def tried(name: str) -> Session:
    session = Session("matrix", 1, 1)
    held = matrix.try_cell(session, CELLS[name], 0)
    assert held is not bool(session.violations)
    return session


def test_every_cell_has_a_case_and_words_in_both_languages() -> None:
    """6.4: 27 faults, four protocols, C320 and DF800 in both encodings; C320 has no wrong scale."""
    assert len(TABLE) == 27
    assert len(CELLS) == 27 * len(KINDS) - 2
    for row in TABLE.values():
        texts = [row["fault"], row["shown"], *row["cells"].values(), row.get("missing", row["shown"])]
        assert all(text["en"] and text["zh"] for text in texts)
        assert any(cell.get("partly") for cell in row["cells"].values()) <= ("missing" in row)


def test_a_run_goes_through_all_cells_before_it_takes_another_seed() -> None:
    session = Session("matrix", 1, 3)
    matrix.run(session)
    assert session.figures["cells"] == {name: {"cases": 1, "held": 1} for name in list(CELLS)[:3]}
    assert matrix.CAMPAIGN.full % matrix.CAMPAIGN.slice == 0


def test_the_run_does_not_hang_on_the_order_of_hashes() -> None:
    code = (
        "from drivebus.lab.campaign import Session, perform\n"
        "from drivebus.lab.campaigns.matrix import CAMPAIGN\n"
        "print(perform(CAMPAIGN, Session('matrix', 3, 24)).digest)"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "7"}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True, text=True)
    assert told.stdout.strip() == perform(matrix.CAMPAIGN, Session("matrix", 3, 24)).digest


def test_a_case_that_breaks_is_a_failed_cell() -> None:
    def breaks(at: Any) -> None:
        raise RuntimeError("broken")

    session = Session("matrix", 1, 1)
    assert not matrix.try_cell(session, replace(CELLS["batches/vc660"], check=breaks), 0)
    assert "RuntimeError: broken" in session.violations[0]


# --- planted faults: one line of the product is wrong, and the cell that is about it fails ---------------------------

Plant = Callable[[pytest.MonkeyPatch], None]


def put(target: Any, name: str, value: Any) -> Plant:
    return lambda patch: patch.setattr(target, name, value)


def both(*plants: Plant) -> Plant:
    def plant(patch: pytest.MonkeyPatch) -> None:
        for one in plants:
            one(patch)

    return plant


def no_lateness(self: Station, now: float) -> None:
    self.suspect, self.doubted_at, self.quarantined_until = True, now, now


def nothing(*_: Any, **__: Any) -> None:
    return None


def forget(core: BusCore, now: float) -> None:
    core.listener.take()


def anything_goes(one: job.Job, stations: Any) -> job.Job:
    one.effect = Effect.STOP
    return one


def as_before(self: BusState, address: int) -> Any:
    return self.stations[address].presence


def says_yes(*_: Any, **__: Any) -> bool:
    return True


def says_no(*_: Any, **__: Any) -> bool:
    return False


def confirmed_at_once(talk: Any, *_: Any, **__: Any) -> Any:
    yield from talk.fence()
    return talk.outcome(OutcomeWord.CONFIRMED, "drives.setpoint_confirmed", frequency_hz=1.0)


def hunts(self: Transaction) -> bool:
    """Looks for an answer anywhere in what it heard."""
    del self.buffer[:1]
    self.heard -= 1
    self.need = 1
    return bool(self.buffer)


def newest_alone(self: Book, name: str) -> tuple[int, int] | None:
    raw = self.latest[name].raw if name in self.latest else None
    return None if raw is None else (raw, raw)


def unechoed(self: Transaction, data: bytes, now: float) -> bytes:
    return data


def deaf_to_marks(received: Any) -> Any:
    return lambda self, data, now, marks=0: received(self, data, now)


def impatient(self: Transaction, now: float) -> None:
    self.final_at = now + self.job.gap_s


def without_adapter(self: StationTiming, line: Any, reply_bytes: int) -> float:
    return self.reply_delay_s + line.seconds(self.reply_delay_characters + reply_bytes)


def free_of_charge(self: Wear, notation: str, day: str) -> Any:
    yield from ()


def stops_anyway(monitor: Any) -> Any:
    def watched(self: Drive, *arguments: Any, **named: Any) -> Any:
        self._task = asyncio.ensure_future(self.stop())  # type: ignore[attr-defined]
        return monitor(self, *arguments, **named)

    return watched


def lasting(arm: Any) -> Any:
    return lambda self, left_s: arm(self, 60.0)


def it_will_stop(talk: Any) -> Any:
    yield from talk.fence()
    return CommLossReport(True, "drives.host_dies_stops", {"time": "1", "notation": "", "action": "", "value": 1})


async def taken_for_stopped(drive: Drive, *_: Any) -> Outcome:
    return Outcome(OutcomeWord.CONFIRMED, "drives.stop_confirmed", {"state": "stopped"})


def one_word(self: CommandWord, pulse: int, level: int) -> tuple[int, ...]:
    return (pulse | level,)


def replays(self: BusCore, error: Any, now: float) -> list[Any]:
    """What was in flight is put into its queue again, with a permit that still holds."""
    self.is_open = False
    flight, self.flight = self.flight, None
    if flight is not None:
        self.scheduler.again(flight.job)
    return []


PLANTS: list[tuple[str, str, Plant]] = [
    ("no_answer_read/vc660", "reads go once", put(job, "READ_ATTEMPTS", 1)),
    ("no_answer_read/dzb100", "no quarantine", put(Station, "doubt", no_lateness)),
    ("no_answer_setpoint/vc660", "no read-back", put(setpoint, "shown", confirmed_at_once)),
    ("no_answer_start/c320-ascii", "starts are resent", put(job.Job, "_attempts_allowed", lambda self: 3)),
    ("no_answer_start/df800-rtu", "starts are resent", put(job.Job, "_attempts_allowed", lambda self: 3)),
    ("no_answer_stop/vc660", "a stop is given up", put(Drive, "_insist_on", nothing)),
    ("late_same_item/df800-ascii", "late answers uncounted", put(unasked, "sort_out", forget)),
    ("late_other_item/vc660", "no doubt", put(Station, "doubt", nothing)),
    ("other_address/c320-hex", "no foreign master", put(Listener, "foreign_master", says_no)),
    ("truncated/df800-rtu", "no deadline", put(Transaction, "_settle", impatient)),
    ("trailing/c320-ascii", "a bad link may start", put(gate, "against_motion", lambda *_: ())),
    ("garbage/vc660", "hunting", put(Transaction, "_glitch", hunts)),
    ("bit_flip/dzb100", "parity is ignored", put(Transaction, "received", deaf_to_marks(Transaction.received))),
    ("bit_flip/dzb100", "one read decides", put(Book, "raw_pair", newest_alone)),
    ("digit_swap/c320-hex", "one read decides", put(Book, "raw_pair", newest_alone)),
    (
        "echo/df800-rtu", "an echo is an answer",
        both(
            put(EchoKeeper, "filter_for", nothing), put(EchoKeeper, "believes", says_yes),
            put(Transaction, "_without_early", unechoed),
        ),
    ),
    ("echo/vc660", "a mirrored reply is an answer", put(EchoKeeper, "believes", says_yes)),
    ("echo/df800-ascii", "a mirrored reply is an answer", put(EchoKeeper, "believes", says_yes)),
    ("error_answer/dzb100", "no refusal", put(dzb.DzbDialect, "refusal", nothing)),
    ("status_fault/c320-ascii", "values of a fault are good", put(sifang, "_unechoed", lambda reading: reading)),
    ("duplicate_address/dzb100", "no alarm", put(Station, "duplicate", says_no)),
    ("foreign_master/df800-ascii", "no alarm", put(Listener, "foreign_master", says_no)),
    ("broadcast_other/c320-ascii", "no rule", put(rights, "_broadcast", anything_goes)),
    ("broadcast_stop/vc660", "no verification", put(busstop, "_stop", taken_for_stopped)),
    ("cut_last_byte/c320-ascii", "nobody is silent", put(Station, "give_up", nothing)),
    ("batches/c320-ascii", "no allowance", put(StationTiming, "timeout_s", without_adapter)),
    ("adapter_lost/c320-ascii", "replay", put(BusCore, "lost", replays)),
    ("adapter_lost/vc660", "still called present", put(BusState, "presence", as_before)),
    ("host_restart/vc660", "a stop by itself", put(Drive, "monitor", stops_anyway(Drive.monitor))),
    ("comm_loss/dzb100", "it will stop", put(commloss, "if_host_dies", it_will_stop)),
    ("eeprom_burst/df800-rtu", "no budget", put(Wear, "charge", free_of_charge)),
    ("toggle/vc660", "pulses stay", put(CommandWord, "_words", one_word)),
    ("toggle/df800-rtu", "no allow-list", put(ModbusDialect, "lawful", says_yes)),
    ("toggle/dzb100", "a lease without end", put(JogLease, "_arm", lasting(JogLease._arm))),
    ("scale/dzb100", "no cap", put(dzb, "within_cap", says_yes)),
    ("scale/vc660", "any read-back", put(ModbusDialect, "setpoint_shown", says_yes)),
    ("scale/df800-rtu", "no pre-flight", put(Preflight, "passed", True)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "fault", "plant"), PLANTS, ids=[f"{name} {fault}" for name, fault, _ in PLANTS])
def test_a_planted_fault_fails_its_cell(name: str, fault: str, plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tried(name).violations == []
    plant(monkeypatch)
    assert tried(name).violations, fault


def test_every_row_has_a_planted_fault() -> None:
    assert {name.partition("/")[0] for name, _, _ in PLANTS} == set(TABLE)


# --- the page ---------------------------------------------------------------------------------------------------------

ROOT = Path(__file__).resolve().parents[2]
REPORT = Path("docs") / "reports" / "lab-matrix.json"


def test_the_committed_report_ran_every_cell() -> None:
    found = json.loads((ROOT / REPORT).read_text(encoding="utf-8"))["figures"]["cells"]
    assert found.keys() == CELLS.keys()
    assert min(cell["cases"] for cell in found.values()) == matrix.SEEDS


@pytest.mark.parametrize("held", [19, None])
def test_a_page_that_says_otherwise_than_the_report_is_out_of_date(held: int | None, tmp_path: Path) -> None:
    """A cell that failed, or that nobody ran, is never shown as held, in neither language."""
    for name in ("docs", "vectors"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for name in ("README.md", "README.zh.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    report = json.loads((tmp_path / REPORT).read_text(encoding="utf-8"))
    if held is None:
        del report["figures"]["cells"]["batches/df800-ascii"]
    else:
        report["figures"]["cells"]["batches/df800-ascii"]["held"] = held
    (tmp_path / REPORT).write_text(json.dumps(report), encoding="utf-8")
    command = [sys.executable, str(tmp_path / "docs" / "generate.py")]
    done = subprocess.run([*command, "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    pages = [tmp_path / "docs" / "explanation" / f"fault-matrix{suffix}.md" for suffix in ("", ".zh")]
    assert [page.name in done.stdout for page in pages] == [True, True]
    subprocess.run(command, capture_output=True, check=True)
    for page, said in zip(
        pages, ("39 of 40 held", "40 个中 39 个成立") if held else ("not run", "未运行"), strict=True
    ):
        assert f"{'✘' if held else '?'} ({said})" in page.read_text(encoding="utf-8")
