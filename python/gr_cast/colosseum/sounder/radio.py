# SPDX-License-Identifier: GPL-3.0-or-later
"""A node's radio by its device arguments: a USRP by UHD, or in a box a pair of ZeroMQ sockets that count samples in step."""

import threading
import time
from dataclasses import dataclass

import numpy as np

_CHUNK = 1 << 15  # samples of a message
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
    """Slots of whole seconds by the host's clock, from the next multiple of ten seconds on: all nodes are started together."""
    import uhd

    usrp = uhd.usrp.MultiUSRP(device_args)
    for source in ("clock", "time"):
        getattr(usrp, f"set_{source}_source")("external")
    slot_s = float(np.ceil(slots.count / slots.rate_hz + 4.0))
    begin = 10.0 * np.ceil((time.time() + 5.0) / 10.0)
    heard = {}
    for slot in range(slots.total):
        early_s = 0.0 if slot == slots.own else 2.0  # who listens begins in the middle
        if ended.wait(max(0.0, begin + slot * slot_s + early_s - time.time())):
            break
        if slot == slots.own:
            repeats = max(1, (1 << 20) // len(period))
            usrp.send_waveform(np.tile(period, repeats)[None], slot_s - 1.0, slots.carrier_hz, slots.rate_hz, [0], 0)
        else:
            heard[slot] = usrp.recv_num_samps(slots.count, slots.carrier_hz, slots.rate_hz, [0], 0)[0]
    return heard
