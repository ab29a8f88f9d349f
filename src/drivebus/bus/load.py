"""Estimate of the load of a bus by a set of polls, before they are started."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivebus.bus.messages import StationConfig
from drivebus.bus.prepared_request import Poll
from drivebus.serial_settings import SerialSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLoad:
    """Estimate for one drive, in seconds."""

    refresh_s: float
    """Mean time between two replies to its slowest poll, every station replying at its limit; a single reply may be a
    cycle later."""
    stop_bound_s: float
    """Longest time from the request of a stop to its last bit on the wire, whether the other stations reply or not.

    A device that sends without pause adds at most ``STOP_SILENCE_TIMEOUT_CHARACTERS``.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class BusLoad:
    """Estimate for a bus."""

    load_percent: float
    """Bus time that the polls need if every station replies at its limit; above 100 the periods stretch."""
    cycle_s: float
    """Time to send every poll once without a pause, every station replying at its limit."""
    drives: Mapping[int, DriveLoad]


def estimate_bus_load(polls: Sequence[tuple[StationConfig, Sequence[Poll]]], settings: SerialSettings) -> BusLoad:
    """Return load, refresh time and longest delay of a stop for a set of polls.

    A stop may also have to wait for what is not polled: sync probes, and ``StationConfig.longest_requests``.
    """
    costs = [
        (config, poll, _transaction_s(config, poll.request, settings))
        for config, station_polls in polls
        for poll in station_polls
    ]
    cycle_s = sum(cost_s for _, _, cost_s in costs)
    load = sum(cost_s / poll.period_s if poll.period_s > 0 else 1.0 for _, poll, cost_s in costs)
    stretch = max(1.0, load)
    requests = [(config, poll.request) for config, poll, _ in costs]
    for config, _ in polls:
        requests += [(config, request) for request in (config.sync_request(0), *config.longest_requests)]
    longest_s = max(
        (_transaction_s(config, request, settings) - config.timing.gap_s(settings) for config, request in requests),
        default=0,
    )
    drives = {}
    for config, station_polls in polls:
        drives[config.address] = DriveLoad(
            refresh_s=max(
                (max(poll.period_s * stretch, cycle_s if poll.period_s <= 0 else 0.0) for poll in station_polls),
                default=0.0,
            ),
            stop_bound_s=longest_s + config.timing.gap_s(settings) + settings.seconds(_stop_frame_bytes(config)),
        )
    return BusLoad(load_percent=100 * load, cycle_s=cycle_s, drives=drives)


def polls_per_s(
    polls: Sequence[tuple[StationConfig, Sequence[Poll]]], settings: SerialSettings, adapter_delay_s: float
) -> float:
    """Return the polls a second that the bus carries back to back, 0 without any.

    Every station replies at its limit, and the adapter delivers each reply ``adapter_delay_s`` late.
    """
    costs_s = [
        _transaction_s(config, poll.request, settings) - config.timing.adapter_latency_s + adapter_delay_s
        for config, station_polls in polls
        for poll in station_polls
    ]
    return len(costs_s) / sum(costs_s) if costs_s else 0.0


def _transaction_s(config: StationConfig, request: Any, settings: SerialSettings) -> float:
    """Return the time of gap, request, and the longest wait for its reply."""
    codec, timing = config.codec, config.timing
    request_s = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + request_s + timing.timeout_s(settings, codec.largest_reply(request))


def _stop_frame_bytes(config: StationConfig) -> int:
    """Return the length of the station's stop frame; without one, of its sync request."""
    return len(config.codec.encode_request(config.stop_request or config.sync_request(0)))
