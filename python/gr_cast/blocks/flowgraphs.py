# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounder's flowgraphs: over the embedded emulator, and with a radio at either end."""

from pathlib import Path

import numpy as np
from gnuradio import analog, blocks, gr

from ..core.units import amplitude_from_db
from ..emulation.reference import scenario_bulk_delay
from ..scenario import Scenario
from ..signals.waveform import Waveform
from .cast_python import glfsr_source
from .network import emulated_network, usable_band
from .radio_events import TransmitEvents
from .recorder import SigmfRecorder
from .transmission import Transmission
from .turned import Turned
from .usrp import RadioSettings, now_s, usrp_sink, usrp_source


def waveform_source(waveform: Waveform, spec: dict | None = None):
    """A block that sends the waveform: the GLFSR itself where the code is one, otherwise its samples."""
    if spec and spec.get("code") == "glfsr":
        return glfsr_source(spec["degree"], spec.get("mask", 0), spec.get("seed", 1), spec.get("samples_per_chip", 1))
    return blocks.vector_source_c(waveform.samples.tolist(), waveform.repeat)


class EmulatedSounding(gr.top_block):
    """One transmitter through the embedded emulator to recordings at some receivers, `n_samples` each.

    The recordings start after `settle_samples`, whole periods of the code, when every echo is there, and after the bulk delay of
    taps between samples, so that delays are the scenario's. Per receiver its own
    white noise of `noise_power_db` (per complex sample, re full scale) from `seed`, and a carrier
    offset of `offset_hz` where one is asked for. `stems` maps a receiver to its recording.
    """

    def __init__(
        self, scenario: Scenario, transmitter: str, stems: dict, source, *, sample_rate_hz: float, n_samples: int,
        settle_samples: int, noise_power_db: float, offset_hz: float = 0.0, seed: int = 1, fields: dict | None = None,
    ):  # fmt: skip
        super().__init__("EmulatedSounding", catch_exceptions=False)
        receivers = list(stems)
        emulator = emulated_network(scenario, [transmitter], receivers, sample_rate_hz)
        self.connect(source, emulator)
        late_samples = scenario_bulk_delay(scenario, sample_rate_hz)
        fields = (fields or {}) | usable_band(scenario, sample_rate_hz)
        place = {node: index for index, node in enumerate(scenario.nodes)}
        self.recorders, self._kept = [], []
        for port, receiver in enumerate(receivers):
            # Variance ampl² per complex sample in GNU Radio's Gaussian source.
            # A link's own, whoever else sends and listens: links that shared one noise would agree too well.
            own = np.random.SeedSequence([seed, place[transmitter], place[receiver]]).generate_state(1)[0]
            noise = analog.noise_source_c(analog.GR_GAUSSIAN, float(amplitude_from_db(noise_power_db)), int(own) >> 1)
            heard = blocks.add_cc()
            self.connect((emulator, port), (heard, 0))
            self.connect(noise, (heard, 1))
            if offset_hz:
                turned = Turned(offset_hz, sample_rate_hz)
                self._kept.append(turned)  # nobody else holds a block of Python
                self.connect(heard, turned)
                heard = turned
            # The stream ends here, not at its source: blocks that work in multiples of a few samples strand a tail.
            settled, cut = (
                blocks.skiphead(gr.sizeof_gr_complex, settle_samples + late_samples),
                blocks.head(gr.sizeof_gr_complex, n_samples),
            )
            self.connect(heard, settled, cut)
            self.recorders.append(
                SigmfRecorder(
                    self,
                    cut,
                    stems[receiver],
                    sample_rate_hz=sample_rate_hz,
                    center_frequency_hz=scenario.center_frequency_hz,
                    fields=fields | {"cast:transmitter": transmitter, "cast:receiver": receiver},
                )  # fmt: skip
            )

    @property
    def samples(self) -> int:
        return sum(recorder.samples for recorder in self.recorders)

    def finish(self) -> None:
        for recorder in self.recorders:
            recorder.finish()


class UsrpTransmitter(gr.top_block):
    """A waveform on an X310's transmit channel; `n_samples` None sends until stopped.

    With `restart_aligned` an underrun ends the burst and another begins in phase, a whole number of periods after the first.
    """

    def __init__(
        self,
        settings: RadioSettings,
        waveform: Waveform,
        *,
        amplitude: float = 0.5,
        n_samples: int | None = None,
        restart_aligned: bool = False,
    ):
        super().__init__("UsrpTransmitter", catch_exceptions=True)  # a radio that dies ends its thread, not the program
        self.radio = usrp_sink(settings)
        self.transmission = Transmission(
            np.asarray(waveform.samples, np.complex64) * np.float32(amplitude), repeat=waveform.repeat,
            sample_rate_hz=settings.sample_rate_hz, now_s=lambda: now_s(self.radio), start_at_s=settings.start_at_s,
            n_samples=n_samples,
        )  # fmt: skip
        self.connect(self.transmission, self.radio)
        self.events = TransmitEvents(self, self.radio, self._restart if restart_aligned else lambda kind: None)

    def _restart(self, kind: str) -> None:
        self.transmission.restart(is_late=kind == "late_packet")

    @property
    def samples(self) -> int:
        """How many went to the radio."""
        return self.transmission.nitems_written(0)


class UsrpReceiver(gr.top_block):
    """A recording of an X310's receive channel; `n_samples` None records until stopped."""

    def __init__(
        self,
        settings: RadioSettings,
        stem,
        *,
        n_samples: int | None = None,
        datatype: str = "cf32_le",
        fields: dict | None = None,
    ):
        super().__init__("UsrpReceiver", catch_exceptions=True)
        self.datatype = datatype
        self.radio = usrp_source(settings, "fc32" if datatype == "cf32_le" else "sc16")
        Path(stem).parent.mkdir(parents=True, exist_ok=True)  # a radio that is not there leaves no folder
        last = self.radio
        if n_samples is not None:
            last = blocks.head(8 if datatype == "cf32_le" else 4, n_samples)
            self.connect(self.radio, last)
        self.recorder = SigmfRecorder(
            self, last, stem, sample_rate_hz=settings.sample_rate_hz, center_frequency_hz=settings.center_frequency_hz,
            datatype=datatype, fields=fields,
        )  # fmt: skip

    @property
    def samples(self) -> int:
        return self.recorder.samples

    def finish(self, fields: dict | None = None) -> None:
        self.recorder.finish(fields)
