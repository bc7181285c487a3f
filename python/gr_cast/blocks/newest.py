# SPDX-License-Identifier: GPL-3.0-or-later
"""The newest samples of a stream, for whoever looks at it, and what a live page shows of an emulator and of a receiver."""

import contextlib

import numpy as np
from gnuradio import blocks, gr

from ..core.errors import CastError
from ..core.figures import fixed
from ..core.units import db_from_amplitude
from ..report.live import Look, spectrum
from ..scenario import base_loss_db, link_name, taps_at
from ..signals.recording import Recording
from ..signals.waveform import Waveform
from ..sounding.sound import SoundingOptions, sound

_SEEN = 1 << 14  # samples of a port


class Newest(gr.sync_block):
    """Holds the last `count` samples that came."""

    def __init__(self, count: int):
        gr.sync_block.__init__(self, "newest", [np.complex64], None)
        self._count, self._samples = count, np.empty(0, np.complex64)

    @property
    def samples(self) -> np.ndarray:
        return self._samples

    def work(self, input_items, output_items):
        fresh = input_items[0][-self._count :]
        kept = self._samples[max(len(self._samples) - self._count + len(fresh), 0) :]
        self._samples = np.concatenate([kept, fresh])
        return len(input_items[0])


class EmulatorView:
    """Watches an emulation from before it starts; `look()` is what its live page shows."""

    def __init__(self, emulation):
        self._emulation = emulation
        self._heard = {}
        heard_first = [rx for _, rx in emulation.scenario.links]
        for node in dict.fromkeys([*heard_first, *emulation.nodes]):
            index = emulation.nodes.index(node)
            self._heard[f"{node}:rx"] = Newest(_SEEN)
            emulation.connect((emulation.emulator, index), self._heard[f"{node}:rx"])

    def look(self) -> Look:
        status, scenario = self._emulation.status(), self._emulation.scenario
        told = (
            "real_time_factor",
            "clipped_samples",
            "late_updates",
            "refused_updates",
            "active_links",
            "active_taps",
        )
        figures = {"scenario": status["scenario"], "links": "on" if status["on"] else "off"}
        figures |= {key.replace("_", " "): f"{status[key]:.6g}" for key in told}
        figures |= {"samples": f"{status['samples']:,}", "scenario time": f"{status['scenario_time_s']:.1f} s"}
        figures["waiting for"] = ", ".join(status["waiting_for"]) or "nobody"
        for name, power in status["power"].items():
            figures[name] = (
                "silent" if power["mean_db"] is None else f"{fixed(power['mean_db'], 1)} dB, peak {fixed(power['peak_db'], 1)} dB"
            )
        taps = {}
        for key in scenario.links:
            delay_s, gain = taps_at(scenario, key, np.array([max(status["scenario_time_s"], 0.0)]))
            on = np.abs(gain[0]) > 0
            taps[link_name(key)] = (delay_s[0][on], db_from_amplitude(np.abs(gain[0][on])) - base_loss_db(scenario, key))
        rate_hz = self._emulation.sample_rate_hz
        return Look(figures=figures, taps=taps, spectra={n: spectrum(b.samples, rate_hz) for n, b in self._heard.items()})


class ReceiverView:
    """Watches a receiver (`flowgraphs.UsrpReceiver`) and sounds its newest samples by `waveform`; `look()` as above."""

    def __init__(self, receiver, waveform: Waveform, sample_rate_hz: float):
        self._receiver, self._waveform, self._rate_hz = receiver, waveform, sample_rate_hz
        self._newest, last = Newest(max(_SEEN, 12 * len(waveform.samples))), receiver.radio
        if receiver.datatype != "cf32_le":
            last = blocks.interleaved_short_to_complex(True, False, 2.0**15)  # pairs in
            receiver.connect(receiver.radio, last)
        receiver.connect(last, self._newest)

    def look(self) -> Look:
        samples, found = self._newest.samples, None
        figures = {"samples": f"{self._receiver.samples:,}", "lost": f"{self._receiver.recorder.gaps.lost_samples:,}"}
        if len(samples) >= 8 * len(self._waveform.samples):
            power = np.abs(samples) ** 2
            figures |= {"power": _decibels(power.mean()), "peak": _decibels(power.max())}
            with contextlib.suppress(CastError):
                found = sound(Recording(samples=samples, sample_rate_hz=self._rate_hz), self._waveform, SoundingOptions())
        taps = (np.empty(0), np.empty(0))
        if found is not None and found.frames:
            period, power = len(self._waveform.samples), found.taps.power
            # What is newest begins anywhere in the code: delays are those after the strongest tap.
            after = found.taps.delay_samples - found.taps.delay_samples[np.argmax(power)]
            delay_s = ((after + period / 2) % period - period / 2) / self._rate_hz
            taps = delay_s, 10 * np.log10(np.maximum(power, 1e-20))
            figures["carrier offset"] = f"{fixed(found.offset.cycles_per_sample * self._rate_hz, 1)} Hz"
        return Look(figures=figures, taps={"newest samples": taps}, spectra={"rx": spectrum(samples, self._rate_hz)})


def _decibels(power: float) -> str:
    return f"{fixed(10 * np.log10(power), 1)} dB" if power > 0 else "silent"
