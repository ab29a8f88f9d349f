"""Motor model: exact ramps, balanced energy, and trips at their limits."""

from __future__ import annotations

import math

import pytest

from drivebus.simulator.motor import Motor, MotorLoad, Nameplate, OutputPhase, Trip


def motor(load: MotorLoad | None = None, accel_s: float = 5.0, decel_s: float = 5.0) -> Motor:
    made = Motor(load=load)
    made.accel_s, made.decel_s = accel_s, decel_s
    return made


@pytest.mark.parametrize("dt", [0.001, 0.0333, 0.25, 1.0, 5.0])
def test_a_ramp_takes_exactly_its_time_whatever_the_step(dt: float) -> None:
    m = motor()
    m.run(50.0)
    passed = 0.0
    while passed < 4.0 - 1e-9:
        m.step(min(dt, 4.0 - passed))
        passed += min(dt, 4.0 - passed)
    assert m.output_hz == pytest.approx(40.0, abs=1e-9)
    m.step(1.0)
    assert m.output_hz == pytest.approx(50.0, abs=1e-9)
    assert m.phase is OutputPhase.AT_SPEED


def test_a_ramp_is_counted_per_maximum_frequency() -> None:
    m = motor(accel_s=10.0)
    m.ramp_base_hz = 100.0
    m.run(50.0)
    m.step(5.0)
    assert m.output_hz == pytest.approx(50.0)


def test_a_reversal_brakes_with_the_deceleration_and_starts_with_the_acceleration_time() -> None:
    m = motor(accel_s=2.0, decel_s=4.0)
    m.run(50.0)
    m.step(2.0)
    m.run(-50.0)
    m.step(4.0)
    assert m.output_hz == pytest.approx(0.0, abs=1e-9)
    m.step(1.0)
    assert m.output_hz == pytest.approx(-25.0)
    assert m.speed_hz < 0


def test_a_stop_ramps_down_and_switches_off() -> None:
    m = motor()
    m.run(50.0)
    m.step(5.0)
    m.stop()
    m.step(4.9)
    assert m.energised and m.phase is OutputPhase.DECELERATING
    m.step(0.2)
    assert not m.energised
    assert (m.output_hz, m.current_a, m.power_kw, m.voltage_v) == (0.0, 0.0, 0.0, 0.0)


def test_dc_braking_follows_the_ramp_for_its_time() -> None:
    m = motor()
    m.dc_brake_s = 2.0
    m.run(50.0)
    m.step(5.0)
    m.stop()
    m.step(6.0)
    assert m.phase is OutputPhase.DC_BRAKING
    m.step(1.1)
    assert m.phase is OutputPhase.OFF


def test_rated_torque_takes_rated_current_and_rated_slip() -> None:
    m = motor(MotorLoad(constant=0.98))
    m.run(50.0)
    m.step(20.0)
    assert m.torque == pytest.approx(1.0)
    assert m.current_a == pytest.approx(m.rating.current_a)
    assert m.speed_hz == pytest.approx(50.0 - m.rating.slip_hz)
    assert m.speed_rpm == pytest.approx(1455.0)


def test_voltage_follows_frequency_up_to_the_rating() -> None:
    m = motor()
    m.ramp_base_hz = 100.0
    m.run(25.0)
    m.step(20.0)
    assert m.voltage_v == pytest.approx(380 * (0.03 + 0.97 * 0.5))
    m.run(80.0)
    m.step(20.0)
    assert m.voltage_v == 380.0


def test_a_fan_needs_torque_with_the_square_of_speed() -> None:
    m = motor(MotorLoad.fan(0.8))
    m.run(25.0)
    m.step(20.0)
    assert m.torque == pytest.approx(0.02 + 0.8 / 4)


@pytest.mark.parametrize("dt", [0.01, 0.5, 30.0])
def test_energy_from_the_mains_is_losses_load_work_and_kinetic_energy(dt: float) -> None:
    m = motor(MotorLoad(constant=0.48))
    m.run(50.0)
    for _ in range(round(30.0 / dt)):
        m.step(dt)
    power_w = m.rating.power_kw * 1e3
    kinetic_j = 0.5 * m.rating.inertia_s * power_w
    load_j = 0.5 * power_w * (2.5 + 25.0)  # the 5 s of the ramp count half
    own_j = 15.0 * 30.0
    assert m.energy_j == pytest.approx(m.loss_j + kinetic_j + load_j + own_j, rel=1e-3)
    assert m.energy_kwh == pytest.approx(m.energy_j / 3.6e6)


def test_small_and_large_steps_agree() -> None:
    fine, coarse = motor(MotorLoad.fan()), motor(MotorLoad.fan())
    for m, dt in ((fine, 0.005), (coarse, 7.0)):
        m.run(50.0)
        for _ in range(round(7.0 / dt)):
            m.step(dt)
    assert coarse.output_hz == pytest.approx(fine.output_hz)
    assert coarse.energy_j == pytest.approx(fine.energy_j, rel=0.01)
    assert coarse.temperature_c == pytest.approx(fine.temperature_c, abs=0.05)


def test_a_hard_deceleration_trips_on_over_voltage() -> None:
    m = motor(accel_s=2.0, decel_s=0.2)
    m.run(50.0)
    m.step(3.0)
    m.stop()
    m.step(0.2)
    assert m.trip is Trip.OVERVOLTAGE
    assert not m.energised
    assert 790.0 < m.bus_v < 860.0


def test_a_brake_resistor_takes_the_energy_of_the_same_deceleration() -> None:
    m = motor(accel_s=2.0, decel_s=0.2)
    m.brake_resistor_w = 5000.0
    m.run(50.0)
    m.step(3.0)
    m.stop()
    m.step(0.25)
    assert m.trip is None
    assert not m.energised
    assert m.brake_j > 0.0


def test_a_gentle_deceleration_does_not_raise_the_bus() -> None:
    m = motor(decel_s=10.0)
    m.run(50.0)
    m.step(6.0)
    nominal = m.bus_v
    m.stop()
    m.step(5.0)
    assert m.bus_v == pytest.approx(nominal, rel=0.01)


def test_a_lowered_hanging_load_drives_the_motor() -> None:
    lifting, lowering = motor(MotorLoad.hoist(0.6)), motor(MotorLoad.hoist(0.6))
    lowering.brake_resistor_w = 5000.0
    lifting.run(50.0)
    lowering.run(-50.0)
    lifting.step(10.0)
    lowering.step(10.0)
    assert lifting.power_kw > 1.0
    assert lowering.power_kw < -0.5
    assert lowering.bus_v > lifting.bus_v
    assert abs(lowering.speed_hz) > 50.0  # above synchronous: it brakes
    assert lowering.trip is None


def test_a_lowered_hanging_load_without_a_brake_resistor_trips_on_over_voltage() -> None:
    m = motor(MotorLoad.hoist(0.6))
    m.run(-50.0)
    m.step(10.0)
    assert m.trip is Trip.OVERVOLTAGE


def test_a_start_while_the_mains_are_too_high_trips_again_after_a_reset() -> None:
    m = motor()
    m.mains = 1.5
    for _ in range(2):
        m.run(50.0)
        m.step(0.5)
        assert m.trip is Trip.OVERVOLTAGE and not m.energised
        m.reset()


def test_overload_trips_after_sixty_seconds_at_one_and_a_half_times_rated_current() -> None:
    torque = math.sqrt((1.5**2 - 0.16) / 0.84)
    m = motor(MotorLoad(constant=torque - 0.02), accel_s=0.5)
    m.rating = Nameplate(inertia_s=0.01)
    m.run(50.0)
    m.step(0.5)
    m.step(58.9)
    assert m.trip is None
    m.step(1.7)
    assert m.trip is Trip.OVERLOAD


def test_a_drive_that_is_off_recovers_its_overload_reserve_also_where_it_is_no_warmer_than_the_room() -> None:
    m = motor(MotorLoad(constant=1.6), accel_s=0.5)
    m.rating = Nameplate(inertia_s=0.01)
    for _ in range(3):
        m.run(50.0)
        m.step(30.0)
        assert m.trip is None
        m.coast()
        m.ambient_c = m.temperature_c
        m.step(60.0)


def test_too_short_an_acceleration_trips_on_over_current() -> None:
    m = Motor(Nameplate(inertia_s=5.0), MotorLoad())
    m.accel_s = 0.5
    m.run(50.0)
    m.step(0.1)
    assert m.trip is Trip.OVERCURRENT_ACCELERATING


def test_a_tripped_drive_does_not_start_until_it_is_reset() -> None:
    m = motor()
    m.force_trip(Trip.EXTERNAL)
    m.run(50.0)
    m.step(1.0)
    assert m.output_hz == 0.0
    m.reset()
    m.run(50.0)
    m.step(1.0)
    assert m.output_hz == pytest.approx(10.0)
    assert m.starts == 1


def test_a_power_cut_trips_on_under_voltage_and_the_drive_is_not_ready() -> None:
    m = motor(MotorLoad(constant=0.5))
    m.run(50.0)
    m.step(6.0)
    m.mains = 0.0
    m.step(1.0)
    assert m.trip is Trip.UNDERVOLTAGE
    m.step(60.0)
    assert not m.ready
    m.mains = 1.0
    m.step(0.1)
    assert m.ready


@pytest.mark.parametrize(
    "load", [MotorLoad(0.3), MotorLoad.fan(0.8), MotorLoad.hoist(0.5)], ids=["constant", "fan", "hoist"]
)
def test_a_coasting_rotor_stops_at_the_same_time_in_one_step_or_many(load: MotorLoad) -> None:
    many, one = motor(load), motor(load)
    for m in (many, one):
        m.run(50.0)
        m.step(6.0)
        m.coast()
        assert m.output_hz == 0.0 and m.speed_hz > 40.0
    for _ in range(100):
        many.step(0.002)
    one.step(0.2)
    assert one.speed_hz == pytest.approx(many.speed_hz, abs=1e-6)
    one.step(60.0)
    assert one.speed_hz == 0.0


def test_a_start_finds_a_rotor_that_still_turns() -> None:
    m = motor(MotorLoad.fan())
    m.run(50.0)
    m.step(6.0)
    m.coast()
    m.step(0.05)
    turning = m.speed_hz
    m.run(50.0)
    assert m.output_hz == turning > 20.0
    assert m.trip is None


def test_a_held_ramp_keeps_its_frequency() -> None:
    m = motor()
    m.run(50.0)
    m.step(2.0)
    m.hold = True
    m.step(2.0)
    assert m.output_hz == pytest.approx(20.0)
    m.hold = False
    m.step(1.0)
    assert m.output_hz == pytest.approx(30.0)


def test_heat_rises_with_load_and_falls_at_rest() -> None:
    m = motor(MotorLoad(constant=0.98))
    m.run(50.0)
    m.step(1200.0)
    hot = m.temperature_c
    assert hot == pytest.approx(25.0 + 40.0, abs=2.0)
    m.stop()
    m.step(1200.0)
    assert m.temperature_c == pytest.approx(25.0, abs=2.0)


def test_a_hot_cabinet_trips_on_over_heat() -> None:
    m = motor(MotorLoad(constant=0.9))
    m.ambient_c = 60.0
    m.run(50.0)
    m.step(3600.0)
    assert m.trip is Trip.OVERHEAT


def test_the_same_commands_give_the_same_motor() -> None:
    def history() -> list[float]:
        m, values = motor(MotorLoad.fan()), []
        for n in range(200):
            if n == 3:
                m.run(40.0)
            if n == 120:
                m.stop()
            m.step(0.1)
            values += [m.output_hz, m.current_a, m.bus_v, m.temperature_c]
        return values

    assert history() == history()
