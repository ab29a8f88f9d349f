"""Latency timer of an FTDI adapter on Linux: how long it may hold received bytes back, 16 ms from the factory.

Source: Linux Documentation/ABI/testing/sysfs-bus-usb (``latency_timer`` of ftdi_sio), 1 to 255 ms.
"""

from __future__ import annotations

from pathlib import Path

USB_SERIAL_DEVICES = Path("/sys/bus/usb-serial/devices")
LOW_LATENCY_MS = 1


def latency_ms(device: str) -> int | None:
    """Return the latency timer of a device such as /dev/ttyUSB0 in milliseconds, None where its driver has none."""
    try:
        return int(_timer(device).read_text())
    except (OSError, ValueError):
        return None


def set_low_latency(device: str) -> bool:
    """Set the latency timer to 1 ms where this user may; return False if it is longer afterwards or not readable."""
    timer = _timer(device)
    try:
        if int(timer.read_text()) > LOW_LATENCY_MS:
            timer.write_text(str(LOW_LATENCY_MS))
        return int(timer.read_text()) <= LOW_LATENCY_MS
    except (OSError, ValueError):
        return not timer.exists()


def _timer(device: str) -> Path:
    return USB_SERIAL_DEVICES / Path(device).name / "latency_timer"
