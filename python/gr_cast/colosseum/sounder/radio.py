# SPDX-License-Identifier: GPL-3.0-or-later
"""A node's radio by its device arguments: a USRP by UHD, or in a box a pair of ZeroMQ sockets that count samples in step."""

import threading
import time
from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError

_CHUNK = 1 << 15  # samples of a message
_EARLY_S = 2.0  # by which hosts' clocks and radios' beginnings may differ in a slot
_SETTLE_S = 5.0
_IDLE_S = 0.02  # between messages once all slots are over: the emulator goes on for who still needs it


@dataclass(frozen=True, kw_only=True)
class Slots:
    """Who sends when: `own` of `total` slots is this node's; of each, `guard` samples at either end are not recorded."""

    own: int
    total: int
    count: int
    guard: int
    rate_hz: float
    carrier_hz: float

    @property
    def length(self) -> int:
        return self.count + 2 * self.guard


def arguments(text: str) -> dict[str, str]:
    """Device arguments, `key=value,key=value`."""
    return dict(word.partition("=")[::2] for word in text.split(",") if word)


def exchange(device_args: str, slots: Slots, period: np.ndarray, ended: threading.Event) -> dict[int, np.ndarray]:
    """Send `period` again and again in the own slot, record the others: slot to samples. Ends early when `ended` is set."""
    found = arguments(device_args)
    if found.get("driver") == "zmq":
        return _in_step(found["tx_port"], found["rx_port"], slots, period, ended)
    return _by_clock(device_args, slots, period, ended)


def _in_step(tx: str, rx: str, slots: Slots, period: np.ndarray, ended: threading.Event) -> dict[int, np.ndarray]:
    """Sample k of all that is sent meets sample k of all that is heard. A thread goes on answering after the last slot."""
    import zmq

    heard = {slot: np.zeros(slots.count, np.complex64) for slot in range(slots.total) if slot != slots.own}
    done = threading.Event()

    def run() -> None:
        context = zmq.Context()
        reply, request = context.socket(zmq.REP), context.socket(zmq.REQ)
        reply.bind(tx)
        request.connect(rx)
        poller = zmq.Poller()
        for one in (reply, request):
            poller.register(one, zmq.POLLIN)
        request.send(b"\xff")
        sent = got = 0
        end = slots.total * slots.length
        while True:
            ready = dict(poller.poll(100))
            if reply in ready:
                reply.recv()
                if got >= end:
                    time.sleep(_IDLE_S)
                reply.send(_sent(slots, period, sent))
                sent += _CHUNK
            if request in ready:
                samples = np.frombuffer(request.recv(), np.complex64)
                _keep(slots, heard, got, samples)
                got += len(samples)
                request.send(b"\xff")
                if got >= end:
                    done.set()

    threading.Thread(target=run, daemon=True).start()
    while not done.wait(0.1) and not ended.is_set():
        pass
    return heard if done.is_set() else {}  # of slots that were cut off nothing is told


def _sent(slots: Slots, period: np.ndarray, begin: int) -> bytes:
    """The samples from `begin` on that this node sends: its code in its own slot, silence else."""
    index = np.arange(begin, begin + _CHUNK)
    samples = period[index % len(period)].astype(np.complex64)
    samples[index // slots.length != slots.own] = 0
    return samples.tobytes()


def _keep(slots: Slots, heard: dict[int, np.ndarray], begin: int, samples: np.ndarray) -> None:
    """Put what was heard from sample `begin` on into the records of its slots."""
    end = begin + len(samples)
    for slot in range(begin // slots.length, min((end - 1) // slots.length, slots.total - 1) + 1):
        first = slot * slots.length + slots.guard
        low, high = max(begin, first), min(end, first + slots.count)
        if slot in heard and low < high:
            heard[slot][low - first : high - first] = samples[low - begin : high - begin]


def _by_clock(device_args: str, slots: Slots, period: np.ndarray, ended: threading.Event) -> dict[int, np.ndarray]:
    """Slots of whole seconds by the host's clock. Which slot it is, the clock alone says: nodes that are started at different
    moments still agree. Every node goes through all slots twice, so that those less than one round apart hear each other."""
    usrp = _usrp(device_args, slots)
    slot_s = float(np.ceil(slots.count / slots.rate_hz + 2 * _EARLY_S))
    first = int(np.ceil((time.time() + _SETTLE_S) / slot_s))
    heard = {}
    for number in range(first, first + 2 * slots.total):
        slot = number % slots.total
        early_s = 0.0 if slot == slots.own else _EARLY_S  # who listens begins in the middle
        if ended.wait(max(0.0, number * slot_s + early_s - time.time())):
            break
        if slot == slots.own:
            repeats = max(1, (1 << 20) // len(period))
            waveform = np.tile(period, repeats)[None]
            _within(slot_s, usrp.send_waveform, waveform, slot_s - 1.0, slots.carrier_hz, slots.rate_hz, [0], 0)
        else:
            samples = _within(slot_s, usrp.recv_num_samps, slots.count, slots.carrier_hz, slots.rate_hz, [0], 0)[0]
            if slot not in heard or np.vdot(samples, samples).real > np.vdot(heard[slot], heard[slot]).real:
                heard[slot] = samples  # in the other round its node was not there
    return heard


def _usrp(device_args: str, slots: Slots):
    """The radio, on the clock and pulse that Colosseum shares. Raises CastError where it does otherwise than told."""
    import uhd

    try:
        usrp = uhd.usrp.MultiUSRP(device_args)
    except RuntimeError as error:
        raise CastError(f"device: got arguments {device_args!r}: {' '.join(str(error).split())}") from None
    for source in ("clock", "time"):
        getattr(usrp, f"set_{source}_source")("external")
    usrp.set_rx_rate(slots.rate_hz, 0)
    faults = []
    if abs(usrp.get_rx_rate(0) / slots.rate_hz - 1) > 1e-9:
        faults.append(f"rate: got {slots.rate_hz:g} Hz, {device_args} can do {usrp.get_rx_rate(0):g} Hz")
    if not usrp.get_mboard_sensor("ref_locked", 0).to_bool():
        faults.append(f"clock source: got 'external', {device_args} does not lock to it")
    if faults:
        raise CastError(*faults)
    return usrp


def _within(limit_s: float, call, *arguments):
    """What a call of UHD returns. Raises CastError where the radio takes or delivers nothing: UHD itself waits for ever."""
    told = []
    thread = threading.Thread(target=lambda: told.append(call(*arguments)), daemon=True)
    thread.start()
    thread.join(limit_s + _EARLY_S)
    if not told:
        raise CastError(f"radio: {call.__name__} has not ended in {limit_s + _EARLY_S:g} s: no samples pass")
    return told[0]
