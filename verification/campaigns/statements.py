"""``statements``: sessions with drives that misbehave; every sentence about the drive must be true.

The drives are fakes written for this campaign (``verification.statements``), not the product's simulated ones: they are
silent, late, double or damage their replies, reject, trip, run at 0 Hz, ignore commands or keep another value. After
each command the campaign compares outcome, error, status, readings and notes with what the fake did and reported.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.commissioning.scan import ScanProgress, scan
from drivebus.commissioning.scan_plan import plan_scan
from drivebus.drives import Drive, MemoryStore, create_dialect
from drivebus.errors import DrivebusError
from drivebus.serial_settings import SerialSettings
from drivebus.testing.virtual_time import VirtualLoop, running
from drivebus.types import EchoSetting
from drivebus.values import Quality
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.campaigns import campaign_of
from verification.families.family_campaign import WrittenParameter
from verification.families.registry import variants_for
from verification.statements.drive_physics import MISBEHAVIOURS, DrivePhysics
from verification.statements.fake_line import LINE_FAULTS, FakeLine, LinePlan
from verification.statements.statement_checker import OUTPUT_OFF, REPORT_TOLERANCE_HZ, Statement, StatementChecker

ADDRESS = 3
BAUD = 38400
MAX_COMMANDS = 3
METHODS = {"status": 4, "run": 4, "run_wait": 2, "stop": 3, "reset_fault": 2, "read": 2, "write": 2, "scan": 1}
FAULT_SHARES = (0.05, 0.2, 0.5, 1.0)
FREQUENCIES_HZ = (2.0, 5.0, 10.0)
ECHOES: tuple[tuple[bool, EchoSetting], ...] = (
    *((False, "off"),) * 6,
    (True, "on"),
    (True, "detect"),
    (False, "detect"),
)
"""Whether the adapter echoes, and the setting of the port; wrong settings are tried by the campaign ``commands``."""
COVERED = variants_for("statements")
NO_PARAMETER = WrittenParameter("", False, 0, 1)
"""Of a drive that can't be asked for one: ``read`` and ``write`` are not among its methods."""


class StatementSession:
    """Bus with one misbehaving drive, and a few commands."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, number: int) -> None:
        self.campaign_run, self.variant, self.number = campaign_run, variant, number
        self.rng = rng = campaign_run.rng(variant.name, number)
        self.loop = VirtualLoop()
        self.family = campaign_of(variant.model)
        self.profile = profiles.load(variant.model)
        misbehaviours = frozenset(rng.sample(MISBEHAVIOURS, rng.choice((0, 1, 1, 2))))
        faults = tuple(rng.sample(LINE_FAULTS, rng.choice((0, 0, 1, 1, 2))))
        echoes, setting = rng.choice(ECHOES)
        plan = LinePlan(
            line_faults=faults,
            share=rng.choice(FAULT_SHARES),
            refuses=frozenset(rng.sample(("read", "set", "start", "stop", "reset"), rng.choice((0, 0, 0, 1)))),
            echoes=echoes,
            silent_after=rng.choice((10**6,) * 4 + (rng.randrange(40),)),
        )
        physics = DrivePhysics(rng=rng, misbehaviours=misbehaviours)
        physics.fault = 5 if rng.random() < 0.1 else 0
        if rng.random() < 0.15 and not physics.fault:
            physics.setpoint_hz = physics.target_hz = physics.hz = 5.0
            physics.is_on = physics.was_on = True
        dialect = create_dialect(self.profile, ADDRESS, encoding=variant.encoding)
        settings = SerialSettings.parse(BAUD, f"8{self.profile.serial.format[1]}1")
        self.line = FakeLine(
            station=self.family.stations[variant.model](),
            address=ADDRESS,
            codec=dialect.codec,
            settings=settings,
            physics=physics,
            plan=plan,
            rng=rng,
            echo=setting,
        )
        self.checker = StatementChecker(self.line, reports_state=variant.reports_running)
        self.plan_text = f"{sorted(misbehaviours)} {faults} {plan.share} {sorted(plan.refuses)} {setting}"

    def play(self) -> None:
        """Run the commands and check each."""
        with running(self.loop):
            bus = Bus(self.line, name=self.variant.name)
        if self.rng.random() < METHODS["scan"] / sum(METHODS.values()):
            self._scan()
            return
        with running(self.loop):
            drive = Drive(
                bus,
                self.profile,
                ADDRESS,
                encoding=self.variant.encoding,
                options={**self.variant.drive_options, **self.family.statement_options},
                store=MemoryStore(),
            )
        self.loop.run_until_complete(bus.open())
        absent = self.family.lacks | {"scan"} | (set() if self.variant.reports_running else {"status"})
        names = [name for name in METHODS if name not in absent]
        for _ in range(self.rng.randrange(1, MAX_COMMANDS + 1)):
            self._command(drive, self.rng.choices(names, [METHODS[name] for name in names])[0])
            self.loop.run_until(self.loop.time() + self.rng.choice((0.0, 0.2, 1.0)))
        with running(self.loop):
            drive.close()
        self.loop.run_until_complete(bus.close())

    def _command(self, drive: Drive, name: str) -> None:
        rng, began = self.rng, self.loop.time()
        self.line.physics.advance(began)
        self.line.physics.was_on = self.line.physics.is_on
        hz, reverse = rng.choice(FREQUENCIES_HZ), rng.random() < 0.2
        way = "reverse" if reverse else "forward"
        parameter = self.family.written_parameters.get(self.variant.model, NO_PARAMETER)
        value = float(rng.randrange(1, 20))
        call: Any = {
            "status": drive.status,
            "run": partial(drive.run, hz, way),
            "run_wait": partial(drive.run, hz, way, wait=True, timeout_s=4.0),
            "stop": drive.stop,
            "reset_fault": drive.reset_fault,
            "read": partial(drive.read, (parameter.notation,)),
            "write": partial(drive.write, {parameter.notation: value}, save=parameter.saved),
        }[name]
        result: Any = None
        error: DrivebusError | None = None
        try:
            result = self.loop.run_until_complete(call())
        except DrivebusError as failure:
            error, result = failure, failure.outcome
        self.line.physics.advance(self.loop.time())
        if error is not None and result is None:
            self._check(name, type(error).__name__, error.key, error.params, began, way)
        elif name == "status":
            self._check_status(result, began)
        elif name == "read":
            self._check_reading(result[parameter.notation], parameter.memory_key, began)
        else:
            statement = self._check(name, str(result.status), result.key, result.params, began, way)
            if name == "write":
                raw = round(value * parameter.counts_per_unit)
                self._report(statement, *self.checker.write_contradictions(statement, parameter.memory_key, raw))
            if result.drive_status is not None and name != "write" and result.drive_status.reason is not None:
                self._check(name, "reason", result.drive_status.reason, {}, began, way)

    def _check(self, name: str, status: str, key: str, params: Any, began: float, way: str) -> Statement:
        statement = Statement(
            command=name,
            status=status,
            key=key,
            params=params,
            began_at=began,
            ended_at=self.loop.time(),
            direction=way,
        )
        self.campaign_run.count(f"{status}: {key}")
        self.campaign_run.trace(f"{self.variant.name}/{self.number} {self.loop.time():.6f} {name} {status} {key}")
        self._report(statement, *self.checker.contradictions(statement))
        return statement

    def _report(self, statement: Statement, *contradictions: str) -> None:
        for text in contradictions:
            self.campaign_run.violation(
                f"seed {self.campaign_run.seed}, {self.variant.name}/{self.number}, "
                f"{statement.command} at {statement.ended_at:.3f} s: "
                f"{statement.status}, {statement.key} ({statement.text}): {text}; {self.plan_text}"
            )

    def _check_status(self, status: Any, began: float) -> None:
        reason = status.reason
        if reason is not None:
            self._check("status", "reason", reason, {}, began, "")
        statement = self._check("status", "status", "drives.reported", {"state": status.state}, began, "")
        for name, reading in status.readings.items():
            if reading.reason is not None and reading.quality is Quality.BAD:
                self._check("status", "reading", reading.reason, {}, began, "")
            elif name == "output_frequency" and reading.quality is Quality.GOOD:
                shown = [e.reaction.reports.hz for e in self.line.exchanges if e.reaction is not None and e.at >= began]
                if not any(hz is not None and abs(hz - reading.value) <= REPORT_TOLERANCE_HZ for hz in shown):
                    self._report(statement, f"{reading.value} Hz was never reported")
        shows_fault, standing = status.fault is not None, status.state.value in OUTPUT_OFF
        changed = "trips" in self.line.physics.misbehaviours
        present = bool(self.line.physics.fault) and self.variant.reports_faults
        if standing and not changed and shows_fault is not present:
            self._report(statement, f"fault {status.fault} shown, {self.line.physics.fault} present")

    def _check_reading(self, reading: Any, memory_key: int, began: float) -> None:
        held = self.line.physics.memory.get(memory_key, 0)
        if reading.raw is None:
            self._check("read", "reading", reading.reason, {}, began, "")
            return
        statement = self._check("read", "value", "read.raw", {}, began, "")
        if reading.raw != held:
            self._report(statement, f"{reading.raw} was read, the drive holds {held}")

    def _scan(self) -> None:
        """Scan three addresses; what was found must be the drive."""
        passes = plan_scan(
            [self.profile],
            addresses=[ADDRESS - 1, ADDRESS, ADDRESS + 1],
            encodings=[self.variant.encoding],
            fixed=self.line.settings,
        )
        progress = ScanProgress(total_s=1.0)
        found = self.loop.run_until_complete(scan(passes, lambda settings: self.line, progress))
        replied = any(e.reaction is not None for e in self.line.exchanges)
        for station in found:
            key = "scan.found" if station.models else "scan.rejected" if station.valid_reply else "scan.no_valid_reply"
            self.campaign_run.count(f"scan: {key}")
            self.campaign_run.trace(f"{self.variant.name}/{self.number} {key} {station.address}")
            statement = _scan_statement(key)
            if station.valid_reply and (station.address != ADDRESS or not replied):
                self._report(statement, f"a drive was found at address {station.address}")
            if not station.valid_reply and not self.line.deliveries and not self.line.plan.echoes:
                self._report(statement, "no byte was sent by the drive")
        clean = all(e.is_clean for e in self.line.exchanges if e.reaction is not None)
        if not found and replied and clean and self.line.echo != "detect" and not self.line.plan.echoes:
            self.campaign_run.count("scan: scan.nothing")
            self._report(_scan_statement("scan.nothing"), "the drive answered")


def _scan_statement(key: str) -> Statement:
    params = {"models": "", "address": "", "settings": "", "encoding": ""}
    return Statement(command="scan", status="scan", key=key, params=params, began_at=0.0, ended_at=0.0)


def run(campaign_run: CampaignRun) -> None:
    """Play sessions with all variants in turn."""
    number = 0
    while campaign_run.remaining:
        for variant in COVERED:
            if campaign_run.remaining:
                StatementSession(campaign_run, variant, number).play()
                campaign_run.add_trials()
        number += 1


CAMPAIGN = Campaign(
    name="statements",
    summary={
        "en": "Sentences about drives that misbehave are true.",
        "zh": "关于行为异常的变频器的每句话都属实。",
    },
    unit="sessions",
    evidence_for=("I5",),
    full_budget=100_000,
    ci_budget=600,
    run=run,
)
