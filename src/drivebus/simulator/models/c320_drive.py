"""What the pretend C320 does: runs, jogs, stops, counts the silence of its host, rides through power dips. Pure.

No frame is known here. Monitors d.2, d.3 and d.5 are the sim's own; chapter 4.3 of the manual is not published.
"""

from __future__ import annotations

from drivebus.protocols.sunfar import SunfarOperation, SunfarResponse, SunfarState
from drivebus.simulator.models.c320_tables import (
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
    CommLossSettings,
    parameter_specs,
)
from drivebus.simulator.motor import Motor, OutputPhase, Trip
from drivebus.simulator.station import Station

STARTS = {
    SunfarOperation.RUN_FORWARD: 1,
    SunfarOperation.RUN_REVERSE: -1,
    SunfarOperation.RUN_FORWARD_AT: 1,
    SunfarOperation.RUN_REVERSE_AT: -1,
}
JOGS = {
    SunfarOperation.JOG_FORWARD: 1,
    SunfarOperation.JOG_REVERSE: -1,
    SunfarOperation.JOG_FORWARD_AT: 1,
    SunfarOperation.JOG_REVERSE_AT: -1,
}
STOPS = frozenset(
    (SunfarOperation.STOP, SunfarOperation.STOP_AT, SunfarOperation.JOG_STOP, SunfarOperation.JOG_STOP_AT)
)


class C320Drive(Station):
    """The drive behind the protocol of ``C320Station``."""

    ramp_keys = (ACCEL_TIME, DECEL_TIME)

    def __init__(
        self,
        address: int,
        step_hz: float,
        current_at_1: bool,
        selector: int,
        comm_loss: CommLossSettings,
        motor: Motor | None,
    ) -> None:
        super().__init__(address, parameter_specs(step_hz, selector, comm_loss), motor)
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
            self._advance_timers(piece)
            dt -= piece

    def _until_event(self) -> float:
        left = self.dip_left_s if self.dip_left_s > 0.0 else float("inf")
        limit = self.memory[self.comm_loss.time] / 10.0
        if limit and self.silent_s is not None and self.silent_s < limit:
            left = min(left, limit - self.silent_s)
        return left

    def _advance_timers(self, seconds: float) -> None:
        if self.dip_left_s > 0.0:
            self.dip_left_s -= seconds
            if self.dip_left_s <= 1e-9:
                self._restore_mains()
        if self.silent_s is not None:
            limit = self.memory[self.comm_loss.time] / 10.0
            before, self.silent_s = self.silent_s, self.silent_s + seconds
            if limit and before < limit - 1e-9 <= self.silent_s:
                self.silent_s = max(self.silent_s, limit)
                self._on_comm_loss()

    def _on_comm_loss(self) -> None:
        """2.2.4 (3): no frame for F9.4: act as F9.3 says (E300, E550: F4.4, F4.3)."""
        if self.memory[COMMAND_CHANNEL] != FROM_BUS or not self.running:
            return
        action = self.memory[self.comm_loss.place]
        if action in self.comm_loss.trips:
            self.motor.force_trip(Trip.COMM_LOSS)
        elif action in self.comm_loss.stops:
            self.motor.stop()

    def power_dip(self, seconds: float) -> None:
        """The mains are gone for a moment. With F4.0 = 1 a running drive catches its motor afterwards (state 13H)."""
        self.motor.mains, self.dip_left_s = 0.0, seconds
        if self.running and self.memory[START_MODE] == SPEED_SEARCH:
            self.restarting = True
            self.motor.coast()

    def _restore_mains(self) -> None:
        self.dip_left_s, self.motor.mains = 0.0, 1.0
        self.motor.step(1e-3)
        if self.restarting:
            self.restarting = False
            self.run_towards(self.reference_hz)

    def monitor(self, number: int) -> int:
        """d.n. Known: d.0, d.1, d.4, d.15, d.37 (and d.6 on the E series); d.2, d.3, d.5 are the sim's own."""
        motor = self.displayed_motor
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

    def execute(self, operation: SunfarOperation, data: int | None) -> SunfarResponse:
        """Do what the operation field orders; ``data`` is a frequency in class 4 only."""
        if operation.sets_frequency and data is not None:
            if data > self.memory[MAXIMUM_HZ]:
                return SunfarResponse.OUT_OF_RANGE
            if operation not in JOGS:
                self._set_frequency(data * self.step_hz)
        if not self.obeys_bus:
            return SunfarResponse.OK
        if operation in STARTS and not self.emergency:
            self._start(STARTS[operation])
        elif operation in JOGS and not self.emergency:
            self._jog(JOGS[operation], data if operation.sets_frequency else None)
        elif operation in STOPS:
            self._stop(jog_only=operation in (SunfarOperation.JOG_STOP, SunfarOperation.JOG_STOP_AT))
        elif operation is SunfarOperation.EMERGENCY_STOP:
            self.emergency = True
            self.motor.coast()
        elif operation is SunfarOperation.RESET_FAULT:
            self.emergency = False
            self.motor.reset()
        return SunfarResponse.OK

    def keypad_run(self, frequency_hz: float, reverse: bool = False) -> None:
        """Not while an emergency stop stands, as from the bus: the manual names no way to run in that state."""
        if not self.emergency:
            super().keypad_run(frequency_hz, reverse)

    def _set_frequency(self, frequency_hz: float) -> None:
        self.setpoint_hz = frequency_hz
        if self.running and not self.jogging and not self.motor.stopping:
            self.run_towards(self.reference_hz)

    def _start(self, direction: int) -> None:
        self.jogging, self.reverse = False, direction < 0
        self.run_towards(self.reference_hz)

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
    def state(self) -> SunfarState:
        """2.4.6."""
        motor = self.motor
        if motor.trip is not None:
            return SunfarState.FAULT
        if self.emergency:
            return SunfarState.EMERGENCY_STOP
        if self.restarting:
            return SunfarState.RESTARTING
        if not motor.ready:
            return SunfarState.NOT_READY
        if not motor.energised:
            return SunfarState.STOPPED
        return self._moving_state(motor)

    def _moving_state(self, motor: Motor) -> SunfarState:
        backward = motor.output_hz < 0.0 or (motor.output_hz == 0.0 and motor.target_hz < 0.0)
        phase = motor.phase
        if phase is OutputPhase.DC_BRAKING:
            return SunfarState.DC_BRAKING
        if self.jogging and not motor.stopping:
            return SunfarState.JOGGING_REVERSE if backward else SunfarState.JOGGING_FORWARD
        if phase is OutputPhase.ACCELERATING:
            return SunfarState.ACCELERATING_REVERSE if backward else SunfarState.ACCELERATING_FORWARD
        if phase is OutputPhase.DECELERATING:
            return SunfarState.DECELERATING_REVERSE if backward else SunfarState.DECELERATING_FORWARD
        return SunfarState.RUNNING_REVERSE if backward else SunfarState.RUNNING_FORWARD

    def trip_code(self, trip: Trip) -> int:
        """The n of the keypad's Fu.n."""
        return FAULT_CODES[trip]
