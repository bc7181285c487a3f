# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel emulator in NumPy: y_j[n] = Σ_i Σ_d h_ij[n, d] · x_i[n − d].

Slow, double precision, and written to be read: `gr_cast.blocks.channel_emulator` must equal it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gr_cast.errors import CastError


@dataclass(frozen=True, kw_only=True)
class LinkUpdate:
    """A change of the link from transmitter `tx` to receiver `rx`, in force from `at_sample` on.

    `taps[d]` is the complex gain at a delay of d samples; None leaves the taps as they are. With
    `ramp_samples` the taps move in a straight line and arrive that many samples later. `enabled` switches
    the link; None leaves it.
    """

    tx: int
    rx: int
    at_sample: int = 0
    taps: np.ndarray | None = None
    enabled: bool | None = None
    ramp_samples: int = 0

    def __post_init__(self):
        where = f"update of link {self.tx}>{self.rx}"
        if min(self.tx, self.rx, self.at_sample, self.ramp_samples) < 0:
            raise CastError(f"{where}: a node, sample or ramp below 0")
        if self.taps is not None:
            taps = np.asarray(self.taps, dtype=complex)
            if taps.ndim != 1 or not np.all(np.isfinite(taps)):
                raise CastError(f"{where}: taps: expected finite complex gains, one per delay")
            object.__setattr__(self, "taps", taps)


def link_taps(updates: Iterable[LinkUpdate], n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """One link's delays in samples, shape (P,), and its taps at every sample, (n_samples, P).

    `updates` are all of that link; those of one sample take force in the order given. Until the first the
    link is on, without a tap.
    """
    updates = sorted(updates, key=lambda update: update.at_sample)
    used = [np.flatnonzero(update.taps) for update in updates if update.taps is not None]
    delays = np.unique(np.concatenate(used)) if used else np.zeros(0, int)
    taps = np.zeros((n_samples, len(delays)), dtype=complex)
    enabled = np.ones(n_samples, dtype=bool)
    begin, length = 0, 0
    start = target = np.zeros(len(delays), dtype=complex)
    for update in updates:
        if update.enabled is not None:
            enabled[update.at_sample :] = update.enabled
        if update.taps is None or update.at_sample >= n_samples:
            continue
        done = min((update.at_sample - begin) / length, 1) if length else 1
        start = start + (target - start) * done  # an update in mid-ramp starts from there
        target = np.array([update.taps[d] if d < len(update.taps) else 0 for d in delays])
        begin, length = update.at_sample, update.ramp_samples
        progress = np.minimum((np.arange(begin, n_samples) - begin + (not length)) / max(length, 1), 1)
        taps[begin:] = start + (target - start) * progress[:, None]
    return delays, taps * enabled[:, None]


def emulate(inputs: np.ndarray, updates: Iterable[LinkUpdate], n_outputs: int) -> np.ndarray:
    """What every receiver gets: (transmitters, samples) complex in, (receivers, samples) complex out.

    Before the first sample the inputs are zero. Raises CastError where an update names an absent node.
    Source: y_j = Σ_i x_i * h_ij, "Colosseum as a Digital Twin", IEEE TMC 2024.
    """
    inputs = np.atleast_2d(np.asarray(inputs, dtype=complex))
    n_inputs, n_samples = inputs.shape
    outputs = np.zeros((n_outputs, n_samples), dtype=complex)
    links: dict[tuple[int, int], list[LinkUpdate]] = {}
    for update in updates:
        if update.tx >= n_inputs or update.rx >= n_outputs:
            raise CastError(
                f"update of link {update.tx}>{update.rx}: the network has "
                f"{n_inputs} transmitters and {n_outputs} receivers"
            )
        links.setdefault((update.tx, update.rx), []).append(update)
    for (tx, rx), changes in links.items():
        for delay, gain in zip(*map(np.transpose, link_taps(changes, n_samples)), strict=True):
            outputs[rx, delay:] += gain[delay:] * inputs[tx, : max(n_samples - delay, 0)]
    return outputs
