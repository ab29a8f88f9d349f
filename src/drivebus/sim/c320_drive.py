"""What the pretend C320 does: runs, jogs, stops, counts the silence of its host, rides through power dips. Pure.

No frame is known here. Monitors d.2, d.3 and d.5 are the sim's own; chapter 4.3 of the manual is not published.
"""

from __future__ import annotations

from drivebus.protocols.sifang import Operation, Response, State
from drivebus.sim.c320_tables import (
    ACCEL_TIME,
    COMMAND_CHANNEL,
    DECEL_TIME,
    FAULT_CODES,
    FREQUENCY_CHANNEL,
    FROM_BUS,
    JOG_HZ,
    KEYPAD_HZ,
    MAXIMUM_HZ,
    SPEED_SEARCH,
    START_MODE,
    CommLoss,
    cells,
)
from drivebus.sim.motor import Motor, Phase, Trip
from drivebus.sim.station import Station

STARTS = {
    Operation.RUN_FORWARD: 1,
    Operation.RUN_REVERSE: -1,
    Operation.RUN_FORWARD_AT: 1,
    Operation.RUN_REVERSE_AT: -1,
}
JOGS = {
    Operation.JOG_FORWARD: 1,
    Operation.JOG_REVERSE: -1,
    Operation.JOG_FORWARD_AT: 1,
    Operation.JOG_REVERSE_AT: -1,
}
STOPS = frozenset((Operation.STOP, Operation.STOP_AT, Operation.JOG_STOP, Operation.JOG_STOP_AT))


class C320Drive(Station):
    """The drive behind the protocol of ``C320Station``."""

    ramp_keys = (ACCEL_TIME, DECEL_TIME)

    def __init__(
        self,
        address: int,
        step_hz: float,
        current_at_1: bool,
        selector: int,
        comm_loss: CommLoss,
        motor: Motor | None,
    ) -> None:
        super().__init__(address, cells(step_hz, selector, comm_loss), motor)
        self.selector = selector
        self.comm_loss = comm_loss
        self.step_hz = step_hz
        self.current_at_1 = current_at_1
        self.power_up()

    def power_up(self) -> None:
        self.emergency = False
        self.dip_left_s = 0.0
        self.restarting = False
        self.silent_s: float | None = None
        """Seconds since the last frame for this drive; None before the first."""

    # Time.

    def elapse(self, dt: float) -> None:
        self.motor.accel_s = self.memory[ACCEL_TIME] / 10.0
        self.motor.decel_s = self.memory[DECEL_TIME] / 10.0
        self.motor.ramp_base_hz = self.memory[MAXIMUM_HZ] * self.step_hz
        while dt > 0.0:
            piece = min(dt, self._until_event())
            self.motor.step(piece)
            self._passed(piece)
            dt -= piece

    def _until_event(self) -> float:
        left = self.dip_left_s if self.dip_left_s > 0.0 else float("inf")
        limit = self.memory[self.comm_loss.time] / 10.0
        if limit and self.silent_s is not None and self.silent_s < limit:
            left = min(left, limit - self.silent_s)
        return left

    def _passed(self, seconds: float) -> None:
        if self.dip_left_s > 0.0:
            self.dip_left_s -= seconds
            if self.dip_left_s <= 1e-9:
                self._mains_back()
        if self.silent_s is not None:
            limit = self.memory[self.comm_loss.time] / 10.0
            before, self.silent_s = self.silent_s, self.silent_s + seconds
            if limit and before < limit - 1e-9 <= self.silent_s:
                self.silent_s = max(self.silent_s, limit)
                self._host_lost()

    def _host_lost(self) -> None:
        """2.2.4 (3): no frame for F9.4: act as F9.3 says (E300, E550: F4.4, F4.3)."""
        if self.memory[COMMAND_CHANNEL] != FROM_BUS or not self.running:
            return
        action = self.memory[self.comm_loss.place]
        if action in self.comm_loss.trips:
            self.motor.trip_now(Trip.COMM_LOSS)
        elif action in self.comm_loss.stops:
            self.motor.stop()

    def power_dip(self, seconds: float) -> None:
        """The mains are gone for a moment. With F4.0 = 1 a running drive catches its motor afterwards (state 13H)."""
        self.motor.mains, self.dip_left_s = 0.0, seconds
        if self.running and self.memory[START_MODE] == SPEED_SEARCH:
            self.restarting = True
            self.motor.coast()

    def _mains_back(self) -> None:
        self.dip_left_s, self.motor.mains = 0.0, 1.0
        self.motor.step(1e-3)
        if self.restarting:
            self.restarting = False
            self.direct(self.reference_hz)

    def monitor(self, number: int) -> int:
        """d.n. Known: d.0, d.1, d.4, d.15, d.37 (and d.6 on the E series); d.2, d.3, d.5 are the sim's own."""
        motor = self.seen
        match number:
            case 0:
                return round(abs(motor.output_hz) / self.step_hz)
            case 1:
                return round(motor.current_a * 10) if self.current_at_1 else round(motor.voltage_v)
            case 2:
                return round(motor.voltage_v) if self.current_at_1 else round(motor.current_a * 10)
            case 3:
                return round(abs(motor.speed_rpm))
            case 4:
                return round(motor.bus_v)
            case 5:
                return round(motor.temperature_c)
            case 6:
                return round(self.reference_hz / self.step_hz)
            case 37:
                return self.fault_temperature_c
        return 0

    @property
    def fault_temperature_c(self) -> int:
        """d.37: the module's temperature at the last fault."""
        return round(self.motor.temperature_c) if self.motor.trip else 0

    # Operation.

    @property
    def obeys_bus(self) -> bool:
        return self.memory[COMMAND_CHANNEL] == FROM_BUS

    @property
    def reference_hz(self) -> float:
        """The set frequency: from the bus with F0.1 = 2, else the keypad's."""
        if self.memory[FREQUENCY_CHANNEL] == FROM_BUS:
            return self.setpoint_hz
        return self.memory[KEYPAD_HZ] * self.step_hz

    def operate(self, operation: Operation, data: int | None) -> Response:
        """Do what the operation field orders; ``data`` is a frequency in class 4 only."""
        if operation.sets_frequency and data is not None:
            if data > self.memory[MAXIMUM_HZ]:
                return Response.OUT_OF_RANGE
            if operation not in JOGS:
                self._set_frequency(data * self.step_hz)
        if not self.obeys_bus:
            return Response.OK
        if operation in STARTS and not self.emergency:
            self._start(STARTS[operation])
        elif operation in JOGS and not self.emergency:
            self._jog(JOGS[operation], data if operation.sets_frequency else None)
        elif operation in STOPS:
            self._stop(jog_only=operation in (Operation.JOG_STOP, Operation.JOG_STOP_AT))
        elif operation is Operation.EMERGENCY_STOP:
            self.emergency = True
            self.motor.coast()
        elif operation is Operation.RESET_FAULT:
            self.emergency = False
            self.motor.reset()
        return Response.OK

    def press_run(self, frequency_hz: float, reverse: bool = False) -> None:
        """Not while an emergency stop stands, as from the bus: the manual names no way to run in that state."""
        if not self.emergency:
            super().press_run(frequency_hz, reverse)

    def _set_frequency(self, frequency_hz: float) -> None:
        self.setpoint_hz = frequency_hz
        if self.running and not self.jogging and not self.motor.stopping:
            self.direct(self.reference_hz)

    def _start(self, direction: int) -> None:
        self.jogging, self.reverse = False, direction < 0
        self.direct(self.reference_hz)

    def _jog(self, direction: int, data: int | None) -> None:
        """A drive that runs does not jog."""
        if self.running and not self.jogging:
            return
        self.jogging = True
        raw = self.memory[JOG_HZ] if data is None else data
        self.motor.run(direction * raw * self.step_hz)

    def _stop(self, jog_only: bool) -> None:
        self.emergency = self.restarting = False
        if self.jogging or not jog_only:
            self.motor.stop()

    @property
    def state(self) -> State:
        """2.4.6."""
        motor = self.motor
        if motor.trip is not None:
            return State.FAULT
        if self.emergency:
            return State.EMERGENCY_STOP
        if self.restarting:
            return State.RESTARTING
        if not motor.ready:
            return State.NOT_READY
        if not motor.energised:
            return State.STOPPED
        return self._moving(motor)

    def _moving(self, motor: Motor) -> State:
        backward = motor.output_hz < 0.0 or (motor.output_hz == 0.0 and motor.target_hz < 0.0)
        phase = motor.phase
        if phase is Phase.DC_BRAKING:
            return State.DC_BRAKING
        if self.jogging and not motor.stopping:
            return State.JOGGING_REVERSE if backward else State.JOGGING_FORWARD
        if phase is Phase.ACCELERATING:
            return State.ACCELERATING_REVERSE if backward else State.ACCELERATING_FORWARD
        if phase is Phase.DECELERATING:
            return State.DECELERATING_REVERSE if backward else State.DECELERATING_FORWARD
        return State.RUNNING_REVERSE if backward else State.RUNNING_FORWARD

    def trip_code(self, trip: Trip) -> int:
        """The n of the keypad's Fu.n."""
        return FAULT_CODES[trip]
