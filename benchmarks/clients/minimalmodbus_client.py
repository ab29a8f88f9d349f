"""minimalmodbus, the synchronous peer that keeps the 3.5-character gap."""

from __future__ import annotations

import minimalmodbus
from common import BAUD, PATH, REGISTERS, STATIONS, ClientMeter, is_wrong_reply

instruments = []
for address in range(1, STATIONS + 1):
    instrument = minimalmodbus.Instrument(PATH, address)
    instrument.serial.baudrate = BAUD
    instrument.serial.timeout = 0.1
    instruments.append(instrument)
meter = ClientMeter()
while not meter.is_over():
    station, register = 1 + meter.done % STATIONS, meter.done % 50
    try:
        values = instruments[station - 1].read_registers(register, REGISTERS)
        meter.wrong += is_wrong_reply(station, register, values)
    except (minimalmodbus.ModbusException, OSError):
        meter.failed += 1
    meter.done += 1
meter.report()
