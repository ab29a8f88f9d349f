"""A port that fails in unforeseen ways: the bus reports it by its own errors and continues."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.errors import PortUnavailable
from drivebus.testing.bus_script import ScriptedPort
from drivebus.testing.virtual_time import run
from drivebus.types import Receiver
from fixtures.bus import SETTINGS, FakeStation, read_request, station_config, stop_request, wire_to


class Failing(ScriptedPort):
    """Port whose next calls raise the errors that are set."""

    opening: Exception | None = None
    closing: Exception | None = None
    writing: Exception | None = None

    async def open(self, receiver: Receiver) -> None:
        error, self.opening = self.opening, None
        if error is not None:
            raise error
        await super().open(receiver)

    async def close(self) -> None:
        await super().close()
        if self.closing is not None:
            raise self.closing

    def write(self, data: bytes, /) -> None:
        """Send the bytes and raise nevertheless."""
        super().write(data)
        error, self.writing = self.writing, None
        if error is not None:
            raise error


def record_loop_errors() -> list[Any]:
    reports: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reports.append(context))
    return reports


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), RuntimeError("unforeseen")])
def test_an_unexpected_error_while_opening_a_port_is_reported_as_port_unavailable(error: Exception) -> None:
    async def main() -> None:
        port = Failing(wire_to(FakeStation()), SETTINGS)
        port.opening = error
        bus = Bus(port)
        with pytest.raises(PortUnavailable) as caught:
            await bus.open()
        assert caught.value.__cause__ is error and "scripted://" in str(caught.value)
        assert (getattr(error, "strerror", None) or str(error)) in str(caught.value)
        bus.add_station(station_config())
        await bus.open()
        assert (await bus.transact(read_request())).error is None
        await bus.close()

    run(main())


def test_a_cancelled_opening_stays_cancelled() -> None:
    async def main() -> None:
        port = Failing(wire_to(FakeStation()), SETTINGS)
        port.opening = asyncio.CancelledError()  # type: ignore[assignment]
        with pytest.raises(asyncio.CancelledError):
            await Bus(port).open()

    run(main())


def test_a_port_that_fails_to_close_is_reported_and_nothing_else_fails() -> None:
    async def main() -> None:
        reports = record_loop_errors()
        port = Failing(wire_to(FakeStation()), SETTINGS)
        bus = Bus(port)
        bus.add_station(station_config())
        await bus.open()
        port.closing = OSError(5, "Input/output error")
        await bus.close()
        assert [report["exception"] for report in reports] == [port.closing] and bus.is_closed
        port.closing = None
        await bus.open()
        assert (await bus.transact(read_request())).error is None
        await bus.close()

    run(main())


def test_a_lost_port_that_can_not_be_closed_is_still_opened_again() -> None:
    async def main() -> None:
        reports = record_loop_errors()
        port = Failing(wire_to(FakeStation()), SETTINGS)
        bus = Bus(port)
        bus.add_station(station_config())
        await bus.open()
        port.closing = OSError(5, "Input/output error")
        port.unplug()
        port.plugged = True
        await asyncio.sleep(1.0)
        assert bus.is_open and len(reports) == 1
        assert (await bus.transact(read_request())).error is None
        await bus.close()

    run(main())


def test_a_frame_that_left_although_its_write_failed_has_its_time_and_gap_before_the_next() -> None:
    """The port is opened again at once: the frame is still on the wire then."""

    async def main() -> None:
        record_loop_errors()
        port = Failing(wire_to(FakeStation()), SETTINGS)
        bus = Bus(port)
        bus.add_station(station_config())
        await bus.open()
        port.writing = OSError(5, "Input/output error")
        await bus.transact(read_request())
        await asyncio.sleep(0)
        assert bus.is_open
        await bus.transact(stop_request())
        (first, frame), (second, _) = port.sent[:2]
        assert second - first >= SETTINGS.seconds(len(frame)) + 3.5 * SETTINGS.character_s - 1e-9
        await bus.close()

    run(main())
