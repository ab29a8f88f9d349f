"""The campaign ``gate`` finds planted holes in the motion gate, and none in the product (I1, I7)."""

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
from verification.model_check import core_copy as core_copy
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import MODEL_NAMES, TimeGrid, model_subject
from verification.model_check.search import SearchDomain, SearchResult, StateSearch
from verification.model_check.wire_state import WireState
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import worst_effect

COARSE, HALVES = TimeGrid(1.0, fine=False), TimeGrid(0.5, fine=False)
EVERYTHING = frozenset(
    {"hang", "raw", "sleep", "remove", "inhibit", "lose", "stop", "read", "reply", "garble", "everyone", "lease"}
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
    """Search until the first finding, with these events besides those that create a command and pass time."""
    domain = SearchDomain(rare="garble" in only, small=True, without=EVERYTHING - only)
    return StateSearch(model_subject(model, kind, grid), domain, limit, world).run(first=True)


class KnownStationState(GateState):
    """State with a station that is online, so that its requests may be retried."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for event in ("open", "step", "read", "step", "reply", "step", "wake"):
            self.apply(event)
        assert self.core.stations[1].state is StationState.ONLINE


def found(text: str, **options: Any) -> None:
    """Check that the search finds the planted hole."""
    findings = explored(**options).findings
    assert any(text in finding for finding in findings), findings[:1]


# --- the permit monitor's own reading of bytes ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "frame", "effect"),
    [
        ("c320", b"*00401000001B5\r", RequestEffect.MOTION),
        ("c320", b"*01401000001B6\r", RequestEffect.MOTION),
        ("c320", b"*01403000001B8\r", RequestEffect.STOP),
        ("c320", b"*011010000183\r", RequestEffect.MOTION),
        ("dzb100", b"C\x03\x0101010005", RequestEffect.MOTION),
        ("dzb100", b"C\x03\x0101000000", RequestEffect.STOP),
        ("dzb100", b"C\x03\x0101020005", RequestEffect.MOTION),
        ("vc660", bytes.fromhex("01062000000143ca"), RequestEffect.MOTION),
        ("df800", bytes.fromhex("01062000000203cb"), RequestEffect.MOTION),
        ("df800", bytes.fromhex("01062000000143ca"), RequestEffect.STOP),
        ("df800", bytes.fromhex("01062000000c820f"), RequestEffect.MOTION),
        ("df800", bytes.fromhex("01062000000143cb"), RequestEffect.MOTION),
    ],
)
def test_frames_have_the_effect_of_the_manuals(model: str, frame: bytes, effect: RequestEffect) -> None:
    """A start, a stop with data, a toggle, a read that carries a run command, and a wrong check (T01, T11, T16)."""
    assert worst_effect(model, frame, 0) is effect


@pytest.mark.parametrize("model", MODEL_NAMES)
def test_every_motion_of_the_manual_is_motion_in_the_dialect(model: str) -> None:
    """Product and reference agree on every command word, operation and class."""
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


def test_the_product_has_no_finding_and_each_condition_alone_prevents_a_frame() -> None:
    """The frame is sent with everything met, and each condition alone prevents it."""
    all_but_waits = SearchDomain(rare=False, small=True, without=frozenset({"hang", "raw", "sleep", "read", "reply"}))
    result = StateSearch(model_subject("c320", CommandKind.START, COARSE), all_but_waits, 100_000).run()
    assert result.closed and result.findings == [] and result.motion_frames > 0
    assert set(result.refused_by_permissives_only) == {
        "unexpired",
        "no newer stop",
        "port held",
        "station kept",
        "no start inhibit",
        "fresh status",
        "state allows",
        "limits checked",
        "preflight passed",
        "good link",
        "no duplicate",
        "no foreign master",
    }
    assert set(result.refused_by_bus_only) == {
        "a permit",
        "permit for this station",
        "permit for this effect",
        "port open",
        "unexpired",
        "no newer stop",
        "port held",
        "station kept",
        "no start inhibit",
    }


def test_every_attribute_of_the_bus_is_known_to_the_campaign() -> None:
    """An unlisted attribute could make different states look alike: list it in ``core_copy.NAMED_ATTRIBUTES``."""
    assert core_copy.unlisted_attributes(GateState(model_subject("c320", CommandKind.START, COARSE)).core) == []


def test_a_copy_is_independent() -> None:
    state = GateState(model_subject("vc660", CommandKind.START, COARSE))
    for event in ("open", "step", "read", "stop"):
        state = state.copy().apply(event)
    before = state.state_key()
    for event in ("step", "lose", "inhibit", "remove", "stop"):
        state.copy().apply(event)
        assert state.state_key() == before


def test_a_copied_bus_looks_up_the_sender_of_unsolicited_bytes_among_its_own_stations() -> None:
    core = core_copy.copy_core(GateState(model_subject("vc660", CommandKind.START, COARSE)).core)
    assert core.unsolicited._stations is core.stations and core.unsolicited._scheduler is core.scheduler


def test_the_same_search_gives_the_same_digest() -> None:
    def digest() -> str:
        search = StateSearch(model_subject("df800", CommandKind.JOG, COARSE), SearchDomain(rare=False, small=True), 400)
        search.run()
        return search.digest

    assert digest() == digest()


def test_the_report_says_whether_the_space_was_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        campaign, "ci_explorations", lambda: [replace(campaign.full_explorations()[0], domain=SearchDomain(small=True))]
    )
    campaign_run = CampaignRun(campaign="gate", seed=1, budget=300)
    campaign.CAMPAIGN.run(campaign_run)
    assert campaign_run.figures["closed"] is False and campaign_run.trials == 300 == campaign_run.counts["states"]


# --- planted holes ------------------------------------------------------------------------------------------------


def test_a_gate_that_accepts_a_stale_status_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_gate_that_ignores_newer_stops_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    check_valid = permissives._check_valid
    monkeypatch.setattr(
        permissives,
        "_check_valid",
        lambda command, effect, around: check_valid(replace(command, stop_epoch=around.stop_epoch), effect, around),
    )
    found("left without: no newer stop", only={"stop", "reply"})


def test_a_gate_that_ignores_the_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(permissives, "COMMAND_TTL_S", dict.fromkeys(CommandKind, 60.0))
    found("left without: unexpired", only=set())


def test_a_bus_without_the_check_at_the_first_bit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
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
        ("bus.start_inhibited", "no start inhibit", {"inhibit"}),
        ("bus.no_permit", "a permit", set[str]()),
        ("bus.other_permit", "permit for this station", set[str]()),
    ],
)
def test_a_bus_without_one_of_its_checks_is_found(
    monkeypatch: pytest.MonkeyPatch, key: str, text: str, only: set[str]
) -> None:
    _without(monkeypatch, key)
    found(f"left without: {text}", only=only)


def test_a_retry_without_a_check_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A setpoint whose reply was lost is sent again after a stop."""
    refusal = PreparedRequest.permit_error
    monkeypatch.setattr(
        PreparedRequest, "permit_error", lambda prepared, now: None if prepared.attempts else refusal(prepared, now)
    )
    only = {"stop", "reply", "garble"}
    found("left without: no newer stop", model="vc660", kind=CommandKind.SETPOINT, only=only, world=KnownStationState)


def test_a_start_that_the_bus_sends_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PreparedRequest, "_max_write_attempts", lambda _: 3)
    monkeypatch.setattr(BusCore, "_may_retry", lambda self, prepared: prepared.attempts < prepared.max_attempts)
    found("left without: sent once", only={"reply", "garble"}, world=KnownStationState)


def test_a_lost_port_that_leaves_permits_valid_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = BusCore.on_port_lost

    def forgetful(self: BusCore, error: Any, now: float) -> Any:
        commands = lost(self, error, now)
        for station in self.stations.values():
            station.stop_epoch -= 1
        return commands

    monkeypatch.setattr(BusCore, "on_port_lost", forgetful)
    found("left without: port held", only={"lose", "reply"}, grid=HALVES)


def test_a_registered_station_that_forgets_its_inhibit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Station, "inherit", lambda self, gone: None)
    found("left without: station kept", only={"remove"})
    found("left without: no duplicate", only={"remove", "read", "reply"}, world=WireState, limit=20_000)


def test_a_start_classified_as_a_setting_is_found() -> None:
    """The permit monitor reads the bytes itself."""
    subject = model_subject("c320", CommandKind.RESET, COARSE)
    start = model_subject("c320", CommandKind.START, COARSE).frames
    subject.frames, subject.permit_needs = start, {}
    right = subject.dialect.station_config.effect_of
    wrong = {Effect.MOTION: Effect.SETTING}
    subject.dialect.station_config = replace(
        subject.dialect.station_config, effect_of=lambda frame: wrong.get(right(frame), right(frame))
    )
    findings = (
        StateSearch(subject, SearchDomain(rare=False, small=True, without=EVERYTHING), 3000).run(first=True).findings
    )
    assert findings and "left without" in findings[0]


def test_an_undetected_foreign_master_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The foreign requests are received, and the gate does not get them."""
    monkeypatch.setattr("drivebus.bus.unsolicited.FOREIGN_REQUESTS_REQUIRED", 3)
    found("left without: no foreign master", only=set(), world=WireState)
