"""A jog that turns the other way than commanded is remarked on, as a run is."""

from __future__ import annotations

import asyncio
from contextlib import nullcontext
from itertools import chain, repeat
from typing import Any, cast

import pytest

from drivebus import i18n, profiles
from drivebus.cli.commands import jog
from drivebus.cli.connect import Target
from drivebus.cli.remote.drive import RemoteBus, RemoteDrive
from drivebus.cli.signals import ShutdownSignal
from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.drives.dialects.sunfar import SunfarDialect
from drivebus.drives.state import Direction
from drivebus.simulator.port import clear_simulated_buses
from drivebus.testing import virtual_time
from drivebus.types import Json
from fixtures.service import ServiceKit, ready, running_service

REMARK = i18n.text("run.wrong_direction", expected=Direction.FORWARD, found=Direction.REVERSE)
DIALECTS: dict[str, type[Any]] = {"c320": SunfarDialect, "vc660": ModbusDialect}  # DZB100 reports no direction


class HeldKeys:
    """Keyboard on which keys are held for two seconds each, and then q is pressed."""

    def __init__(self, held: str) -> None:
        self._keys = chain([key for key in held for _ in range(22)], repeat("q"))
        self.last_key = ""

    @property
    def last_key_at(self) -> float:
        return asyncio.get_running_loop().time()

    async def get(self, timeout_s: float | None = None) -> str:
        await asyncio.sleep(0.1)
        self.last_key = next(self._keys)
        return self.last_key

    def clear(self) -> None:
        """Keep the keys: each is read when it is pressed."""


def turn_the_other_way(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """Let the drive get the jog of the other direction, as one whose direction bits are exchanged."""
    jog_frames = DIALECTS[model].jog
    other = {Direction.FORWARD: Direction.REVERSE, Direction.REVERSE: Direction.FORWARD}
    monkeypatch.setattr(DIALECTS[model], "jog", lambda self, direction, word: jog_frames(self, other[direction], word))


def shown_by_jog(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], model: str, held: str = " "
) -> str:
    clear_simulated_buses()
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("drivebus.cli.keyboard.raw_keyboard", lambda: nullcontext(HeldKeys(held)))
    target = Target(port=f"sim://{model}@1?ramp=1", model=model, address=1)
    virtual_time.run(jog._jog(target, 0.5 if model == "dzb100" else None))
    clear_simulated_buses()
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("model", [*DIALECTS])
def test_a_jog_in_the_other_direction_is_remarked_on_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], model: str
) -> None:
    """A C320 that reported 05, jog reverse, to 14H was "acknowledged" and nothing more."""
    turn_the_other_way(monkeypatch, model)
    assert shown_by_jog(monkeypatch, capsys, model).count(REMARK) == 1


@pytest.mark.parametrize("model", [*DIALECTS, "dzb100"])
def test_jogs_in_the_commanded_direction_are_not_remarked_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], model: str
) -> None:
    shown = shown_by_jog(monkeypatch, capsys, model, " r ")
    assert "ATTENTION" not in shown and shown.count(i18n.text("drives.jog_begun")) == 3


class KitClient:
    """Client of a service in the same event loop."""

    is_local = True

    def __init__(self, kit: ServiceKit) -> None:
        self._kit = kit

    async def call(self, operation: str, params: Json) -> Json:
        return await self._kit.call(operation, **params)


@pytest.mark.parametrize(("drive", "model"), [("fan-1", "c320"), ("pump-1", "vc660")])
@pytest.mark.parametrize("is_wrong", [True, False])
def test_a_jog_through_a_service_is_remarked_on_likewise(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], drive: str, model: str, is_wrong: bool
) -> None:
    async def scenario() -> None:
        monkeypatch.setattr(RemoteBus, "now", staticmethod(lambda: asyncio.get_running_loop().time()))
        async with running_service() as kit:
            await ready(kit)
            remote: Any = RemoteDrive(cast(Any, KitClient(kit)), drive, 1, profiles.load(model))
            for key, direction in (("r", Direction.REVERSE), (" ", Direction.FORWARD)):
                if is_wrong and key == " ":
                    turn_the_other_way(monkeypatch, model)
                keys: Any = HeldKeys(key)
                await keys.get()
                session = remote.jog(None, direction)
                await jog._jog_while_held(
                    session, cast(Any, RemoteBus()), keys, ShutdownSignal(), key, remote, direction
                )
            await remote.close()

    virtual_time.run(scenario())
    shown = " ".join(capsys.readouterr().out.split())
    assert (shown.count(REMARK), shown.count("ATTENTION")) == (is_wrong, is_wrong)
