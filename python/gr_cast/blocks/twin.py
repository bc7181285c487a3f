# SPDX-License-Identifier: GPL-3.0-or-later
"""A twin's receivers in a flowgraph: what the transmitters send comes in, what a receiver gets goes out."""

import threading

import numpy as np
from gnuradio import gr

from ..core.errors import CastError, Faults
from ..signals import on_air
from ..twin.document import Case, Observation, read_twin
from ..twin.playback import Conditions, Grid, Playback, Tape
from .finite import FiniteSamples
from .ports import Port, connect_sink, source_block, waveform_entry
from .recorder import SigmfRecorder

LIVE_GRID = Grid(block=1 << 14, end=1024, margin=1024)  # less delay than that of recordings
COURSE_S = 60.0  # of phase noise and fading, which then run backwards


class TwinReceiver(gr.basic_block):
    """One recording of a twin as a block: inputs are the transmitters `live`, in this order, the others send the twin's
    own waveforms; the output is what the receiver gets.

    Sample n of the output comes after sample n + `delay_samples` of the inputs; it is the same however the scheduler
    cuts the streams, and the same as `Playback` makes of the same waveforms on the same grid.
    """

    def __init__(self, case: Case, observation: Observation, live: tuple[str, ...] = (), conditions: Conditions | None = None):
        gr.basic_block.__init__(self, "twin_receiver", [np.complex64] * len(live), [np.complex64])
        conditions = conditions or Conditions()
        missing = [tx for tx in live if tx not in observation.on_air]
        if missing:
            raise CastError(f"{observation.name}: {', '.join(missing)}: not on the air, {', '.join(observation.on_air)} are")
        self.tapes = [Tape() for _ in live]
        self.finite = {tx: FiniteSamples() for tx in live}
        told = {**conditions.__dict__, "transmit": {**conditions.transmit, **dict(zip(live, self.tapes, strict=True))}}
        count = round(COURSE_S * case.sample_rate_hz)
        self.playback = Playback(case, observation, count, Conditions(**told), LIVE_GRID)
        self._next, self._left = 0, np.zeros(0, np.complex64)

    @property
    def delay_samples(self) -> int:
        return self.playback.needs(0)[1] - 1

    def forecast(self, noutput_items, ninputs):
        return [0 if len(self._left) or self._is_ready else 1] * ninputs  # what came in is played to the end

    @property
    def _is_ready(self) -> bool:
        last = self.playback.needs(self._next)[1]
        return all(tape.last >= last for tape in self.tapes)

    def general_work(self, input_items, output_items):
        if not (len(self._left) or self._is_ready):
            for i, (tape, finite) in enumerate(zip(self.tapes, self.finite.values(), strict=True)):
                tape.push(finite.of(input_items[i], self.nitems_read(i)))
                self.consume(i, len(input_items[i]))
        if not len(self._left) and self._is_ready:
            self._left = self.playback.block(self._next)
            self._next += 1
            for tape in self.tapes:
                tape.drop(self.playback.needs(self._next)[0])
        out = output_items[0]
        n = min(len(out), len(self._left))
        out[:n] = self._left[:n]
        self._left = self._left[n:]
        return n


def twin_receiver(twin: str, recording: str, live, noise: bool = True, seed: int = 0) -> TwinReceiver:
    """The TwinReceiver of a twin's file; `recording` "" is its first. Raises CastError."""
    case = read_twin(twin)
    observations = {o.name: o for o in case.observations}
    if recording and recording not in observations:
        raise CastError(f"{twin}: recording: got {recording!r}, the twin has {', '.join(observations)}")
    conditions = Conditions(noise_power_db=None if noise else -np.inf, seed=seed)
    return TwinReceiver(case, observations[recording] if recording else case.observations[0], tuple(live), conditions)


class TwinEmulation(gr.top_block):
    """A twin between ports: `tx` ports bring what a transmitter sends in place of its own waveform, `rx` ports take what
    a receiver gets in the first recording that it makes. Raises CastError, all faults at once."""

    def __init__(self, case: Case, ports: list[Port], conditions: Conditions):
        super().__init__("TwinEmulation", catch_exceptions=False)
        by_receiver = {o.receiver: o for o in reversed(case.observations)}
        faults, places = Faults("twin"), [(p.node, p.direction) for p in ports]
        for port in ports:
            known = by_receiver if port.direction == "rx" else case.transmitters
            place = port.name
            if port.node not in known:
                faults.add(place, f"the twin has {', '.join(known)}")
            if places.count((port.node, port.direction)) > 1:
                faults.add(place, "given twice")
            if port.kind == "uhd":
                faults.add(place, "uhd: radios need the low delay of a scenario; got a twin")
        if not any(p.direction == "rx" for p in ports):
            faults.add("ports", "none takes what a receiver gets, needs NODE:rx=KIND:WHERE")
        faults.raise_if_any()
        sources = {p.node: source_block(p, None, case.sample_rate_hz) for p in ports if p.direction == "tx"}
        sent = {p.node: waveform_entry(p) for p in ports if p.direction == "tx"}
        self._blocks = list(sources.values())
        for port in (p for p in ports if p.direction == "rx"):
            observation = by_receiver[port.node]
            live = tuple(tx for tx in sources if tx in observation.on_air)
            receiver = TwinReceiver(case, observation, live, conditions)
            for i, tx in enumerate(live):
                self.connect(sources[tx], (receiver, i))
            told = {tx: sent.get(tx, entry) for tx, entry in case.sent(observation).items()}
            fields = {"cast:receiver": port.node, **on_air.fields(told), "cast:seed": conditions.seed}
            carrier_hz = conditions.center_frequency_hz or observation.center_frequency_hz
            sink = connect_sink(self, receiver, 0, port, case.sample_rate_hz, carrier_hz, fields)
            self._blocks += [receiver, sink]

    @property
    def not_finite(self) -> dict[str, int]:
        """Transmitter to how many of its samples were NaN or infinite, and were taken as 0."""
        receivers = [block for block in self._blocks if isinstance(block, TwinReceiver)]
        return {tx: found.count for block in receivers for tx, found in block.finite.items() if found.count}

    def run_until(self, ended: threading.Event) -> None:
        """Run until every finite source has ended, or `ended` is set."""
        self.start()
        waiter = threading.Thread(target=lambda: (self.wait(), ended.set()), daemon=True)
        waiter.start()
        ended.wait()
        self.stop()
        waiter.join()
        for block in self._blocks:
            if isinstance(block, SigmfRecorder):
                block.finish()
