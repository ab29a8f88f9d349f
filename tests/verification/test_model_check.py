"""The campaign of the gate finds what it looks for: planted holes are found, and without them nothing is (I1, I7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus.core import BusCore
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.station import Station, StationState
from drivebus.drives import permissives
from drivebus.drives.permissives import CommandKind
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from verification.campaign import CampaignRun
from verification.campaigns import gate as campaign
from verification.model_check import core_copy as gate_copy
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import MODEL_NAMES, model_subject
from verification.model_check.search import SearchDomain, SearchResult, StateSearch
from verification.model_check.time_grid import TimeGrid
from verification.model_check.wire_state import WireState
from verification.reference.request_effects import RequestEffect, worst_effect

COARSE, HALVES = TimeGrid(1.0, fine=False), TimeGrid(0.5, fine=False)
EVERYTHING = frozenset(
    {"hang", "raw", "sleep", "remove", "latch", "lose", "stop", "read", "reply", "garble", "everyone", "lease"}
)


def explored(
    model: str = "c320",
    kind: CommandKind = CommandKind.START,
    *,
    only: set[str],
    grid: TimeGrid = COARSE,
    limit: int = 6000,
    world: type[GateState] = GateState,
) -> SearchResult:
    """Until something is wrong, with these events besides those that make a command and pass the time."""
    domain = SearchDomain(rare="garble" in only, small=True, without=EVERYTHING - only)
    return StateSearch(model_subject(model, kind, grid), domain, limit, world).run(first=True)


class KnownStationState(GateState):
    """A station that has answered before: what it is asked may be asked again."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for event in ("open", "step", "read", "step", "reply", "step", "wake"):
            self.apply(event)
        assert self.core.stations[1].state is StationState.ONLINE


def found(text: str, **options: Any) -> None:
    """The hole is found, and is none without the plant (``test_without_a_plant_nothing_is_found``)."""
    bad = explored(**options).findings
    assert any(text in one for one in bad), bad[:1]


# --- the witness's own reading of bytes --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "frame", "act"),
    [
        ("c320", b"*0040100000185\r", RequestEffect.MOTION),
        ("c320", b"*01401000001B6\r", RequestEffect.MOTION),
        ("c320", b"*01403000001B8\r", RequestEffect.STOP),
        ("c320", b"*011010000183\r", RequestEffect.MOTION),
        ("dzb100", b"C\x03\x0101010005", RequestEffect.MOTION),
        ("dzb100", b"C\x03\x0101000000", RequestEffect.STOP),
        ("dzb100", b"C\x03\x0101020005", RequestEffect.MOTION),
        ("vc660", bytes.fromhex("0106200000014200"), RequestEffect.MOTION),
        ("df800", bytes.fromhex("0106200000024200"), RequestEffect.MOTION),
        ("df800", bytes.fromhex("0106200000014200"), RequestEffect.STOP),
        ("df800", bytes.fromhex("01062000000c4200"), RequestEffect.MOTION),
    ],
)
def test_the_manuals_say_what_a_frame_does(model: str, frame: bytes, act: RequestEffect) -> None:
    """T01, T11, T16: a start, a stop that is none, a toggle; a class-1 "read" that carries a run is a run."""
    assert worst_effect(model, frame, 0) is act


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_what_the_manual_calls_motion_no_dialect_calls_less(model: str) -> None:
    """Two readings of each manual: every command word, operation and class."""
    dialect = model_subject(model, CommandKind.RESET, COARSE).dialect
    encode = dialect.codec.encode_request
    for frame in _every_command(model, encode):
        if worst_effect(model, frame, 0) is RequestEffect.MOTION:
            assert dialect.station_config.effect_of(frame) is Effect.MOTION, frame


def _every_command(model: str, encode: Callable[[Any], bytes]) -> list[bytes]:
    if model == "c320":
        return [encode(sunfar.SunfarControl(1, operation)) for operation in sunfar.SunfarOperation]
    if model == "dzb100":
        both = [
            (command, data)
            for command in dzb100.Dzb100Command
            for data in (0, 5)
            if command < dzb100.Dzb100Command.RESET or not data
        ]
        return [encode(dzb100.Dzb100Control(1, command, data)) for command, data in both]
    return [encode(modbus.WriteRegister(1, 0x2000, word)) for word in (*range(0x400), *(1 << bit for bit in range(16)))]


# --- nothing is wrong ---------------------------------------------------------------------------------------------


def test_without_a_plant_nothing_is_found_and_every_condition_was_the_only_one_missing() -> None:
    """Not vacuous: the frame leaves with everything in order, and stays where one thing is missing, whichever."""
    all_but_waits = SearchDomain(rare=False, small=True, without=frozenset({"hang", "raw", "sleep", "read", "reply"}))
    seen = StateSearch(model_subject("c320", CommandKind.START, COARSE), all_but_waits, 100_000).run()
    assert seen.closed and seen.findings == [] and seen.moved > 0
    assert set(seen.refused_by_permissives_only) == {
        "unexpired",
        "no newer stop",
        "port held",
        "station kept",
        "not latched",
        "fresh status",
        "state allows",
        "limits checked",
        "preflight passed",
        "good link",
        "no duplicate",
        "no foreign master",
    }
    assert set(seen.refused_by_bus_only) == {
        "a permit",
        "permit for this station",
        "permit for this effect",
        "port open",
        "unexpired",
        "no newer stop",
        "port held",
        "station kept",
        "not latched",
    }


def test_every_attribute_of_the_bus_is_known_to_the_campaign() -> None:
    """A new one might make two states look alike that are not: say in ``gate_copy.PARTS`` what it is."""
    assert gate_copy.unlisted_attributes(GateState(model_subject("c320", CommandKind.START, COARSE)).core) == []


def test_a_copy_goes_its_own_way() -> None:
    one = GateState(model_subject("vc660", CommandKind.START, COARSE))
    for event in ("open", "step", "read", "stop"):
        one = one.copy().apply(event)
    before = one.state_key()
    for event in ("step", "lose", "latch", "remove", "stop"):
        one.copy().apply(event)
        assert one.state_key() == before


def test_the_same_exploration_gives_the_same_digest() -> None:
    def digest() -> str:
        search = StateSearch(model_subject("df800", CommandKind.JOG, COARSE), SearchDomain(rare=False, small=True), 400)
        search.run()
        return search.digest

    assert digest() == digest()


def test_the_report_says_whether_the_space_was_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        campaign, "ci_explorations", lambda: [replace(campaign.full_explorations()[0], domain=SearchDomain(small=True))]
    )
    session = CampaignRun("gate", 1, 300)
    campaign.CAMPAIGN.run(session)
    assert session.figures["closed"] is False and session.trials == 300 == session.counts["states"]


# --- planted holes ------------------------------------------------------------------------------------------------


def test_a_gate_that_takes_a_stale_status_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(permissives, "MAX_STATUS_AGE_S", float("inf"))
    found("left without: fresh status", only=set())


@pytest.mark.parametrize(
    ("check", "text"),
    [
        ("unmet_bus_permissives", "no duplicate"),
        ("unmet_start_permissives", "good link"),
        ("_check_drive_state", "preflight passed"),
    ],
)
def test_a_gate_without_one_of_its_checks_is_found(monkeypatch: pytest.MonkeyPatch, check: str, text: str) -> None:
    monkeypatch.setattr(permissives, check, lambda *_: ())
    found(text, only=set())


def test_a_gate_that_ignores_the_generation_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    alive = permissives._check_valid
    monkeypatch.setattr(
        permissives,
        "_check_valid",
        lambda command, effect, around: alive(replace(command, stop_epoch=around.stop_epoch), effect, around),
    )
    found("left without: no newer stop", only={"stop", "reply"})


def test_a_gate_that_ignores_the_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(permissives, "COMMAND_TTL_S", dict.fromkeys(CommandKind, 60.0))
    found("left without: unexpired", only=set())


def test_a_bus_that_does_not_check_again_when_the_first_bit_goes_out_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scheduler, "_reject_if_stale", lambda *_: False)
    found("left without: unexpired", only={"read"})


def _without(monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    refusal = PreparedRequest.permit_error

    def lax(self: PreparedRequest, now: float) -> Exception | None:
        error = refusal(self, now)
        return None if error is not None and error.key == key else error

    monkeypatch.setattr(PreparedRequest, "permit_error", lax)


@pytest.mark.parametrize(
    ("key", "text", "only"),
    [
        ("bus.permit_stopped", "no newer stop", {"stop", "reply"}),
        ("bus.start_inhibited", "not latched", {"latch"}),
        ("bus.no_permit", "a permit", set[str]()),
        ("bus.other_permit", "permit for this station", set[str]()),
    ],
)
def test_a_bus_without_one_of_its_checks_is_found(
    monkeypatch: pytest.MonkeyPatch, key: str, text: str, only: set[str]
) -> None:
    _without(monkeypatch, key)
    found(f"left without: {text}", only=only)


def test_a_resend_that_is_not_checked_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A setpoint lost its answer, a stop came meanwhile, and it is sent again."""
    refusal = PreparedRequest.permit_error
    monkeypatch.setattr(PreparedRequest, "permit_error", lambda job, now: None if job.attempts else refusal(job, now))
    only = {"stop", "reply", "garble"}
    found("left without: no newer stop", model="vc660", kind=CommandKind.SETPOINT, only=only, world=KnownStationState)


def test_a_start_that_the_bus_sends_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PreparedRequest, "_max_write_attempts", lambda _: 3)
    monkeypatch.setattr(BusCore, "_may_retry", lambda self, job: job.attempts < job.max_attempts)
    found("left without: sent once", only={"reply", "garble"}, world=KnownStationState)


def test_a_lost_port_that_leaves_permits_valid_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = BusCore.on_port_lost

    def forgetful(self: BusCore, error: Any, now: float) -> Any:
        acts = lost(self, error, now)
        for station in self.stations.values():
            station.stop_epoch -= 1
        return acts

    monkeypatch.setattr(BusCore, "on_port_lost", forgetful)
    found("left without: port held", only={"lose", "reply"}, grid=HALVES)


def test_a_station_that_is_registered_anew_and_free_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Station, "inherit", lambda self, gone: None)
    found("left without: station kept", only={"remove"})
    found("left without: no duplicate", only={"remove", "read", "reply"}, world=WireState, limit=20_000)


def test_a_dialect_that_takes_a_start_for_a_setting_is_found() -> None:
    """The witness reads the bytes itself."""
    one = model_subject("c320", CommandKind.RESET, COARSE)
    start = model_subject("c320", CommandKind.START, COARSE).frames
    one.frames, one.permit_needs = start, {}
    one.dialect.station_config = replace(one.dialect.station_config, effect_of=lambda frame: Effect.SETTING)
    bad = StateSearch(one, SearchDomain(rare=False, small=True, without=EVERYTHING), 3000).run(first=True).findings
    assert bad and "left without" in bad[0]


def test_a_second_master_that_nobody_notices_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """F14, on the wire: the requests are heard, and the gate is not told."""
    monkeypatch.setattr("drivebus.bus.unsolicited.FOREIGN_REQUESTS_REQUIRED", 3)
    found("left without: no foreign master", only=set(), world=WireState)
