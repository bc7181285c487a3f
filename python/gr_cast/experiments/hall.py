# SPDX-License-Identifier: GPL-3.0-or-later
"""A hall of four walls with a Wi-Fi link and a jammer in it, by image sources: direct path and one reflection per wall.

Free space over d metres has gain λ/(4πd) and phase −2πd/λ (Friis 1946); a wall adds a reflection from the mirrored source
(Allen and Berkley 1979).
"""

import numpy as np

from ..core.errors import CastError
from ..core.units import SPEED_OF_LIGHT_M_PER_S
from ..scenario import GRID_STEP_S, LinkTaps, Scenario
from ..scenario.create import approximate

CENTER_FREQUENCY_HZ = 2.437e9  # channel 6
BAND_HZ = 20e6
WALLS = {"north": (1, 22.0), "south": (1, -14.0), "east": (0, 40.0), "west": (0, -40.0)}  # axis, and metres along it
REFLECTION = -0.6  # of the field: concrete, near normal incidence
RECEIVER_M, TRANSMITTER_M, JAMMER_M = (0.0, 0.0), (8.0, 0.0), (-10.0, 4.0)
PASSING_M = 3.0  # nearest the walking jammer comes to the receiver
WALK_M_PER_S = 1.2
UPDATE_S = 0.01  # 1.2 cm of walk, a tenth of a wavelength
JAMMERS = ("static", "mobile")


def paths(source_m: np.ndarray, sink_m: np.ndarray, walls) -> tuple[np.ndarray, np.ndarray]:
    """Delays (T, 1 + walls) in s and complex gains of the paths from source_m (T, 2) to sink_m (2,)."""
    images = [source_m]
    for axis, place_m in walls:
        mirrored = source_m.copy()
        mirrored[:, axis] = 2 * place_m - source_m[:, axis]
        images.append(mirrored)
    distance_m = np.linalg.norm(np.stack(images, axis=1) - sink_m, axis=2)
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / CENTER_FREQUENCY_HZ
    reflection = np.array([1.0] + [REFLECTION] * len(walls))
    gain = reflection * wavelength_m / (4 * np.pi * distance_m) * np.exp(-2j * np.pi * distance_m / wavelength_m)
    return distance_m / SPEED_OF_LIGHT_M_PER_S, gain


def scenario(jammer: str, *, duration_s: float = 60.0, without=(), taps: int | None = None) -> Scenario:
    """The hall with nodes tx, rx and jammer, which stands, or walks past the receiver half way through.

    `without` names walls that are left out; `taps` approximates every link by so many taps on the 10 ns grid, as a twin on
    the hardware would. Raises CastError for names that are not there.
    """
    if jammer not in JAMMERS:
        raise CastError(f"jammer: got {jammer!r}, needs one of {', '.join(JAMMERS)}")
    unknown = [wall for wall in without if wall not in WALLS]
    if unknown:
        raise CastError(f"wall: got {', '.join(unknown)}, the hall has {', '.join(WALLS)}")
    walls = [wall for name, wall in WALLS.items() if name not in without]
    time_s = np.zeros(1) if jammer == "static" else np.arange(0, duration_s, UPDATE_S)
    walked_m = WALK_M_PER_S * (time_s - duration_s / 2)
    track_m = np.array([JAMMER_M]) if jammer == "static" else np.stack([walked_m, np.full(time_s.size, PASSING_M)], axis=1)
    links = {}
    for node, place_m in (("tx", np.array([TRANSMITTER_M])), ("jammer", track_m)):
        delay_s, gain = paths(place_m, np.array(RECEIVER_M), walls)
        if taps is not None:
            support, gain = approximate.least_squares(delay_s, gain, BAND_HZ, taps)
            delay_s = np.broadcast_to(support * GRID_STEP_S, gain.shape)
        links[(node, "rx")] = LinkTaps(delay_s=delay_s, gain=gain)
    return Scenario(
        name=f"hall, {jammer} jammer" + "".join(f", without the {wall} wall" for wall in without),
        nodes=("tx", "rx", "jammer"),
        links=links,
        time_s=time_s,
        center_frequency_hz=CENTER_FREQUENCY_HZ,
    )
