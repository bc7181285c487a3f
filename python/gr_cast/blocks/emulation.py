# SPDX-License-Identifier: GPL-3.0-or-later
"""A running emulator: ports, a scenario that plays, and what is asked of both while samples flow."""

import contextlib
import os
import sys
import threading
import time

import numpy as np
import pmt
from gnuradio import gr

from ..core.errors import CastError, Faults
from ..core.units import db_from_power, power_from_db
from ..emulation.gpu.scenario import planned, send_update
from ..emulation.reference import (
    FixedPoint,
    filter_length,
    fir_taps,
    noise_power_from_snr,
    scenario_bulk_delay,
    scenario_updates,
)
from ..scenario import Scenario
from .cast_python import channel_emulator
from .device_emulator import DeviceEmulator
from .devices import chosen
from .network import heard, set_noise, usable_band
from .ports import LEAD_S, Port, connect_sink, source_block, waveform_entry
from .radio_events import ReceiveEvents, TransmitEvents, summary
from .recorder import SigmfRecorder
from .running import STILL_S
from .transmission import Lead
from .usrp import RadioSettings, now_s, usrp_sink

_AHEAD_S = 2.0  # scenario time that is queued before its samples come
_LOOK_S = 0.02  # between looks at what is to be queued
_LEVELS = ("input_power", "input_peak_power", "output_power", "output_peak_power")
_STILL_S = 1.0  # without a sample, until somebody is said to be waited for


class Emulation(gr.top_block):
    """All nodes of a scenario on one channel emulator, joined to their ports; without one a node is silent, or unheard.

    `noise_power` is every receiver's, in units of the samples squared; with `snr_db` it becomes so far below the loudest
    transmitter, as measured over the first report (a second) in which one sends. `settings` maps (node, direction) of UHD
    ports to RadioSettings, `ends` maps the same to blocks that are joined in place of a port. `fields` go into the
    metadata of recordings. With `cycle` the scenario begins again whenever it ends. `device` is cpu, cuda
    (within `precision`), or auto: cuda, and the processor where there is none or when it fails. Raises CastError, all faults at
    once, where ports and scenario do not fit.
    """

    def __init__(
        self,
        scenario: Scenario,
        ports: list[Port],
        sample_rate_hz: float,
        *,
        noise_power: float = 0.0,
        snr_db: float | None = None,
        seed: int = 0,
        fixed_point: FixedPoint | None = None,
        settings: dict[tuple[str, str], RadioSettings] | None = None,
        n_threads: int = 0,
        ends: dict[tuple[str, str], gr.basic_block] | None = None,
        fields: dict | None = None,
        cycle: bool = False,
        device: str = "cpu",
        precision: str = "fp32",
    ):
        settings, ends = settings or {}, ends or {}
        super().__init__("Emulation", catch_exceptions=bool(settings))  # a radio that dies ends its thread, not the program
        self.nodes, self.sample_rate_hz = scenario.nodes, sample_rate_hz
        _check_ports(scenario, ports)
        self._ends = ends
        self.emulator = _emulator(scenario, sample_rate_hz, n_threads, seed, device, precision)
        self._snr_db = snr_db  # until it has been referred to what is sent
        self._set_noise_power(noise_power)
        if fixed_point:
            self.emulator.set_fixed_point(
                fixed_point.bits,
                fixed_point.tap_bits,
                fixed_point.input_full_scale,
                fixed_point.output_full_scale,
            )
        self._lock = threading.Lock()
        self._is_up = False
        self._cycle = cycle
        self._off: set[tuple[int, int]] = set()  # links that were switched off one by one
        self._on = True
        self._samples, self._moved_at = 0, time.monotonic()
        self._peers = []  # (port, block at it, index of its node)
        self._leads = []  # a block of Python's lives as long as somebody refers to it
        self._radios = {}  # name of a uhd port to what goes wrong there
        self._paces = {}  # the same to how many samples its radio has moved, and when it moved the last
        self._begins_s = max((s.start_at_s + s.lead_s for s in settings.values() if s.start_at_s), default=0.0)  # of UTC
        self.load(scenario)
        by_place = {(port.node, port.direction): port for port in ports}
        places = [(node, direction) for node in self.nodes for direction in ("tx", "rx")]
        joined = [by_place.get(place, Port(node=place[0], direction=place[1], kind="null")) for place in places]
        self._sent = {port.node: waveform_entry(port) for port in ports if port.direction == "tx" and port.kind != "null"}
        self._fields = {
            **(fields or {}),
            **usable_band(scenario, sample_rate_hz),
            "cast:noise_power_db": float(db_from_power(noise_power)) if noise_power else None,
            "cast:seed": seed,
        }
        joined.sort(key=lambda port: port.kind == "file")  # recordings last: a port that is refused leaves none behind
        for port in joined:
            self._join(port, self._ends.get((port.node, port.direction)), settings.get((port.node, port.direction)))

    def _join(self, port: Port, end: gr.basic_block | None, settings: RadioSettings | None) -> None:
        """Connect a node's transmitter or receiver to its port, or to the block `end` instead."""
        index = self.nodes.index(port.node)
        if port.direction == "tx":
            block = end or source_block(port, settings, self.sample_rate_hz)
            self.connect(block, (self.emulator, index))
        elif end:
            block = end
            self.connect((self.emulator, index), block)
        elif port.kind == "uhd":
            block = self._join_transmitter(index, settings)
        else:
            block = connect_sink(
                self, self.emulator, index, port, self.sample_rate_hz, self.scenario.center_frequency_hz,
                self._fields | heard(self.scenario, port.node, self._sent),
            )  # fmt: skip
        self._peers.append((port, block, index))
        if port.kind == "uhd" and not end:
            events = ReceiveEvents(self, block, self.sample_rate_hz) if port.direction == "tx" else TransmitEvents(self, block)
            self._radios[_told(port)] = events

    def _join_transmitter(self, index: int, settings: RadioSettings):
        """A radio that begins LEAD_S after its first sample came, so that its queue is full by then."""
        radio = usrp_sink(settings)
        if settings.start_at_s is not None:  # both ends have a time of their own
            self.connect((self.emulator, index), radio)
            return radio
        self._leads.append(Lead(lambda: now_s(radio), LEAD_S))
        self.connect((self.emulator, index), self._leads[-1], radio)
        return radio

    def start(self, *args) -> None:
        super().start(*args)
        self._is_up = True

    def load(self, scenario: Scenario, cycle: bool | None = None) -> None:
        """Play another scenario of the same nodes from the next sample on; `cycle` None: as before."""
        if scenario.nodes != self.nodes:
            raise CastError(f"{scenario.name}: nodes: got {', '.join(scenario.nodes)}, the ports are of {', '.join(self.nodes)}")
        with self._lock:
            self._cycle = self._cycle if cycle is None else cycle
            self.scenario = scenario
            self.emulator.set_horizon(0)  # nothing passes until its first taps are there
            self.emulator.clear()
            self._off.clear()
            self._begin = self.status()["samples"]
            self._queued_s = 0.0
            self._queue()

    def switch(self, on: bool) -> None:
        """Every link off, or on again but those that were switched off by themselves. The scenario plays on."""
        with self._lock:
            self._on = on
            for tx in range(len(self.nodes)):
                for rx in range(len(self.nodes)):
                    self.emulator.enable_link(tx, rx, on and (tx, rx) not in self._off)

    def set_link(self, tx: str, rx: str, *, taps: list[dict] | None = None, enabled: bool | None = None) -> None:
        """New taps, each `delay_s`, `gain_db` and `phase_rad`, until the scenario has others; or switch a link.

        Delays between samples become filters, which begin earlier than the delay: CastError where there is no room.
        """
        with self._lock:
            link = (self._node(tx), self._node(rx))
            if taps is not None:
                delay = np.array([tap["delay_s"] for tap in taps], float) * self.sample_rate_hz
                gain = np.array([10 ** (tap["gain_db"] / 20) * np.exp(1j * tap.get("phase_rad", 0)) for tap in taps])
                bulk = scenario_bulk_delay(self.scenario, self.sample_rate_hz)
                try:
                    self.emulator.set_taps(*link, fir_taps(delay, gain, bulk).tolist())
                except (ValueError, IndexError) as error:
                    raise CastError(f"link {tx}>{rx}: {error}") from None
            if enabled is not None:
                self._off.discard(link) if enabled else self._off.add(link)
                self.emulator.enable_link(*link, enabled and self._on)

    def set_noise(self, *, power_db: float | None = None, snr_db: float | None = None) -> None:
        """Every receiver's noise from the next sample on: its power, or how far it is below the loudest transmitter of the last
        report. CastError where none has sent anything then."""
        self._set_noise_power(float(power_from_db(power_db)) if snr_db is None else noise_power_from_snr(snr_db, self._loudest()))
        self._snr_db = None

    def _set_noise_power(self, power: float) -> None:
        self._noise_power = power
        set_noise(self.emulator, power)

    def _loudest(self) -> float:
        powers = [power for power in pmt.to_python(self.emulator.status())["input_power"] if 0 < power < np.inf]
        if not powers:
            raise CastError("noise: no transmitter has sent anything in the last second: there is nothing that an SNR refers to")
        return max(powers)

    def _refer_noise(self) -> None:
        if self._snr_db is not None:
            with contextlib.suppress(CastError):  # nobody sends yet
                self.set_noise(snr_db=self._snr_db)

    def status(self) -> dict:
        """The emulator's own status, whether links are on, the scenario's clock in s, and which peers hold all up.

        `power`: NODE:tx and NODE:rx of every port to `mean_db` and `peak_db` (dB re 1) over the last whole report of about a
        second; None is silence, or no sample yet.
        """
        status = pmt.to_python(self.emulator.status())
        levels = {key: status.pop(key) for key in _LEVELS}
        begin = getattr(self, "_begin", 0)
        waiting_for = self._waiting_for()
        return status | {
            "scenario": self.scenario.name,
            "waiting_for": waiting_for,
            "power": self._powers(levels),
            "noise_power_db": _db(self._noise_power),
            "not_finite": self._not_finite(),
            "radios": {name: events.counts for name, events in self._radios.items()},
            "real_time_factor": 0.0 if waiting_for else status["real_time_factor"],
            "on": self._on,
            "scenario_time_s": (status["samples"] - begin) / self.sample_rate_hz,
            "bulk_delay_samples": scenario_bulk_delay(self.scenario, self.sample_rate_hz),
            "sample_rate_hz": self.sample_rate_hz,
        }

    def _powers(self, levels: dict) -> dict[str, dict[str, float | None]]:
        """NODE:tx or NODE:rx of every port to its mean and peak."""
        powers = {}
        for port, _, index in self._peers:
            if port.kind != "null" or (port.node, port.direction) in self._ends:
                side = "input" if port.direction == "tx" else "output"
                mean, peak = (levels[f"{side}_{which}"][index] for which in ("power", "peak_power"))
                powers[f"{port.node}:{port.direction}"] = {"mean_db": _db(mean), "peak_db": _db(peak)}
        return powers

    def _not_finite(self) -> dict[str, int]:
        """NODE:rx=STEM to how many samples were NaN or infinite there: who hears the peer that sends them gets them."""
        recorders = [(port, block) for port, block, _ in self._peers if isinstance(block, SigmfRecorder)]
        return {_told(port): block.not_finite for port, block in recorders if block.not_finite}

    def _waiting_for(self) -> list[str]:
        """NODE:tx=ADDRESS of whom nothing comes, NODE:rx=ADDRESS of who takes nothing, once nothing has moved for a while."""
        if not self._is_up:  # GNU Radio makes the counts of its blocks while it starts: who reads one then may end the program
            return []
        return [_told(port) for port in self._held_up_by()] if self._still_s() >= _STILL_S else []

    def _still_s(self) -> float:
        """For how long no sample has passed."""
        samples = self.emulator.nitems_read(0)
        if samples != self._samples:
            self._samples, self._moved_at = samples, time.monotonic()
        return time.monotonic() - self._moved_at

    def _held_up_by(self) -> list[Port]:
        held_up = []
        for port, block, index in self._peers:
            if port.kind not in ("zmq", "pubsub", "uhd"):
                continue
            passed = self.emulator.nitems_read(index)
            brings_nothing = port.direction == "tx" and block.nitems_written(0) == passed
            takes_nothing = port.direction == "rx" and block.nitems_read(0) < passed
            if brings_nothing or takes_nothing:
                held_up.append(port)
        return held_up

    def _check_radios(self) -> None:
        """Raises CastError where a radio holds all up for too long: a peer may come and go, a radio has died."""
        now = time.monotonic()
        for port, block, _ in self._peers:
            if port.kind == "uhd":
                count = block.nitems_written(0) if port.direction == "tx" else block.nitems_read(0)
                before, moved_at = self._paces.get(_told(port), (-1, 0.0))
                self._paces[_told(port)] = (count, moved_at if count == before else now)
        silent = [_told(port) for port in self._held_up_by() if port.kind == "uhd"]
        still_s = max((now - max(self._paces[name][1], self._due) for name in silent), default=0.0)
        if still_s > STILL_S:
            count = self.emulator.nitems_read(0)
            raise CastError(f"radio: {', '.join(silent)}: {count} samples passed, then none for {still_s:.1f} s")

    def lost(self) -> list[str]:
        """A line for every radio that lost samples or came late."""
        told = ((name, summary(events.counts, events.events)) for name, events in self._radios.items())
        return [f"{name}: {words}" for name, words in told if words]

    def recorded_bytes(self) -> int:
        """How much recordings hold so far, all of which is read again where they are sealed."""
        return sum(8 * block.samples for _, block, _ in self._peers if isinstance(block, SigmfRecorder))

    def run_until(self, ended: threading.Event, report=None, report_s: float = 5.0) -> None:
        """Run until a finite source ends or `ended` is set; `report(status)` is called every `report_s`. Raises CastError where a
        radio stops delivering; what was recorded until then is sealed."""
        self.start()
        waiter = threading.Thread(target=self._wait, args=(ended,), daemon=True)
        waiter.start()
        due = report_s
        begin = self._moved_at = time.monotonic()
        self._due = begin + max(0.0, self._begins_s - time.time())  # before that no radio has to hurry
        try:
            while not ended.wait(_LOOK_S):
                with self._lock:
                    self._queue()
                self._refer_noise()
                self._check_radios()
                if report and time.monotonic() - begin >= due:
                    due += report_s
                    report(self.status())
        finally:
            self._finish(waiter)

    def _finish(self, waiter: threading.Thread) -> None:
        """Stop and seal recordings, which hold what the radios lost; a radio that does not stop is left behind."""
        self.stop()
        waiter.join(STILL_S if self._radios else None)
        lost = {name: events.events for name, events in self._radios.items() if events.events}
        for _, block, _ in self._peers:
            if isinstance(block, SigmfRecorder):
                block.finish({"cast:radio_events": lost} if lost else None)

    def _wait(self, ended: threading.Event) -> None:
        self.wait()
        ended.set()

    def _node(self, name: str) -> int:
        if name not in self.nodes:
            raise CastError(f"node: got {name!r}, the scenario has {', '.join(self.nodes)}")
        return self.nodes.index(name)

    def _queue(self) -> None:
        """Hand the emulator the updates that come soon: a long scenario is not queued whole, and nobody runs ahead of it."""
        ends_s = np.inf if self._cycle and not self.scenario.is_static else self.scenario.time_s[-1]
        if self._queued_s > ends_s:
            return
        until_s = self.status()["scenario_time_s"] + _AHEAD_S
        if until_s <= self._queued_s + _AHEAD_S / 2:
            return
        for update in scenario_updates(self.scenario, self.sample_rate_hz, self._queued_s, until_s, cycle=self._cycle):
            send_update(self.emulator, update, self._begin)
        self._queued_s = until_s
        is_whole = until_s > ends_s
        self.emulator.set_horizon(None if is_whole else self._begin + int(until_s * self.sample_rate_hz))


def _emulator(scenario: Scenario, sample_rate_hz: float, n_threads: int, seed: int, device: str, precision: str):
    """The block that computes the network. Raises DeviceFault where a card is asked for that is not there."""
    size = len(scenario.nodes), len(scenario.nodes), filter_length(sample_rate_hz), sample_rate_hz
    threads = n_threads or os.cpu_count()
    card = chosen(device, scenario, sample_rate_hz, precision, threads, lambda line: print(line, file=sys.stderr))
    if card == "cpu":
        return channel_emulator(*size, n_threads, scenario.name, seed)
    choice = planned(card, scenario, sample_rate_hz, precision)
    return DeviceEmulator(*size, scenario.name, seed, card, choice=choice, goes_on=device == "auto")


def _told(port: Port) -> str:
    return f"{port.node}:{port.direction}={'uhd:' * (port.kind == 'uhd')}{port.where}"


def _db(power: float) -> float | None:
    return float(db_from_power(power)) if 0 < power < np.inf else None


def _check_ports(scenario: Scenario, ports: list[Port]) -> None:
    faults = Faults(scenario.name)
    seen = set()
    for port in ports:
        place = port.name
        if port.node not in scenario.nodes:
            faults.add(place, f"no such node; the scenario has {', '.join(scenario.nodes)}")
        if (port.node, port.direction) in seen:
            faults.add(place, "given twice")
        seen.add((port.node, port.direction))
    faults.raise_if_any()
