"""The campaign ``commands`` finds what it is there to find: each promise of G05 and G19 broken on purpose."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.bus.echo import EchoDetector
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.drives import permissives
from drivebus.drives.operations import parameters, start, stop
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.stop_supervisor import StopSupervisor
from verification.campaign import CampaignRun, run_campaign
from verification.campaigns import commands
from verification.drive_variants import VARIANTS_BY_NAME, DriveVariant

WRONG_ECHO = (("echo", "off"), ("", "on"))
"""What the adapter does, and what the port is told."""


def campaign(budget: int, seed: int = 1) -> CampaignRun:
    """A run; it keeps every violation, not only the first ones."""
    session = CampaignRun("commands", seed, budget)
    kept: list[str] = []
    session.listener = lambda line: kept.append(line) if line.startswith("VIOLATION") else None
    run_campaign(commands.CAMPAIGN, session)
    session.violations = kept
    return session


def found(session: CampaignRun, text: str) -> bool:
    return any(text in violation for violation in session.violations)


def only(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """With these kinds alone."""
    kinds: tuple[DriveVariant, ...] = tuple(VARIANTS_BY_NAME[name] for name in names)
    monkeypatch.setattr(commands, "DRIVE_VARIANTS", kinds)


def test_an_honest_bus_violates_nothing_and_motors_run() -> None:
    session = campaign(600)
    assert session.violations == [] and session.trials == 600
    assert session.counts["motors switched on"] > 10
    assert session.counts["run: confirmed"] and session.counts["stop: confirmed"] and session.counts["stop: unknown"]


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
def test_an_episode_of_seed_1_that_was_violated_once_is_clean(episode: str) -> None:
    """What a million commands found: a wrong finding about the echo that nothing could mend any more, a jog that was
    given up before its first frame and still sent its end, a keypad that ran a drive in emergency stop; and a witness
    who took a jog's end that was sent again, and the newest wish of a motor that ran already, for something else."""
    name, number = episode.split("/")
    session = CampaignRun("commands", 1, 10**6)
    commands.CommandEpisode(session, VARIANTS_BY_NAME[name], int(number)).play(commands.COMMANDS_PER_EPISODE)
    assert session.violations == []


def test_a_wrong_echo_acknowledges_nothing_that_an_absent_drive_was_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways round."""
    monkeypatch.setattr(commands, "ECHO_SETTINGS", WRONG_ECHO)
    session = campaign(480)
    assert session.violations == []
    assert session.counts["echo echo, set off"] and session.counts["echo no, set on"]
    assert session.counts["acting frames to drives that are not there (G19)"] > 100


def test_a_believed_mirror_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """FC06's answer equals its request. Only at first: then the absent drive owes a fence."""
    only(monkeypatch, "df800-rtu", "df800-ascii")
    monkeypatch.setattr(commands, "ECHO_SETTINGS", WRONG_ECHO[:1])
    monkeypatch.setattr(commands, "UNPACED_SHARE", 1.0)
    monkeypatch.setattr(EchoDetector, "accepts", lambda self, flight: True)
    assert found(campaign(240), "G19")


def test_a_stop_that_is_not_repeated_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unconfirmed, and given up."""
    monkeypatch.setattr(StopSupervisor, "start_retry", lambda self, how: None)
    assert found(campaign(240), "given up")


def test_a_stop_that_is_believed_unseen_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(talk: Any, *more: Any) -> Any:
        yield from ()
        return talk.outcome(OutcomeStatus.CONFIRMED, "drives.stop_confirmed")

    only(monkeypatch, "c320-ascii", "vc660")
    monkeypatch.setattr(stop, "_until_confirmed", at_once)
    assert found(campaign(480), "confirmed, but the motor is on")


def test_a_start_that_is_believed_unseen_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(talk: Any, *more: Any) -> Any:
        yield from ()
        return talk.outcome(OutcomeStatus.CONFIRMED, "drives.start_confirmed")

    only(monkeypatch, "c320-ascii", "vc660", "dzb100")
    monkeypatch.setattr(start, "confirm_start", at_once)
    assert found(campaign(1200), "confirmed, but the motor is off")


def test_an_unanswered_start_that_is_called_acknowledged_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(talk: Any, *more: Any) -> Any:
        yield from ()
        return talk.outcome(OutcomeStatus.ACKNOWLEDGED, "drives.start_acknowledged")

    only(monkeypatch, "df800-rtu")
    monkeypatch.setattr(start, "confirm_start", at_once)
    assert found(campaign(800), "the drive heard nothing of it")


def test_a_start_that_outlives_a_newer_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """6.5, I1: the gate no longer asks which stop is newer than the wish, and the bus gets a fresh permit."""
    monkeypatch.setattr(permissives, "_check_valid", lambda command, effect, around: None)
    monkeypatch.setattr(commands, "IMMEDIATE_COMMAND_SHARE", 1.0)
    assert found(campaign(480), "after a newer stop")


def test_a_start_that_the_bus_repeats_by_itself_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """F16, I2: blind retries undo a stop at the keypad."""
    monkeypatch.setattr(PreparedRequest, "_max_write_attempts", lambda self: 3)
    monkeypatch.setattr(commands, "MEAN_TROUBLE_PAUSE_S", 0.2)
    monkeypatch.setattr(
        commands.CommandEpisode, "_trouble", lambda self: [s.keypad_stop() for s in self.scenario.bench.stations]
    )
    only(monkeypatch, "c320-ascii")
    assert found(campaign(800), "I2")


def test_a_write_that_is_believed_unread_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_once(talk: Any, wanted: Any, answered: bool, text: Any) -> Any:
        yield from ()
        return talk.outcome(OutcomeStatus.CONFIRMED, "drives.write_confirmed", **text)

    only(monkeypatch, "dzb100", "df800-rtu")
    monkeypatch.setattr(parameters, "_read_back", at_once)
    monkeypatch.setattr(commands, "COMMAND_WEIGHTS", {"write": 1})
    assert found(campaign(240), "and the drive holds")
