"""Models over the API: the same list as the command line, and the profile of one."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest

from drivebus import profiles
from drivebus.errors import NotFound
from drivebus.profiles import listing
from drivebus.profiles.model import DriveProfile
from drivebus.testing.virtual_time import run
from fixtures.service import running_service


def test_every_model_is_listed_with_its_texts_in_both_languages() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            found = (await kit.call("models.list"))["models"]
            assert [profile["model"] for profile in found] == profiles.models()
            vc660 = next(profile for profile in found if profile["model"] == "vc660")
            assert (vc660["maker"]["zh"], vc660["serial"]["baud"]) == (profiles.load("vc660").maker.zh, 9600)

    run(scenario())


def test_the_profile_of_a_model_that_the_plant_does_not_have_is_shown() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            found = await kit.call("models.get", model="gd10")
            assert found["signals"] and found["grade"] == "simulated"

    run(scenario())


@pytest.mark.parametrize(("operation", "params"), [("models.get", {"model": "gd10"}), ("models.list", {})])
def test_no_profile_is_loaded_in_the_loop_of_the_buses(
    operation: str, params: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A profile that nothing had loaded yet delayed every frame, also that of a stop, by up to 17 ms."""
    threads: list[threading.Thread] = []

    def load(model: str) -> DriveProfile:
        threads.append(threading.current_thread())
        return builtin_load(model)

    async def scenario() -> None:
        async with running_service() as kit:
            monkeypatch.setattr(profiles, "load", load)
            monkeypatch.setattr(listing, "load", load)
            await kit.call(operation, **params)

    builtin_load = profiles.load
    asyncio.run(scenario())
    assert threads and threading.main_thread() not in threads


@pytest.mark.parametrize("name", ["nothing", "{folder}/own.toml"])
def test_a_path_is_no_name_of_a_model(name: str, tmp_path: Path) -> None:
    """A client must not find out which files this machine has."""
    (tmp_path / "own.toml").write_text('format = 1\nextends = "vc660"\nmodel = "own"\n', encoding="utf-8")

    async def scenario() -> None:
        async with running_service() as kit:
            with pytest.raises(NotFound) as caught:
                await kit.call("models.get", model=name.format(folder=tmp_path))
            assert caught.value.key == "models.unknown"

    run(scenario())
