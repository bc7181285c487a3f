# SPDX-License-Identifier: GPL-3.0-or-later
"""Packet loss over SINR, one curve per kind of disturbance, and the modem alone in white noise beside them."""

from dataclasses import dataclass

import numpy as np

from .. import __version__
from ..core.units import amplitude_from_db, db_from_power
from ..scenario import LinkTaps, Scenario
from .jamming import BANDWIDTH_HZ, MARGIN, Jammer, Setting, frame_times_s, frames

SINR_DB = (-5.0, 0.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.5, 15.0, 20.0, 25.0, 30.0)
JAMMED_SNR_DB = 45.0  # far above every SINR: the jammer is what disturbs
CARRIER_HZ = 8 * 312.5e3  # of a carrier that bears data
FRAMES_PER_S = 100.0


@dataclass(frozen=True)
class Curve:
    """A kind of disturbance; `kind` of None is the modem alone, without the emulator."""

    name: str
    kind: str | None
    centre_hz: float = 0.0


ALONE, WHITE = Curve("modem alone, white noise", None), Curve("white noise", "none")
CURVES = (
    ALONE,
    WHITE,
    Curve("narrowband at 0 MHz", "narrowband"),
    Curve("narrowband at 2.5 MHz", "narrowband", CARRIER_HZ),
    Curve("wideband", "wideband"),
)


@dataclass(frozen=True, kw_only=True)
class Point:
    """One point of a curve: SINR set and measured (None: by the modem alone there is nothing to measure), frames lost of all."""

    curve: Curve
    set_db: float
    measured_db: float | None
    lost: int
    frames: int

    @property
    def loss(self) -> float:
        return self.lost / self.frames


def flat() -> Scenario:
    """One tap from each to rx: what a curve shows is the disturbance's and the modem's alone."""
    one = LinkTaps(delay_s=[[0.0]], gain=[[1e-3]])
    return Scenario(name="flat", nodes=("tx", "rx", "jammer"), links={("tx", "rx"): one, ("jammer", "rx"): one})


def point(curve: Curve, sinr_db: float, modem, frame_emulator, count: int, payload_bytes: int, seed: int) -> Point:
    """Send `count` frames at `sinr_db`; `frame_emulator` is the class `blocks.frames.FrameEmulator`."""
    if curve.kind is None:
        lost = _lost_alone(modem, sinr_db, count, payload_bytes, np.random.default_rng([seed, 1]))
        return Point(curve=curve, set_db=sinr_db, measured_db=None, lost=lost, frames=count)
    jammer = None if curve is WHITE else Jammer(bandwidth_hz=BANDWIDTH_HZ[curve.kind], centre_hz=curve.centre_hz)
    levels = (sinr_db, None) if jammer is None else (JAMMED_SNR_DB, sinr_db)
    s = Setting(scenario=flat(), jammer=jammer, snr_db=levels[0], sinr_db=levels[1], seed=seed)
    emulator = frame_emulator(s.scenario, s.transmitters, s.rx, modem.sample_rate_hz, s.noise_power, seed)
    times_s = frame_times_s(count / FRAMES_PER_S, FRAMES_PER_S, 0.0)
    found = list(frames(s, modem, emulator, times_s, payload_bytes))
    measured = sum(frame.wanted for frame in found) / sum(frame.disturbance for frame in found)
    lost = sum(not frame.delivered for frame in found)
    return Point(curve=curve, set_db=sinr_db, measured_db=float(db_from_power(measured)), lost=lost, frames=count)


def _lost_alone(modem, snr_db: float, count: int, payload_bytes: int, rng: np.random.Generator) -> int:
    lost = 0
    for _ in range(count):
        payload = rng.bytes(payload_bytes)
        sent = np.pad(modem.modulate(payload), MARGIN)
        noise = amplitude_from_db(-snr_db) / np.sqrt(2) * (rng.normal(size=sent.size) + 1j * rng.normal(size=sent.size))
        lost += not any(packet.payload == payload for packet in modem.demodulate(sent + noise))
    return lost


def document(modem: str, points: list[Point], complete: bool) -> dict:
    """The content of sweep.json."""
    rows = [
        {"curve": p.curve.name, "sinr_set_db": p.set_db, "sinr_measured_db": p.measured_db, "loss": p.loss, "frames": p.frames}
        for p in points
    ]
    errors = [abs(p.measured_db - p.set_db) for p in points if p.measured_db is not None]
    return {
        "cast_loss_sweep": 1,
        "software": f"gr-cast {__version__}",
        "modem": modem,
        "complete": complete,
        "largest_sinr_error_db": max(errors, default=None),
        "points": rows,
    }


def as_table(document: dict) -> str:
    """Loss per curve (rows) and SINR set (columns), for the screen."""
    columns = sorted({row["sinr_set_db"] for row in document["points"]})
    lines = [f"modem: {document['modem']}", f"{'packet loss at SINR (dB)':<26}" + "".join(f"{value:>7g}" for value in columns)]
    for name in dict.fromkeys(row["curve"] for row in document["points"]):
        loss = {row["sinr_set_db"]: row["loss"] for row in document["points"] if row["curve"] == name}
        lines.append(f"{name:<26}" + "".join(f"{loss[value]:>7.3f}" if value in loss else f"{'–':>7}" for value in columns))
    error = document["largest_sinr_error_db"]
    lines += [] if error is None else [f"measured SINR differs from the one set by {error:.2f} dB at most"]
    return "\n".join(lines)
