"""Time of one step of 1,000 simulated motors, by operating state and step size."""

from __future__ import annotations

import json
import time
from statistics import median

from benchmarks.harness import Figures
from drivebus.simulator.motor import Motor, MotorLoad

MOTORS = 1000
ROUNDS = 5
OBSERVED_AT_S = {"accelerating": 2.0, "at speed": 20.0, "decelerating": 22.0, "off": 60.0}
"""Operating state to its second after a start at 0 s, with a stop at ``STOP_AT_S`` and ramps of 10 s."""
STOP_AT_S = 20.0
MOTOR_LOADS = (MotorLoad(), MotorLoad.fan(), MotorLoad.hoist())


def simulated_motors(at_s: float) -> list[Motor]:
    """Return the motors at that second, with three kinds of load."""
    made = [Motor(load=MOTOR_LOADS[n % len(MOTOR_LOADS)]) for n in range(MOTORS)]
    for motor in made:
        motor.brake_resistor_w = 5000.0
        motor.run(50.0)
        motor.step(min(at_s, STOP_AT_S))
        if at_s > STOP_AT_S:
            motor.stop()
            motor.step(at_s - STOP_AT_S)
    return made


def step_ms(at_s: float, dt: float) -> float:
    """Return the median milliseconds of one step of all motors."""
    times = []
    for _ in range(ROUNDS):
        made = simulated_motors(at_s)
        start = time.perf_counter()
        for motor in made:
            motor.step(dt)
        times.append(time.perf_counter() - start)
    return round(median(times) * 1e3, 2)


def run_motors() -> Figures:
    """Return milliseconds by operating state and step size."""
    return {state: {f"dt {dt} s": step_ms(at_s, dt) for dt in (0.01, 0.1)} for state, at_s in OBSERVED_AT_S.items()}


if __name__ == "__main__":
    print(json.dumps(run_motors(), indent=2))
