# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether soundings went through a channel emulator: four taps on its grid in the place of all paths, and what that loses."""

from dataclasses import dataclass

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_power
from ...scenario.create.approximate import TAPS, best_shift_s, least_squares
from ...scenario.model import GRID_STEP_S
from .ears import ResponseEar
from .fit import Model

_SHARE = 0.9  # of what a twin leaves above noise that its taps must explain: no number of theirs is fitted to the soundings


@dataclass(frozen=True, eq=False)
class TappedEar(ResponseEar):
    """Responses through four taps per link and instant, as `create` chooses them, delays moved back to where they were."""

    band_hz: float = 1 / GRID_STEP_S

    def predicted(self, world) -> np.ndarray:
        links = range(len(self.predictor.links))
        return np.stack([self._through(world, index) * self.predictor.cables(world, index) for index in links])

    def _through(self, world, index: int) -> np.ndarray:
        table, f = self.predictor.path_table(world, index), self.predictor.frequency_hz
        out = np.zeros((table.many, len(f)), complex)
        for instant in range(table.many):
            rows = (table.instant == instant) & (table.gain != 0)
            delay_s = table.way.length_m[rows][None] / SPEED_OF_LIGHT_M_PER_S
            gain = table.gain[rows][None] * np.exp(-2j * np.pi * np.fmod(world.carrier_hz * delay_s, 1.0))
            if gain.size:
                shift_s = best_shift_s(delay_s, gain, self.band_hz)
                support, taps = least_squares(delay_s + shift_s, gain, self.band_hz)
                out[instant] = taps[0] @ np.exp(-2j * np.pi * np.outer(support * GRID_STEP_S - shift_s, f))
        return np.broadcast_to(out, (len(self.predictor.time_s), len(f)))


def tapped(ears, band_hz: float) -> tuple | None:
    """The same soundings as four taps would give their responses; None where taps stand for less than the band that was sounded,
    and where there are powers alone."""
    band_hz = min(band_hz, 1 / GRID_STEP_S)
    heard = [ear for ear in ears if ear.has_responses]
    if not heard or max(np.abs(ear.predictor.frequency_hz).max() for ear in heard) > band_hz / 2 * (1 + 1e-9):
        return None
    return tuple(TappedEar(ear.predictor, ear.heard, band_hz) if ear.has_responses else ear for ear in ears)


def explain(plain: Model, through: Model, count: float) -> bool:
    """Whether taps explain what a twin leaves."""
    return plain.energy - through.energy > _SHARE * (plain.energy - plain.offset - count)


def in_words(ears, base) -> str:
    """What taps lose of the links."""
    lost = {}
    for ear in (one for one in ears if one.has_responses):
        h, taps = ear.predictor.response(base), ear.predicted(base)
        share = (np.abs(h - taps) ** 2).sum(axis=(1, 2)) / np.maximum((np.abs(h) ** 2).sum(axis=(1, 2)), 1e-300)
        lost |= dict(zip([">".join(link) for link in ear.predictor.links], db_from_power(np.maximum(share, 1e-20)), strict=True))
    worst = max(lost, key=lost.get)
    middle = np.median([*lost.values()])
    return (
        f"The soundings are those of {TAPS} taps on a grid of {1e9 * GRID_STEP_S:g} ns, as a channel emulator plays them, in the"
        f" place of all paths: they lose {middle:.1f} dB of a link (median; worst {lost[worst]:.1f} dB, {worst})."
        " No cause in the place explains it, nor needs to."
    )
