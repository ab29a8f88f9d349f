"""Port whose n-th call fails, and a scenario of a user's commands on it."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Coroutine
from typing import Any

from drivebus.errors import DrivebusError, PortLost, PortUnavailable
from drivebus.testing.virtual_time import Deadlock, VirtualLoop
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.campaigns import written_parameter
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

# --- port -------------------------------------------------------------------------------------------------------------

PORT_ERRORS: dict[str, Callable[[], Exception]] = {
    **{
        name: (lambda code: lambda: OSError(code, os.strerror(code)))(getattr(errno, name))
        for name in ("EIO", "ENODEV", "EACCES", "ENOSPC")
    },
    "PortLost": lambda: PortLost("ports.lost", port="faulty", reason="injected"),
    "PortUnavailable": lambda: PortUnavailable("sim.unplugged", port="faulty"),
    "RuntimeError": lambda: RuntimeError("unexpected"),
}


def failure_modes(what: str) -> tuple[tuple[str, bool], ...]:
    """Return the failure modes of a call: the error, and whether its bytes are sent nevertheless."""
    plain = tuple((name, False) for name in PORT_ERRORS)
    return {"write": (*plain, ("EIO", True), ("RuntimeError", True)), "read": plain[:1]}.get(what, plain)


class FaultyPort:
    """Port whose ``nth`` call fails; 0: none. A failing delivery loses its bytes and the port.

    ``sends_anyway``: the bytes of the failing write are sent nevertheless.
    """

    def __init__(self, port: Any, loop: ErrorTolerantLoop) -> None:
        self._port, self._loop, self._receiver = port, loop, None
        self.nth = self.calls = 0
        self.error, self.sends_anyway = "", False
        self.failed = ""
        self.calls_made: list[str] = []
        """Names of all calls, in order."""
        self.on_lost: Callable[[], None] = lambda: None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    def arm(self, nth: int, error: str, *, sends_anyway: bool) -> None:
        """Count calls from now on."""
        self.nth, self.error, self.sends_anyway, self.calls, self.failed = nth, error, sends_anyway, 0, ""
        self.calls_made.clear()

    def _fails(self, what: str) -> Exception | None:
        self.calls += 1
        self.calls_made.append(what)
        if self.calls != self.nth:
            return None
        self.failed = what
        self._loop.injected = PORT_ERRORS[self.error]()
        self.on_lost()
        return self._loop.injected

    async def open(self, receiver: Any) -> None:
        if (error := self._fails("open")) is not None:
            raise error
        self._receiver = receiver
        await self._port.open(self)

    def write(self, data: bytes, /) -> None:
        if self.sends_anyway or self.calls + 1 != self.nth:
            self._port.write(data)
        if (error := self._fails("write")) is not None:
            raise error

    async def close(self) -> None:
        await self._port.close()
        if (error := self._fails("close")) is not None:
            raise error

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        receiver: Any = self._receiver
        if self._fails("read") is None:
            receiver.data_received(data, line_errors)
        else:
            self._port._receiver = None
            self._port.simulated_bus.detach(self._port)
            receiver.port_lost(PortLost("ports.lost", port="faulty", reason=self.error))

    def port_lost(self, error: PortLost) -> None:
        receiver: Any = self._receiver
        receiver.port_lost(error)


class ErrorTolerantLoop(VirtualLoop):
    """Loop to which a report of the injected error is no violation."""

    injected: Exception | None = None

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        if self.injected is None or context.get("exception") is not self.injected:
            super().call_exception_handler(context)


# --- scenario ---------------------------------------------------------------------------------------------------------

BAUD, RAMP_S, PORT_POLL_PERIOD_S = 38400, 1, 0.5
CALL_TIMEOUT_S = 5.0
"""Longest additional time of a call with a failure, in seconds."""
CALL_MAX_S = {"open": 0.0, "close": 0.0, "run": 2.5, "set_frequency": 1.5, "stop": 3.0, "write": 2.0}
"""Longest time of each call without a failure, in seconds."""
REPEATED_CALL_MAX_S = 1.0
"""Time that a user waits after a failed command, in seconds; the bus reopens a port within 0.4 s."""


class PortFailureScenario:
    """Open, monitor two drives, run, set, stop, write and close; then repeat to check that everything works."""

    def __init__(
        self,
        campaign_run: CampaignRun,
        variant: DriveVariant,
        name: str,
        wrap_port: Callable[[Any], Any] = lambda port: port,
    ) -> None:
        self.campaign_run, self.variant = campaign_run, variant
        self.loop = ErrorTolerantLoop()
        self.scenario = Scenario(
            campaign_run,
            variant,
            (1, 2),
            loop=self.loop,
            name=name,
            seed=1,
            baud=BAUD,
            ramp=RAMP_S,
            wrap_port=lambda port: wrap_port(FaultyPort(port, self.loop)),
        )

    @property
    def port(self) -> FaultyPort:
        found: Any = self.scenario.bus.port
        return found if isinstance(found, FaultyPort) else found._port

    def run_with_failure(self, nth: int = 0, error: str = "EIO", *, sends_anyway: bool = False) -> list[str]:
        """Run the scenario with this failure; return all calls of the port."""
        self.port.on_lost = self.scenario.oracle.on_unplugged
        self._timed("close", self.scenario.bus.close)
        self.port.arm(nth, error, sends_anyway=sends_anyway)
        self.run()
        self._timed("close", self.scenario.bus.close)
        self._open()
        has_failed = bool(self.port.failed)
        works = self.check_works()
        if not works and not has_failed and self.port.failed:
            works = self.check_works()
        if not works:
            self.violation("the bus does not work again")
        self._timed("close", self.scenario.bus.close)
        self.scenario.close()
        self.campaign_run.count(f"port: {self.port.failed or 'nothing'} failed")
        return list(self.port.calls_made)

    def run(self) -> None:
        self._open()
        for address in self.scenario.drives:
            self.monitor(address)
        self.step("run", 5.0)
        self.step("set_frequency", 8.0)
        stop = self.step("stop")
        self._check_stopped(stop)
        self.step("write", {written_parameter(self.variant.model).notation: 7.0}, save=True)

    def monitor(self, address: int) -> None:
        self.scenario.monitor(address, period_s=PORT_POLL_PERIOD_S)

    def _open(self) -> None:
        """Open the bus, with a second attempt after a failure."""
        if not self._timed("open", self.scenario.bus.open):
            self.scenario.run(REPEATED_CALL_MAX_S)
            if not self._timed("open", self.scenario.bus.open):
                self.violation("the port works again, and can't be opened")

    def _timed(self, what: str, call: Callable[[], Coroutine[Any, Any, None]]) -> bool:
        began = self.loop.time()
        try:
            self.loop.run_until_complete(call())
            return True
        except DrivebusError as error:
            self.campaign_run.count(f"port: {what} raised {type(error).__name__}")
        except Deadlock as error:
            self.violation(f"{what} hangs: {error}")
        except Exception as error:
            self.violation(f"{what} raised {type(error).__name__}: {error}")
        finally:
            if self.loop.time() > began + CALL_MAX_S[what] + CALL_TIMEOUT_S:
                self.violation(f"{what} took {self.loop.time() - began:.2f} s")
        return False

    def step(self, what: str, *arguments: Any, **keywords: Any) -> UserCommand:
        user_command = self.scenario.command(1, what, *arguments, **keywords)
        self.scenario.finish(user_command, within_s=CALL_MAX_S[what] + CALL_TIMEOUT_S, step_s=0.05)
        if not user_command.succeeded:
            self.scenario.run(REPEATED_CALL_MAX_S)
        return user_command

    def _check_stopped(self, stop: UserCommand) -> None:
        """Check that the stop takes effect without another command, at the latest when the port is back."""
        self.scenario.run(RAMP_S if stop.succeeded else CALL_TIMEOUT_S)
        if self.scenario.station(1).motor.energised:
            self.violation(f"{stop} ended as {stop.result_word}, and the motor stays on")

    def check_works(self) -> bool:
        self.scenario.run(REPEATED_CALL_MAX_S)
        commands = [self.step(*command) for command in (("run", 5.0), ("stop",))]
        self.scenario.run(RAMP_S)
        return all(command.succeeded for command in commands) and not self.scenario.station(1).motor.energised

    def violation(self, text: str) -> None:
        self.scenario.oracle.violation(f"after a failure: {text}")
