# SPDX-License-Identifier: GPL-3.0-or-later
"""`channel_emulator` on a graphics card: host streams in, host streams out."""

import threading
import time

import numpy as np
import pmt
from gnuradio import gr

from ..core.errors import CastError
from ..emulation.gpu.arrays import ArrayOps
from ..emulation.gpu.device import open_device
from ..emulation.gpu.network import DeviceNetwork
from ..emulation.gpu.planner import Choice, Task, choose

_PER_CALL = 32768  # samples, where neighbours keep up
_WAIT_S = 0.02  # that the scheduler may be kept from seeing that the flowgraph stops
_REPORT_S = 1.0
_STREAM_TAGS = ("rx_time", "rx_rate", "rx_freq")  # of the common timeline, not of one transmitter
_UPDATE = {"tx", "rx", "taps", "delays", "gains", "enabled", "base_loss_db", "offset", "ramp"}


class DeviceEmulator(gr.sync_block):
    """A network of time-varying channels on `device` (cuda), sample for sample, with setters and status of `channel_emulator`.

    Without a `choice` of how it is computed the device is measured for `taps_per_link` that last `life_samples`. With `goes_on`
    a card that fails is done without: the same arithmetic goes on in NumPy, slowly, with the same samples. Messages on `taps`
    are dictionaries of `tx`, `rx` and what is to change. Raises DeviceFault where there is no such device.
    """

    def __init__(
        self,
        n_inputs: int,
        n_outputs: int,
        n_taps: int = 512,
        sample_rate_hz: float = 1.0,
        name: str = "",
        seed: int = 0,
        device: str = "cuda",
        *,
        precision: str = "fp32",
        taps_per_link: int = 4,
        life_samples: int = 100_000,
        choice: Choice | None = None,
        goes_on: bool = False,
    ):
        signatures = [[np.complex64] * n_inputs, [np.complex64] * n_outputs]
        gr.sync_block.__init__(self, "device_emulator", *signatures)
        ops = open_device(device)
        task = Task(
            n_inputs=n_inputs, n_outputs=n_outputs, n_taps=n_taps, taps_per_link=taps_per_link, life_samples=life_samples,
            precision=precision,
        )  # fmt: skip
        choice = choice or choose(ops, task)
        self._network = DeviceNetwork(ops, choice.form, seed, spare=self._spare if goes_on else None)
        self._rate_hz, self._scenario, self._refused = sample_rate_hz, name, 0
        self._free, self._horizon = threading.Condition(), np.inf
        self._levels = self._reported = self._no_levels()
        self._samples, self._reported_samples, self._reported_at, self._factor = 0, 0, time.monotonic(), 0.0
        self.set_history(max(n_taps, _PER_CALL))
        self.set_min_output_buffer(2 * _PER_CALL)
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self.message_port_register_out(pmt.intern("status"))
        self.message_port_register_in(pmt.intern("taps"))
        self.set_msg_handler(pmt.intern("taps"), self._take)

    def _spare(self, fault) -> ArrayOps:
        self.logger.warn(f"{fault}; going on in NumPy, slowly")
        return ArrayOps()

    # --- setters of channel_emulator
    def set_taps(self, tx, rx, taps, offset=None, ramp=0) -> None:
        """Taps of a link, one per delay, from sample `offset` on (None: the next)."""
        taps = np.asarray(taps, np.complex64)
        delays = np.flatnonzero(taps)
        self.set_sparse_taps(tx, rx, delays, taps[delays], offset, ramp)

    def set_sparse_taps(self, tx, rx, delays, gains, offset=None, ramp=0) -> None:
        """The same with the non-zero taps alone."""
        with self._free:
            self._network.set_sparse_taps(tx, rx, delays, gains, offset, ramp)

    def enable_link(self, tx, rx, enabled, offset=None) -> None:
        """Switch a link off or on again; it keeps its taps."""
        with self._free:
            self._network.enable_link(tx, rx, enabled, offset)

    def set_base_loss(self, tx, rx, base_loss_db, offset=None) -> None:
        """Loss of the link on top of its taps, in dB."""
        with self._free:
            self._network.set_base_loss(tx, rx, base_loss_db, offset)

    def set_noise_power(self, rx, power) -> None:
        """Mean power of a receiver's noise, in units of the samples squared."""
        with self._free:
            self._network.set_noise_power(rx, power)

    def set_fixed_point(self, bits, tap_bits=16, input_full_scale=1.0, output_full_scale=1.0) -> None:
        """Round samples and taps as a fixed-point machine does."""
        with self._free:
            self._network.set_fixed_point(bits, tap_bits, input_full_scale, output_full_scale)

    def set_horizon(self, offset) -> None:
        """No sample from this one on is made until a later horizon is set; None: no horizon."""
        with self._free:
            self._horizon = np.inf if offset is None else offset
            self._free.notify_all()

    def clear(self) -> None:
        """No link has taps from the next sample on, no update is pending."""
        with self._free:
            self._network.clear()

    def set_scenario_name(self, name: str) -> None:
        """What status calls the scenario."""
        self._scenario = name

    def plan(self) -> str:
        """How the network is computed, in words."""
        return self._network.plan()

    def status(self):
        """What the message port `status` says, now."""
        with self._free:
            return pmt.to_pmt(self._describe())

    def late_updates(self) -> int:
        """Updates that named a sample already out."""
        return self._network.links.late

    def refused_updates(self) -> int:
        """Malformed messages."""
        return self._refused

    def clipped_samples(self) -> int:
        """Samples that a fixed-point full scale cut off."""
        with self._free:
            return self._network.clipped_samples()

    def active_links(self) -> int:
        """Links that are on and have taps."""
        with self._free:
            return self._network.links.active[0]

    # --- the flow
    def start(self) -> bool:
        with self._free:
            self._network.links.seek(self.nitems_written(0))  # not where it was, if a flowgraph starts again
            self._samples = self._reported_samples = self._network.position
            self._reported_at = time.monotonic()
            self.logger.info(f"scenario '{self._scenario}': {self._network.plan()}")
        return True

    def stop(self) -> bool:
        with self._free:
            self._network.links.seek(0)  # a flowgraph that starts again counts from 0
        return True

    def work(self, input_items, output_items) -> int:
        begin = self.nitems_written(0)
        with self._free:
            if not self._free.wait_for(lambda: begin < self._horizon, _WAIT_S):
                return 0
            n = int(min(len(output_items[0]), self._horizon - begin))
            self._forward_tags(begin, begin + n)
            past = self._network.form.n_taps - 1
            at = self.history() - 1 - past
            x = np.stack([items[at : at + past + n] for items in input_items])
            y = self._network.process(x)
            for items, samples in zip(output_items, y, strict=True):
                items[:n] = samples
            self._samples = self._network.position
            self._measure(x[:, past:], y)
        return n

    def _forward_tags(self, begin: int, end: int) -> None:
        """Tags of the common timeline to every output, once; any other to the output of the same node."""
        n_inputs, n_outputs = self._network.form.n_inputs, self._network.form.n_outputs
        forwarded = set()
        for node in range(n_inputs):
            for tag in self.get_tags_in_range(node, begin, end):
                key = pmt.symbol_to_string(tag.key)
                outputs = [node] if node < n_outputs else []
                if key in _STREAM_TAGS:
                    outputs = [] if (tag.offset, key) in forwarded else range(n_outputs)
                    forwarded.add((tag.offset, key))
                for output in outputs:
                    self.add_item_tag(output, tag.offset, tag.key, tag.value)

    def _take(self, message) -> None:
        """An update from a message. Never raises: it runs inside the flow."""
        try:
            update = pmt.to_python(message)
            if not isinstance(update, dict) or set(update) - _UPDATE or not {"tx", "rx"} <= set(update):
                raise CastError(f"got {str(update)[:80]}, needs tx, rx and of {', '.join(sorted(_UPDATE))}")
            link, offset = (int(update["tx"]), int(update["rx"])), update.get("offset")
            if "taps" in update:
                self.set_taps(*link, update["taps"], offset, int(update.get("ramp", 0)))
            if "delays" in update:
                self.set_sparse_taps(*link, update["delays"], update.get("gains", ()), offset, int(update.get("ramp", 0)))
            if "enabled" in update:
                self.enable_link(*link, bool(update["enabled"]), offset)
            if "base_loss_db" in update:
                self.set_base_loss(*link, float(update["base_loss_db"]), offset)
        except (CastError, ValueError, TypeError) as error:
            self._refused += 1
            self.logger.error(f"update refused: {error}")

    # --- status
    def _no_levels(self):
        form = self._network.form
        return [np.zeros((2, form.n_inputs)), np.zeros((2, form.n_outputs))], 0

    def _measure(self, x, y) -> None:
        levels, n = self._levels
        for kept, samples in zip(levels, (x, y), strict=True):
            power = samples.real**2 + samples.imag**2
            kept[0] += power.sum(axis=1, dtype=float)
            kept[1] = np.maximum(kept[1], power.max(axis=1))
        self._levels = levels, n + x.shape[1]
        now = time.monotonic()
        if now - self._reported_at >= _REPORT_S:
            self._factor = (self._samples - self._reported_samples) / self._rate_hz / (now - self._reported_at)
            self._reported_at, self._reported_samples = now, self._samples
            self._reported, self._levels = self._levels, self._no_levels()
            self.message_port_pub(pmt.intern("status"), pmt.to_pmt(self._describe()))

    def _describe(self) -> dict:
        network, (levels, n) = self._network, self._reported
        links, taps = network.links.active
        described = {
            "scenario": self._scenario, "inputs": network.form.n_inputs, "outputs": network.form.n_outputs,
            "active_links": links, "active_taps": taps, "plan": network.plan(), "samples": self._samples,
            "real_time_factor": float(self._factor), "late_updates": network.links.late, "refused_updates": self._refused,
            "clipped_samples": network.clipped_samples(),
        }  # fmt: skip
        for side, (power, peak) in zip(("input", "output"), levels, strict=True):
            described |= {f"{side}_power": power / n if n else power * np.nan, f"{side}_peak_power": peak.copy()}
        return described
