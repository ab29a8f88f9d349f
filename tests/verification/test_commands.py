"""The campaign ``commands`` finds lost stops, false outcomes and acknowledgements of absent drives that are planted."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus.echo import EchoDetector
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.drives import permissives
from drivebus.drives.operations import parameters, start, stop
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.stop_supervisor import StopSupervisor
from fixtures.campaigns import finds
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import commands
from verification.drive_variants import DriveVariant
from verification.families.registry import VARIANTS_BY_NAME

WRONG_ECHO = (("echo", "off"), ("", "on"))
"""Behaviour of the adapter, and the echo setting of the port."""


def campaign(budget: int, seed: int = 1) -> CampaignRun:
    """Run the campaign and keep every violation, not only the first ones."""
    campaign_run = CampaignRun(campaign="commands", seed=seed, budget=budget)
    violations: list[str] = []
    campaign_run.listener = lambda line: violations.append(line) if line.startswith("VIOLATION") else None
    run_campaign(commands.CAMPAIGN, campaign_run)
    campaign_run.violations = violations
    return campaign_run


def only(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Restrict the campaign to these variants."""
    variants: tuple[DriveVariant, ...] = tuple(VARIANTS_BY_NAME[name] for name in names)
    monkeypatch.setattr(commands, "COVERED", variants)


def test_the_product_has_no_violation_and_motors_run() -> None:
    campaign_run = campaign(600)
    assert campaign_run.violations == [] and campaign_run.trials == 600
    assert campaign_run.counts["motors switched on"] > 10
    assert (
        campaign_run.counts["run: confirmed"]
        and campaign_run.counts["stop: confirmed"]
        and campaign_run.counts["stop: unknown"]
    )


EPISODES = (
    "vc660/3219",
    "vc660/7803",
    "vc660/21009",
    "vc660/31491",
    "vc660/34791",
    "c320-hex/12367",
    "c320-hex/36463",
    "c320-ascii/18180",
)


@pytest.mark.parametrize("episode", EPISODES)
def test_an_earlier_violation_of_seed_1_is_fixed(episode: str) -> None:
    """Errors found by a million commands: a permanent wrong echo detection, a jog cancelled before its first frame that
    still sent its end, a keypad start during an emergency stop, and two misclassifications of the oracle."""
    name, number = episode.split("/")
    campaign_run = CampaignRun(campaign="commands", seed=1, budget=10**6)
    commands.CommandEpisode(campaign_run, VARIANTS_BY_NAME[name], int(number)).play(commands.COMMANDS_PER_EPISODE)
    assert campaign_run.violations == []


def test_a_wrong_echo_setting_acknowledges_no_command_to_an_absent_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both wrong settings are tried: echo expected without one, and an unexpected echo."""
    monkeypatch.setattr(commands, "ECHO_SETTINGS", WRONG_ECHO)
    campaign_run = campaign(480)
    assert campaign_run.violations == []
    assert campaign_run.counts["echo echo, set off"] and campaign_run.counts["echo no, set on"]
    assert campaign_run.counts["acting frames to absent drives"] > 100


def test_an_accepted_echo_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reply of function 06 equals its request. Only the first one counts: afterwards the absent drive needs a sync
    probe."""
    only(monkeypatch, "df800-rtu", "df800-ascii")
    monkeypatch.setattr(commands, "ECHO_SETTINGS", WRONG_ECHO[:1])
    monkeypatch.setattr(commands, "UNPACED_SHARE", 1.0)
    monkeypatch.setattr(EchoDetector, "accepts", lambda self, transaction: True)
    assert finds("commands", "absent drive", 240)


def test_a_stop_that_is_not_repeated_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unconfirmed stop is given up."""
    monkeypatch.setattr(StopSupervisor, "start_repetition", lambda self, how: None)
    assert finds("commands", "was given up", 240)


def test_a_stop_confirmed_without_evidence_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(op: Any, *more: Any) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.stop_confirmed")

    only(monkeypatch, "c320-ascii", "vc660")
    monkeypatch.setattr(stop, "_until_confirmed", at_once)
    assert finds("commands", "confirmed, but the motor is on", 480)


def test_a_start_confirmed_without_evidence_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(op: Any, *arguments: Any, answered: bool) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.start_confirmed")

    only(monkeypatch, "c320-ascii", "vc660", "dzb100")
    monkeypatch.setattr(start, "confirm_start", at_once)
    assert finds("commands", "confirmed, but the motor is off", 1200)


def test_an_unanswered_start_reported_as_acknowledged_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(op: Any, *arguments: Any, answered: bool) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.start_acknowledged")

    only(monkeypatch, "df800-rtu")
    monkeypatch.setattr(start, "confirm_start", at_once)
    assert finds("commands", "the drive received no frame of it", 1600, seed=3)


def test_a_start_sent_after_a_newer_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The permissives ignore a stop that is newer than the command (I1)."""
    monkeypatch.setattr(permissives, "_check_valid", lambda command, effect, around: None)
    monkeypatch.setattr(commands, "IMMEDIATE_COMMAND_SHARE", 1.0)
    assert finds("commands", "after a newer stop", 480)


def test_a_start_repeated_by_the_bus_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blind retries undo a stop at the keypad (I2)."""
    monkeypatch.setattr(PreparedRequest, "_max_write_attempts", lambda self: 3)
    monkeypatch.setattr(commands, "MEAN_FAULT_PAUSE_S", 0.2)
    monkeypatch.setattr(
        commands.CommandEpisode,
        "_disturb",
        lambda self: [s.keypad_stop() for s in self.scenario.simulated_bus.stations],
    )
    only(monkeypatch, "c320-ascii")
    assert finds("commands", "I2", 800)


def test_a_write_confirmed_without_a_read_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(op: Any, write: Any, *, answered: bool, params: Any) -> Any:
        yield from ()
        return op.outcome(OutcomeStatus.CONFIRMED, "drives.write_confirmed", **params)

    only(monkeypatch, "dzb100", "df800-rtu")
    monkeypatch.setattr(parameters, "_read_back", at_once)
    monkeypatch.setattr(commands, "COMMAND_WEIGHTS", {"write": 1})
    assert finds("commands", "and the drive holds", 240)
