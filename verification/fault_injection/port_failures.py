"""One line whose port fails at the n-th call, and what becomes of a user's commands on it."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.testing.virtual_time import Deadlock
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.fault_injection.faulty_port import ErrorTolerantLoop, FaultyPort
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

BAUD, RAMP_S, PORT_POLL_PERIOD_S = 38400, 1, 0.5
CALL_TIMEOUT_S = 5.0
"""Nothing takes so much longer than without the failure."""
CALL_MAX_S = {"open": 0.0, "close": 0.0, "run": 2.5, "set_frequency": 1.5, "stop": 3.0, "write": 2.0}
"""What each call takes at most where nothing fails."""
REPEATED_CALL_MAX_S = 1.0
"""A user waits so long before the next command, where one was not done; the bus opens a port again within 0.4 s."""
PORT_SUCCESS_WORDS = ("confirmed", "acknowledged")
PORT_WRITTEN_PARAMETERS = {"c320": "F0.2", "dzb100": "10", "vc660": "F00.02", "df800": "F1.00"}


class PortFailureScenario:
    """Open, monitor two drives, run, set, stop, write, close; then once more, to see that it works."""

    def __init__(
        self, session: CampaignRun, kind: DriveVariant, name: str, around: Callable[[Any], Any] = lambda port: port
    ) -> None:
        self.session, self.kind = session, kind
        self.loop = ErrorTolerantLoop()
        self.scenario = Scenario(
            session,
            kind,
            (1, 2),
            loop=self.loop,
            name=name,
            seed=1,
            baud=BAUD,
            ramp=RAMP_S,
            around=lambda port: around(FaultyPort(port, self.loop)),
        )

    @property
    def port(self) -> FaultyPort:
        found: Any = self.scenario.bus.port
        return found if isinstance(found, FaultyPort) else found._port

    def run_with_failure(self, nth: int = 0, error: str = "EIO", late: bool = False) -> list[str]:
        """The whole story with this failure in it; all calls that the port had."""
        self.port.lost = self.scenario.oracle.on_unplugged
        self._timed("close", self.scenario.bus.close)
        self.port.arm(nth, error, late)
        self.run()
        self._timed("close", self.scenario.bus.close)
        self._open()
        struck = bool(self.port.failed)
        works = self.check_works()
        if not works and not struck and self.port.failed:
            works = self.check_works()
        if not works:
            self.violation("the bus does not work again")
        self._timed("close", self.scenario.bus.close)
        self.scenario.close()
        self.session.count(f"port: {self.port.failed or 'nothing'} failed")
        return list(self.port.calls_made)

    def run(self) -> None:
        self._open()
        for address in self.scenario.drives:
            self.monitor(address)
        self.step("run", 5.0)
        self.step("set_frequency", 8.0)
        stop = self.step("stop")
        self._check_stopped(stop)
        self.step("write", {PORT_WRITTEN_PARAMETERS[self.kind.model]: 7.0}, True)

    def monitor(self, address: int) -> None:
        self.scenario.monitor(address, period_s=PORT_POLL_PERIOD_S)

    def _open(self) -> None:
        """A user tries twice."""
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
            self.session.count(f"port: {what} raised {type(error).__name__}")
        except Deadlock as error:
            self.violation(f"{what} hangs: {error}")
        except Exception as error:
            self.violation(f"{what} raised {type(error).__name__}: {error}")
        finally:
            if self.loop.time() > began + CALL_MAX_S[what] + CALL_TIMEOUT_S:
                self.violation(f"{what} took {self.loop.time() - began:.2f} s")
        return False

    def step(self, what: str, *arguments: Any) -> UserCommand:
        user_command = self.scenario.command(1, what, *arguments)
        self.scenario.finish(user_command, within_s=CALL_MAX_S[what] + CALL_TIMEOUT_S, step_s=0.05)
        if user_command.result_word not in PORT_SUCCESS_WORDS:
            self.scenario.run(REPEATED_CALL_MAX_S)
        return user_command

    def _check_stopped(self, stop: UserCommand) -> None:
        """A stop goes, be it after the port is back: nobody asks for it again."""
        self.scenario.run(RAMP_S if stop.result_word in PORT_SUCCESS_WORDS else CALL_TIMEOUT_S)
        if self.scenario.station(1).motor.energised:
            self.violation(f"{stop} ended as {stop.result_word}, and the motor stays on")

    def check_works(self) -> bool:
        self.scenario.run(REPEATED_CALL_MAX_S)
        words = [self.step(*command).result_word for command in (("run", 5.0), ("stop",))]
        self.scenario.run(RAMP_S)
        return all(word in PORT_SUCCESS_WORDS for word in words) and not self.scenario.station(1).motor.energised

    def violation(self, text: str) -> None:
        self.scenario.oracle.violation(f"G12 {text}")
