# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator at chosen moments: stretches of a receiver's samples anywhere along a scenario, without those in between."""

import numpy as np

from ..core.errors import CastError
from ..emulation.reference import filter_length, scenario_bulk_delay, scenario_updates
from ..scenario import Scenario, link_name
from .cast_python import emulator_kernel


class FrameEmulator:
    """What `receiver` hears of `transmitters`, all superposed with its noise, and of the first of them alone without noise.

    Taps change at the scenario's own samples and the noise is that of the absolute sample number, so that a stretch is the
    same whichever others are computed. `past` samples before a stretch are inputs too. CastError where a link is missing.
    """

    def __init__(
        self, scenario: Scenario, transmitters: list[str], receiver: str, sample_rate_hz: float, noise_power: float, seed: int
    ):
        missing = [link_name((tx, receiver)) for tx in transmitters if (tx, receiver) not in scenario.links]
        if missing:
            raise CastError(f"{scenario.name}: no link {', '.join(missing)}")
        self._scenario, self._rate = scenario, sample_rate_hz
        self._input = {scenario.nodes.index(tx): index for index, tx in enumerate(transmitters)}
        self._receiver = scenario.nodes.index(receiver)
        n_taps = filter_length(sample_rate_hz)
        self.past = n_taps - 1
        self.bulk_delay = scenario_bulk_delay(scenario, sample_rate_hz)
        self._kernel = emulator_kernel(len(transmitters), 2, n_taps, seed=seed)
        self._kernel.set_noise_power(0, noise_power)
        self._end = 0
        self._schedule(0.0, min(0.5 / sample_rate_hz, scenario.time_s[-1] + 1))

    def _schedule(self, from_s: float, until_s: float) -> None:
        for update in scenario_updates(self._scenario, self._rate, from_s, until_s):
            if update.rx != self._receiver or update.tx not in self._input:
                continue
            source = self._input[update.tx]
            delays = np.flatnonzero(update.taps)
            for output in (0, 1) if source == 0 else (0,):
                gains, at = update.taps[delays], update.at_sample
                self._kernel.set_sparse_taps(source, output, delays, gains, at, update.ramp_samples)
                if update.base_loss_db is not None:
                    self._kernel.set_base_loss(source, output, update.base_loss_db, at)
        self._scheduled_s = until_s

    def receive(self, begin: int, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Received and wanted samples (n,) from sample `begin` on, of inputs (transmitters, past + n); begins must ascend."""
        if begin < self._end:
            raise CastError(f"stretch at sample {begin}: got one before the end {self._end} of the last")
        self._end = begin + inputs.shape[1] - self.past
        clock = self._scenario.time_s
        # Instants that nobody hears are passed over, but for the last one before the stretch.
        before_s = clock[max(np.searchsorted(clock, begin / self._rate, side="right") - 1, 0)]
        self._schedule(max(before_s, self._scheduled_s), self._end / self._rate)
        self._kernel.skip_to(begin)
        received, wanted = self._kernel.process(np.ascontiguousarray(inputs, np.complex64))
        return received, wanted
