"""One line whose port fails at the n-th call, and what becomes of a user's commands on it (G12)."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.lab.breaking.faultyport import FaultyPort, ForgivingLoop
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import Kind
from drivebus.lab.world.loop import Stuck
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.wishes import Wish

BAUD, RAMP_S, PERIOD_S = 38400, 1, 0.5
HANG_S = 5.0
"""Nothing takes so much longer than without the failure (G12)."""
LONGEST_S = {"open": 0.0, "close": 0.0, "run": 2.5, "set_frequency": 1.5, "stop": 3.0, "write": 2.0}
"""What each call takes at most where nothing fails."""
AGAIN_S = 1.0
"""A user waits so long before the next command, where one was not done; the bus opens a port again within 0.4 s."""
DONE = ("confirmed", "acknowledged")
WRITTEN = {"c320": "F0.2", "dzb100": "10", "vc660": "F00.02", "df800": "F1.00"}


class PortStory:
    """Open, monitor two drives, run, set, stop, write, close; then once more, to see that it works."""

    def __init__(
        self, session: Session, kind: Kind, name: str, around: Callable[[Any], Any] = lambda port: port
    ) -> None:
        self.session, self.kind = session, kind
        self.loop = ForgivingLoop()
        self.stand = Stand(
            session, kind, (1, 2), loop=self.loop, name=name, seed=1, baud=BAUD, ramp=RAMP_S,
            around=lambda port: around(FaultyPort(port, self.loop)),
        )  # fmt: skip

    @property
    def port(self) -> FaultyPort:
        found: Any = self.stand.bus.port
        return found if isinstance(found, FaultyPort) else found._port

    def fails(self, nth: int = 0, error: str = "EIO", late: bool = False) -> list[str]:
        """The whole story with this failure in it; all calls that the port had."""
        self.port.lost = self.stand.witness.unplugged
        self._timed("close", self.stand.bus.close)
        self.port.arm(nth, error, late)
        self.live()
        self._timed("close", self.stand.bus.close)
        self._open()
        struck = bool(self.port.failed)
        works = self.works()
        if not works and not struck and self.port.failed:
            works = self.works()
        if not works:
            self.wrong("the bus does not work again")
        self._timed("close", self.stand.bus.close)
        self.stand.close()
        self.session.count(f"port: {self.port.failed or 'nothing'} failed")
        return list(self.port.row)

    def live(self) -> None:
        self._open()
        for address in self.stand.drives:
            self.watch(address)
        self.step("run", 5.0)
        self.step("set_frequency", 8.0)
        stop = self.step("stop")
        self._stopped(stop)
        self.step("write", {WRITTEN[self.kind.model]: 7.0}, True)

    def watch(self, address: int) -> None:
        self.stand.monitor(address, period_s=PERIOD_S)

    def _open(self) -> None:
        """A user tries twice."""
        if not self._timed("open", self.stand.bus.open):
            self.stand.run(AGAIN_S)
            if not self._timed("open", self.stand.bus.open):
                self.wrong("the port works again, and can't be opened")

    def _timed(self, what: str, call: Callable[[], Coroutine[Any, Any, None]]) -> bool:
        began = self.loop.time()
        try:
            self.loop.run(call())
            return True
        except DrivebusError as error:
            self.session.count(f"port: {what} raised {type(error).__name__}")
        except Stuck as error:
            self.wrong(f"{what} hangs: {error}")
        except Exception as error:
            self.wrong(f"{what} raised {type(error).__name__}: {error}")
        finally:
            if self.loop.time() > began + LONGEST_S[what] + HANG_S:
                self.wrong(f"{what} took {self.loop.time() - began:.2f} s")
        return False

    def step(self, what: str, *arguments: Any) -> Wish:
        wish = self.stand.wish(1, what, *arguments)
        self.stand.finish(wish, within_s=LONGEST_S[what] + HANG_S, step_s=0.05)
        if wish.word not in DONE:
            self.stand.run(AGAIN_S)
        return wish

    def _stopped(self, stop: Wish) -> None:
        """A stop goes, be it after the port is back: nobody asks for it again."""
        self.stand.run(RAMP_S if stop.word in DONE else HANG_S)
        if self.stand.station(1).motor.energised:
            self.wrong(f"{stop} ended as {stop.word}, and the motor stays on")

    def works(self) -> bool:
        self.stand.run(AGAIN_S)
        words = [self.step(*command).word for command in (("run", 5.0), ("stop",))]
        self.stand.run(RAMP_S)
        return all(word in DONE for word in words) and not self.stand.station(1).motor.energised

    def wrong(self, text: str) -> None:
        self.stand.witness.violation(f"G12 {text}")
