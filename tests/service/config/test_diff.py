"""Difference of two configurations: a reload applies it and nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.drives.context import DriveLimits
from drivebus.service import config
from drivebus.service.config import ReloadAction, apply_diff, config_diff
from drivebus.service.config.diff import ConfigDiff
from drivebus.service.config.model import (
    AlarmConfig,
    AlarmKind,
    AuditConfig,
    BusConfig,
    DriveConfig,
    GatewayConfig,
    GroupConfig,
    HistoryConfig,
    InterlockConfig,
    OnRestart,
    PlantConfig,
)
from drivebus.values import Text

titles = st.sampled_from([Text("", ""), Text("Fan", "风机")])


def named(make: Any, ids: str) -> st.SearchStrategy[Any]:
    """Return a strategy: some of these ids in any order, each with an object from ``make``."""

    def of(chosen: list[str]) -> st.SearchStrategy[Any]:
        return st.tuples(*(make(id) for id in chosen))

    return st.lists(st.sampled_from(list(ids)), unique=True).flatmap(of)


def a_drive(id: str) -> st.SearchStrategy[DriveConfig]:
    return st.builds(
        DriveConfig,
        id=st.just(id),
        bus=st.sampled_from("ab"),
        address=st.integers(1, 2),
        model=st.sampled_from(["c320", "vc660"]),
        title=titles,
        options=st.sampled_from([{}, {"nibble": True}]),
        limits=st.sampled_from([DriveLimits(), DriveLimits(5.0)]),
        signals=st.sampled_from([{}, {"output_frequency": 0.5}]),
        min_poll_interval_s=st.sampled_from([0.0, 1.0]),
        on_restart=st.sampled_from(OnRestart),
    )


def a_bus(id: str) -> st.SearchStrategy[BusConfig]:
    return st.builds(BusConfig, st.just(id), st.sampled_from(["/dev/x", "/dev/y"]), title=titles)


plants = st.builds(
    PlantConfig,
    id=st.just("p"),
    title=titles,
    directory=st.just(Path("/state")),
    buses=named(a_bus, "ab"),
    drives=named(a_drive, "uvwxy"),
    groups=named(lambda id: st.builds(GroupConfig, id=st.just(id), drives=st.sampled_from([("u",), ("u", "v")])), "gh"),
    interlocks=named(
        lambda id: st.builds(
            InterlockConfig, id=st.just(id), drives=st.just(("u",)), require=st.sampled_from(["a", "b"])
        ),
        "ij",
    ),
    alarms=named(
        lambda id: st.builds(AlarmConfig, id=st.just(id), kind=st.sampled_from(AlarmKind), drives=st.just(())), "kl"
    ),
    history=st.sampled_from([HistoryConfig(), HistoryConfig(max_size_mb=50.0)]),
    gateways=named(
        lambda id: st.builds(GatewayConfig, id=st.just(id), module=st.just(id), settings=st.sampled_from([1, 2])), "mn"
    ),
    source=st.sampled_from(["plant.toml", "other.toml"]),
)


@settings(max_examples=50)
@given(plants, plants)
def test_applying_the_difference_turns_one_plant_into_the_other(old: PlantConfig, new: PlantConfig) -> None:
    change = config_diff(old, new)
    assert apply_diff(change, old) == new
    same = replace(new, drives=(), buses=(), groups=(), interlocks=(), alarms=(), gateways=())
    assert bool(change) is (
        same != replace(old, drives=(), buses=(), groups=(), interlocks=(), alarms=(), gateways=())
        or any(
            {element.id: element for element in getattr(old, part)}
            != {element.id: element for element in getattr(new, part)}
            for part in ("buses", "drives", "groups", "interlocks", "alarms", "gateways")
        )
    )


def unchanged(change: ConfigDiff) -> tuple[str, ...]:
    """Return the drives that a reload leaves as they are, in the order of the new file."""
    return tuple(id for id in change.drives.order if change.actions.get(id) is ReloadAction.UNCHANGED)


@settings(max_examples=50)
@given(plants)
def test_a_plant_does_not_differ_from_itself(plant: PlantConfig) -> None:
    change = config_diff(plant, plant)
    assert not change and not change.reopened
    assert unchanged(change) == tuple(drive.id for drive in plant.drives)


@settings(max_examples=50)
@given(plants, plants)
def test_an_unchanged_drive_is_the_same_on_the_same_bus(old: PlantConfig, new: PlantConfig) -> None:
    change = config_diff(old, new)
    buses = {bus.id: bus for bus in old.buses}
    for id in unchanged(change):
        assert old.drive(id) == new.drive(id)
        bus = next((bus for bus in new.buses if bus.id == new.drive(id).bus), None)
        if bus is not None and bus.id in buses:
            assert bus.port == buses[bus.id].port
    assert set(change.actions) == {drive.id for drive in old.drives} & {drive.id for drive in new.drives}


TEXT = """
format = 1
[plant]
id = "p"
[bus.a]
port = "tcp://127.0.0.1:1"
[drive.fan]
bus = "a"
address = 1
model = "c320"
[drive.fan-2]
bus = "a"
address = 2
model = "c320"
"""


@pytest.mark.parametrize(
    ("before", "after", "action"),
    [
        ("address = 2", "address = 3", ReloadAction.RECREATE),
        ('address = 2\nmodel = "c320"', 'address = 2\nmodel = "c300"', ReloadAction.RECREATE),
        ("address = 2", "address = 2\noptions = { nibble = true }", ReloadAction.RECREATE),
        ("address = 2", "address = 2\nsignals = { output_frequency = 1.0 }", ReloadAction.REPOLL),
        ("address = 2", "address = 2\nmin_poll_interval_s = 1.0", ReloadAction.REPOLL),
        ("address = 2", "address = 2\nlimits = { maximum_hz = 40.0 }", ReloadAction.UPDATE),
        ("address = 2", "address = 2\ntitle = 'Fan'", ReloadAction.UPDATE),
        ("address = 2", "address = 2\non_client_lost = 'stop'", ReloadAction.UPDATE),
        ("address = 2", "address = 2\non_service_stop = 'hold'", ReloadAction.UPDATE),
        ("address = 2", "address = 2\non_restart = 'stop'", ReloadAction.UPDATE),
        ('id = "p"', 'id = "p"\ntitle = "Plant"', ReloadAction.UNCHANGED),
    ],
)
def test_the_action_for_a_changed_drive_leaves_the_other_drive_unchanged(
    before: str, after: str, action: ReloadAction
) -> None:
    change = config_diff(config.loads(TEXT), config.loads(TEXT.replace(before, after)))
    assert change.actions == {"fan": ReloadAction.UNCHANGED, "fan-2": action}


def test_another_link_recreates_all_drives_of_the_bus_and_another_title_none() -> None:
    old = config.loads(TEXT)
    other = config_diff(old, config.loads(TEXT.replace(":1", ":2")))
    assert other.reopened == ("a",) and set(other.actions.values()) == {ReloadAction.RECREATE}
    titled = config_diff(old, config.loads(TEXT.replace('port = "', 'title = "Line"\nport = "')))
    assert titled.buses.changed and not titled.reopened and unchanged(titled) == ("fan", "fan-2")


def test_a_further_drive_on_a_bus_with_capacity_changes_no_other() -> None:
    more = TEXT + '[drive.fan-3]\nbus = "a"\naddress = 3\nmodel = "c320"\n'
    change = config_diff(config.loads(TEXT), config.loads(more))
    assert unchanged(change) == ("fan", "fan-2") and list(change.drives.added) == ["fan-3"]
    back = config_diff(config.loads(more), config.loads(TEXT))
    assert unchanged(back) == ("fan", "fan-2") and back.drives.removed == ("fan-3",)


def test_the_changed_fields_of_the_plant_itself_have_a_fixed_order() -> None:
    """Regression: the page compares two checks of one file, each from a process of its own. Every other reload was
    refused because the file had "changed meanwhile": a set of names has another order in each process."""
    old = PlantConfig(id="mill", title=Text("", ""), directory=Path("a"), buses=(), drives=())
    new = replace(
        old, id="m", title=Text("M", "M"), directory=Path("b"), history=HistoryConfig(max_size_mb=1.0),
        audit=AuditConfig(key=Path("k")), users=Path("u"), source="s",
    )  # fmt: skip
    changed = ["id", "title", "directory", "history", "audit", "users", "source"]
    assert list(config_diff(old, new).others) == changed
