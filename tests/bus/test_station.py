"""States of a station: the drawn table equals the table of the code, and the bus makes each of its transitions."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from drivebus.bus import station as station_module
from drivebus.bus.station import (
    MAX_PROBE_INTERVAL_S,
    TRANSITIONS,
    Presence,
    Station,
    StationEvent,
    StationState,
)
from drivebus.errors import PortLost
from drivebus.testing.bus_script import BusScript
from fixtures.bus import SETTINGS, FakeStation, make_core, read_request, station_config, wire_to

Transition = tuple[StationState, StationEvent, StationState]


def drawn_table() -> dict[tuple[StationState, StationEvent], StationState]:
    """Return the table in the docstring of the module, without its ``-`` entries."""
    assert station_module.__doc__ is not None
    rows = [line.strip().split("|") for line in station_module.__doc__.splitlines() if "|" in line]
    events = [StationEvent[name.strip()] for name in rows[0][1:]]
    return {
        (StationState[row[0].strip()], event): StationState[cell.strip()]
        for row in rows[1:]
        for event, cell in zip(events, row[1:], strict=True)
        if cell.strip() != "-"
    }


def test_the_drawn_table_is_the_table_of_the_code() -> None:
    assert drawn_table() == TRANSITIONS
    assert len({state for state, _ in TRANSITIONS}) == len(StationState)


@pytest.mark.parametrize("state", StationState)
@pytest.mark.parametrize(
    ("event", "action"),
    [
        (StationEvent.REPLY, lambda station: station.mark_replied()),
        (StationEvent.SYNC_CONFIRMED, lambda station: station.mark_online(verified=True)),
        (StationEvent.SYNC_UNVERIFIED, lambda station: station.mark_online(verified=False)),
        (StationEvent.SUSPICION, lambda station: station.mark_suspect(1.0)),
        (StationEvent.NO_CONTACT, lambda station: station.mark_offline(1.0)),
    ],
)
def test_each_event_moves_a_station_as_drawn(
    state: StationState, event: StationEvent, action: Callable[[Station], None]
) -> None:
    station = Station(station_config(), SETTINGS)
    station.state = state
    action(station)
    assert station.state is drawn_table().get((state, event), state)


@pytest.fixture
def transitions(monkeypatch: pytest.MonkeyPatch) -> Iterator[set[Transition]]:
    """Yield the transitions that a bus makes in the test; an undrawn transition fails at once."""
    made: set[Transition] = set()
    change = Station._change

    def recorded(station: Station, event: StationEvent) -> None:
        before = station.state
        assert (before, event) in TRANSITIONS, f"{event.name} in state {before.name} is not drawn"
        change(station, event)
        made.add((before, event, station.state))

    monkeypatch.setattr(Station, "_change", recorded)
    yield made


def state_of(script: BusScript) -> StationState:
    return script.core.stations[1].state


def read(script: BusScript) -> None:
    """Submit a read and run until its result, without sync probes."""
    script.submit(read_request(), token := object())
    script.result(token)


def replug(script: BusScript) -> None:
    """Lose the port and open it again, which also restarts the echo detection."""
    script.lose_port(PortLost("bus.closed"))
    script.reopen()


def after_probe(script: BusScript, seconds: float = MAX_PROBE_INTERVAL_S + 10.0) -> None:
    script.run_until(script.now + seconds)


def a_station_that_comes_and_goes(script: BusScript, station: FakeStation) -> None:
    """Make a station online, suspect after a timeout, offline after its sync probe, and online again."""
    read(script)
    read(script)
    station.alive = False
    script.submit(read_request(), "suspect")
    script.run_until(script.now + 0.1)
    assert state_of(script) is StationState.SUSPECT
    station.alive = True
    after_probe(script)
    assert state_of(script) is StationState.ONLINE
    station.alive = False
    read(script)
    after_probe(script)
    assert state_of(script) is StationState.OFFLINE
    station.alive = True
    after_probe(script)
    assert state_of(script) is StationState.ONLINE


def a_port_that_is_replugged(script: BusScript, station: FakeStation) -> None:
    """Reopen the port; the first reply mirrors its sync probe and may be our own echo."""
    read(script)
    replug(script)
    assert state_of(script) is StationState.SUSPECT
    after_probe(script)
    assert state_of(script) is StationState.ONLINE
    station.alive = False
    read(script)
    after_probe(script)
    replug(script)
    assert state_of(script) is StationState.OFFLINE
    station.alive = True
    after_probe(script)
    assert state_of(script) is StationState.ONLINE


def a_station_that_was_never_seen(script: BusScript, station: FakeStation) -> None:
    station.alive = False
    read(script)
    assert state_of(script) is StationState.ABSENT
    after_probe(script)
    station.alive = True
    after_probe(script)
    assert state_of(script) is StationState.NEVER_SEEN


def a_new_station_when_the_port_is_replugged(script: BusScript, station: FakeStation) -> None:
    replug(script)
    replug(script)
    assert state_of(script) is StationState.NEVER_SEEN_SUSPECT
    after_probe(script)
    assert state_of(script) is StationState.NEVER_SEEN
    replug(script)
    script.core.registry.add(station_config(2))
    script.submit(read_request(2), "rules the echo out")
    after_probe(script)
    assert state_of(script) is StationState.ONLINE


def an_absent_station_beside_one_that_replies(script: BusScript, station: FakeStation) -> None:
    station.alive = False
    read(script)
    script.core.registry.add(station_config(2))
    script.submit(read_request(2), "rules the echo out")
    script.run_until(script.now + 0.2)
    assert state_of(script) is StationState.ABSENT
    station.alive = True
    after_probe(script)
    assert state_of(script) is StationState.ONLINE


def test_the_bus_makes_every_drawn_transition_and_no_other(transitions: set[Transition]) -> None:
    for scenario in (
        a_station_that_comes_and_goes,
        a_port_that_is_replugged,
        a_station_that_was_never_seen,
        a_new_station_when_the_port_is_replugged,
        an_absent_station_beside_one_that_replies,
    ):
        first, second = FakeStation(address=1), FakeStation(address=2)
        scenario(BusScript(make_core(1), wire_to(first, second)), first)
    assert transitions == {(state, event, after) for (state, event), after in TRANSITIONS.items()}


def test_a_state_defines_the_permitted_requests() -> None:
    trusted = {state for state in StationState if not state.is_suspect}
    assert trusted == {StationState.NEVER_SEEN, StationState.ONLINE}
    assert {state for state in StationState if state.is_unreachable} == {StationState.ABSENT, StationState.OFFLINE}
    assert {state.presence for state in trusted} == {Presence.NEVER_SEEN, Presence.ONLINE}


def test_a_presence_has_the_name_that_the_api_gives_it() -> None:
    assert list(Presence) == ["never_seen", "online", "offline"]
