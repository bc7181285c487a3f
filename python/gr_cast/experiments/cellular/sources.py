# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of 5 Mbit/s behind a scheduler that gives every terminal with something to send the same air time."""

import numpy as np

SEGMENT_BITS = 1448 * 8
ROUND_TRIP_S = 0.040  # without queueing: LTE's usual order
TCP_STEP_S = 0.010


def delivered_bps(demand_bps: np.ndarray, rate_bps: np.ndarray) -> np.ndarray:
    """Bits per s that terminals get, (n,), of what they ask for; `rate_bps` each would have alone.

    Equal air time; what one does not need goes to the others in equal parts (max-min fairness: Bertsekas & Gallager, 6.5.2).
    """
    got = np.zeros(len(demand_bps))
    share = np.zeros(len(demand_bps))
    reachable = (rate_bps > 0) & (demand_bps > 0)
    needed = np.where(reachable, demand_bps / np.where(rate_bps > 0, rate_bps, 1.0), 0.0)
    left, waiting = 1.0, [int(index) for index in np.flatnonzero(reachable)]
    for place, index in enumerate(sorted(waiting, key=lambda index: needed[index])):
        share[index] = min(needed[index], left / (len(waiting) - place))
        left -= share[index]
    got[reachable] = share[reachable] * rate_bps[reachable]
    return got


def udp(rate_bps: np.ndarray, offered_bps: float) -> np.ndarray:
    """Delivered bits per s, (T, n), of a constant stream to each of n terminals: what does not get through is lost."""
    return np.array([delivered_bps(np.full(len(rates), offered_bps), rates) for rates in rate_bps])


def tcp(
    rate_bps: np.ndarray, step_s: float, offered_bps: float, *, buffer_bits: float = 5e5, round_trip_s: float = ROUND_TRIP_S
) -> np.ndarray:
    """Delivered bits per s, (T, n), of TCP Reno (RFC 5681, as a fluid) fed at `offered_bps`; each row holds for `step_s`.

    A window grows by a segment per round trip (twice per round trip in slow start) while it limits; it halves when the
    buffer is full, at most once per round trip. What the window holds back waits, nothing is lost to the receiver.
    """
    terminals = rate_bps.shape[1]
    window = np.full(terminals, 10.0 * SEGMENT_BITS)  # RFC 6928
    threshold = np.full(terminals, np.inf)
    queue, waiting, calm_s = np.zeros(terminals), np.zeros(terminals), np.zeros(terminals)
    per_row = max(1, round(step_s / TCP_STEP_S))
    dt = step_s / per_row
    out = np.zeros_like(rate_bps)
    served = np.zeros(terminals)
    for row, rates in enumerate(rate_bps):
        for _ in range(per_row):
            round_trip = round_trip_s + queue / np.maximum(served, 0.1 * SEGMENT_BITS / round_trip_s)
            waiting += offered_bps * dt
            allowed = window * dt / round_trip
            sent = np.minimum(waiting, allowed)
            waiting -= sent
            queue += sent
            served = delivered_bps(queue / dt, rates)
            queue -= served * dt
            out[row] += served / per_row
            full = (queue > buffer_bits + 1) & (calm_s <= 0)  # a bit more, or rounding fills an empty buffer
            queue = np.minimum(queue, buffer_bits)
            limiting = (sent == allowed) & ~full & (served > 0)
            growth = np.where(window < threshold, window, SEGMENT_BITS) * dt / round_trip
            window = np.where(limiting, window + growth, window)
            threshold = np.where(full, np.maximum(window / 2, 2 * SEGMENT_BITS), threshold)
            window = np.where(full, threshold, window)
            calm_s = np.where(full, round_trip, calm_s - dt)
    return out
