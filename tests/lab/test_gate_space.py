"""The campaign of the gate finds what it looks for: planted holes are found, and without them nothing is (I1, I7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus import aftermath
from drivebus.bus.core import BusCore
from drivebus.bus.job import Job
from drivebus.bus.scheduler import Scheduler
from drivebus.bus.stations import Station
from drivebus.drives import gate
from drivebus.drives.gate import Kind
from drivebus.lab.campaign import Session
from drivebus.lab.campaigns import gate as campaign
from drivebus.lab.gate import copy as gate_copy
from drivebus.lab.gate.bytes import READERS, Act
from drivebus.lab.gate.grid import Grid
from drivebus.lab.gate.search import Domain, Found, Search
from drivebus.lab.gate.subject import MODELS, subject
from drivebus.lab.gate.wire import WireWorld
from drivebus.lab.gate.world import World
from drivebus.message import Effect
from drivebus.protocols import dzb, modbus, sifang

COARSE, HALVES = Grid(1.0, fine=False), Grid(0.5, fine=False)
EVERYTHING = frozenset(
    {"hang", "raw", "sleep", "remove", "latch", "lose", "stop", "read", "reply", "garble", "everyone", "lease"}
)


def explored(
    model: str = "c320",
    kind: Kind = Kind.START,
    *,
    only: set[str],
    grid: Grid = COARSE,
    limit: int = 6000,
    world: type[World] = World,
) -> Found:
    """Until something is wrong, with these events besides those that make a command and pass the time."""
    domain = Domain(rare="garble" in only, small=True, without=EVERYTHING - only)
    return Search(subject(model, kind, grid), domain, limit, world).run(first=True)


class Known(World):
    """A station that has answered before: what it is asked may be asked again."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for event in ("open", "step", "read", "step", "reply", "step", "wake"):
            self.happens(event)
        assert self.core.stations[1].seen


def found(text: str, **options: Any) -> None:
    """The hole is found, and is none without the plant (``test_without_a_plant_nothing_is_found``)."""
    bad = explored(**options).bad
    assert any(text in one for one in bad), bad[:1]


# --- the witness's own reading of bytes --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "frame", "act"),
    [
        ("c320", b"*0040100000185\r", Act.MOVES),
        ("c320", b"*01401000001B6\r", Act.MOVES),
        ("c320", b"*01403000001B8\r", Act.STOPS),
        ("c320", b"*011010000183\r", Act.MOVES),
        ("dzb100", b"C\x03\x0101010005", Act.MOVES),
        ("dzb100", b"C\x03\x0101000000", Act.STOPS),
        ("dzb100", b"C\x03\x0101020005", Act.MOVES),
        ("vc660", bytes.fromhex("0106200000014200"), Act.MOVES),
        ("df800", bytes.fromhex("0106200000024200"), Act.MOVES),
        ("df800", bytes.fromhex("0106200000014200"), Act.STOPS),
        ("df800", bytes.fromhex("01062000000c4200"), Act.MOVES),
    ],
)
def test_the_manuals_say_what_a_frame_does(model: str, frame: bytes, act: Act) -> None:
    """T01, T11, T16: a start, a stop that is none, a toggle; a class-1 "read" that carries a run is a run."""
    assert READERS[model](frame, 0) is act


@pytest.mark.parametrize("model", MODELS)
def test_what_the_manual_calls_motion_no_dialect_calls_less(model: str) -> None:
    """Two readings of each manual: every command word, operation and class."""
    dialect = subject(model, Kind.RESET, COARSE).dialect
    encode = dialect.codec.encode_request
    for frame in _every_command(model, encode):
        if READERS[model](frame, 0) is Act.MOVES:
            assert dialect.link.effect(frame) is Effect.MOTION, frame


def _every_command(model: str, encode: Callable[[Any], bytes]) -> list[bytes]:
    if model == "c320":
        return [encode(sifang.Control(1, operation)) for operation in sifang.Operation]
    if model == "dzb100":
        both = [
            (command, data) for command in dzb.Command for data in (0, 5) if command < dzb.Command.RESET or not data
        ]
        return [encode(dzb.Control(1, command, data)) for command, data in both]
    return [encode(modbus.WriteRegister(1, 0x2000, word)) for word in (*range(0x400), *(1 << bit for bit in range(16)))]


# --- nothing is wrong ---------------------------------------------------------------------------------------------


def test_without_a_plant_nothing_is_found_and_every_condition_was_the_only_one_missing() -> None:
    """Not vacuous: the frame leaves with everything in order, and stays where one thing is missing, whichever."""
    all_but_waits = Domain(rare=False, small=True, without=frozenset({"hang", "raw", "sleep", "read", "reply"}))
    seen = Search(subject("c320", Kind.START, COARSE), all_but_waits, 100_000).run()
    assert seen.closed and seen.bad == [] and seen.moved > 0
    assert set(seen.gate_alone) == {
        "unexpired", "no newer stop", "port held", "station kept", "not latched", "fresh status", "state allows",
        "limits checked", "preflight passed", "good link", "no duplicate", "no foreign master",
    }  # fmt: skip
    assert set(seen.bus_alone) == {
        "a permit", "permit for this station", "permit for this effect", "port open", "unexpired", "no newer stop",
        "port held", "station kept", "not latched",
    }  # fmt: skip


def test_every_attribute_of_the_bus_is_known_to_the_campaign() -> None:
    """A new one might make two states look alike that are not: say in ``gate_copy.PARTS`` what it is."""
    assert gate_copy.unlisted(World(subject("c320", Kind.START, COARSE)).core) == []


def test_a_copy_goes_its_own_way() -> None:
    one = World(subject("vc660", Kind.START, COARSE))
    for event in ("open", "step", "read", "stop"):
        one = one.copy().happens(event)
    before = one.name()
    for event in ("step", "lose", "latch", "remove", "stop"):
        one.copy().happens(event)
        assert one.name() == before


def test_the_same_exploration_gives_the_same_digest() -> None:
    def digest() -> str:
        search = Search(subject("df800", Kind.JOG, COARSE), Domain(rare=False, small=True), 400)
        search.run()
        return search.digest

    assert digest() == digest()


def test_the_report_says_whether_the_space_was_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "small", lambda: [replace(campaign.full()[0], domain=Domain(small=True))])
    session = Session("gate", 1, 300)
    campaign.CAMPAIGN.run(session)
    assert session.figures["closed"] is False and session.trials == 300 == session.counts["states"]


# --- planted holes ------------------------------------------------------------------------------------------------


def test_a_gate_that_takes_a_stale_status_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "FRESH_S", float("inf"))
    found("left without: fresh status", only=set())


@pytest.mark.parametrize(
    ("check", "text"),
    [("against_anything", "no duplicate"), ("against_motion", "good link"), ("_drive_is_ready", "preflight passed")],
)
def test_a_gate_without_one_of_its_checks_is_found(monkeypatch: pytest.MonkeyPatch, check: str, text: str) -> None:
    monkeypatch.setattr(gate, check, lambda *_: ())
    found(text, only=set())


def test_a_gate_that_ignores_the_generation_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    alive = gate._alive
    monkeypatch.setattr(
        gate,
        "_alive",
        lambda command, effect, around: alive(replace(command, generation=around.generation), effect, around),
    )
    found("left without: no newer stop", only={"stop", "reply"})


def test_a_gate_that_ignores_the_age_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "EXPIRY_S", dict.fromkeys(Kind, 60.0))
    found("left without: unexpired", only=set())


def test_a_bus_that_does_not_check_again_when_the_first_bit_goes_out_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scheduler, "_stale", lambda *_: False)
    found("left without: unexpired", only={"read"})


def _without(monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    refusal = Job.refusal

    def lax(self: Job, now: float) -> Exception | None:
        error = refusal(self, now)
        return None if error is not None and error.key == key else error

    monkeypatch.setattr(Job, "refusal", lax)


@pytest.mark.parametrize(
    ("key", "text", "only"),
    [
        ("bus.permit_stopped", "no newer stop", {"stop", "reply"}),
        ("bus.latched", "not latched", {"latch"}),
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
    """A setpoint lost its answer, a stop came meanwhile, and it is sent again (F16)."""
    refusal = Job.refusal
    monkeypatch.setattr(Job, "refusal", lambda job, now: None if job.attempts else refusal(job, now))
    only = {"stop", "reply", "garble"}
    found("left without: no newer stop", model="vc660", kind=Kind.SETPOINT, only=only, world=Known)


def test_a_start_that_the_bus_sends_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Job, "_attempts_allowed", lambda _: 3)
    monkeypatch.setattr(aftermath, "_again", lambda job, station: job.attempts < job.attempts_allowed)
    found("left without: sent once", only={"reply", "garble"}, world=Known)


def test_a_lost_port_that_leaves_permits_valid_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = BusCore.lost

    def forgetful(self: BusCore, error: Any, now: float) -> Any:
        acts = lost(self, error, now)
        for station in self.stations.values():
            station.generation -= 1
        return acts

    monkeypatch.setattr(BusCore, "lost", forgetful)
    found("left without: port held", only={"lose", "reply"}, grid=HALVES)


def test_a_station_that_is_registered_anew_and_free_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Station, "follow", lambda self, gone: None)
    found("left without: station kept", only={"remove"})
    found("left without: no duplicate", only={"remove", "read", "reply"}, world=WireWorld, limit=20_000)


def test_a_dialect_that_takes_a_start_for_a_setting_is_found() -> None:
    """The witness reads the bytes itself."""
    one = subject("c320", Kind.RESET, COARSE)
    start = subject("c320", Kind.START, COARSE).frames
    one.frames, one.known = start, {}
    one.dialect.link = replace(one.dialect.link, effect=lambda frame: Effect.SETTING)
    bad = Search(one, Domain(rare=False, small=True, without=EVERYTHING), 3000).run(first=True).bad
    assert bad and "left without" in bad[0]


def test_a_second_master_that_nobody_notices_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """F14, on the wire: the requests are heard, and the gate is not told."""
    monkeypatch.setattr("drivebus.bus.listener.FOREIGN_FRAMES", 3)
    found("left without: no foreign master", only=set(), world=WireWorld)
