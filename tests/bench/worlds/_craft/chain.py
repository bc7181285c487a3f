# SPDX-License-Identifier: GPL-3.0-or-later
"""One link from the modulator to the converter, in the order in which radios do it:

samples, TX I/Q, LO leakage, TX filter, amplifier, TX oscillator, channel, what else is in the air, thermal noise, RX
oscillator, sideband, RX filter, RX gain, RX I/Q, DC, converter, and the computer that drops samples.

The transmitter works on a grid FINE times finer than the recording, and what lies outside the receiver's band is
removed before it is sampled, so nothing folds back.
"""

from dataclasses import dataclass, field

import numpy as np

from . import files
from .waves import Sheet, Wave

BEFORE, AFTER = 1024, 1400  # samples worked out before and after those recorded: filters ring, samples get lost


@dataclass(kw_only=True)
class Scene:
    rate_hz: float
    carrier_hz: float
    wave: Wave
    amplitude: float
    taps: list  # as in twin.yaml
    n: int
    delay: float  # samples
    gain: complex
    noise: float  # power per sample in the recording, as an ideal twin states it
    datatype: str
    tx: str = "tx1"
    rx: str = "rx1"
    stem: str = "recording"
    known: list = field(default_factory=list)  # causes that the twin lists
    second: Wave | None = None  # a waveform of the twin that is not on the air
    states_noise: bool = True
    sheets: dict = field(default_factory=dict)

    @property
    def duration_s(self):
        return self.n / self.rate_hz

    @property
    def grid(self):
        return np.arange(-BEFORE, self.n + AFTER)

    @property
    def white(self):
        """Thermal noise: the recording's less what the file's own steps add."""
        return max(self.noise - files.STEP[self.datatype] ** 2 / 6, 1e-300)

    @property
    def offset_hz(self):
        """A carrier offset that the twin knows, common to all taps."""
        known = sum(c.offset_hz for c in self.known if c.family == "carrier_frequency_offset")
        common = {t["doppler_hz"] for t in self.taps}
        return known + (common.pop() if len(common) == 1 else 0.0)

    def sheet(self, wave=None):
        wave = wave or self.wave
        if wave.name not in self.sheets:
            self.sheets[wave.name] = Sheet(wave)
        return self.sheets[wave.name]

    def rms(self):
        """Of the wanted signal as the twin predicts it."""
        if "rms" not in self.sheets:
            self.sheets["rms"] = float(np.sqrt(np.mean(np.abs(received(self, self.known)) ** 2)))
        return self.sheets["rms"]

    def air_rms(self):
        """What interference is drawn against: one level for all recordings of a receiver."""
        return self.sheets.get("air") or self.rms()


@dataclass
class Path:
    delay_s: float
    gain: complex
    doppler_hz: float = 0.0  # turns the phase, as the twin predicts it
    moving_hz: float = 0.0  # a real path's: turns the phase and moves the delay
    fading: object = None  # factor over the scene's grid
    tap: int | None = None  # index of the twin's tap


def _mine(causes, scene):
    """Those of the causes that this link's recording shows."""
    out = []
    for c in causes:
        place = {"tx": scene.tx, "rx": scene.rx, "link": f"{scene.tx}>{scene.rx}"}.get(c.level)
        if place is None or c.name in (None, place):
            out.append(c)
    return out


def _paths(scene, causes):
    out = [
        Path(t["delay_s"], 10 ** (t["gain_db"] / 20) * np.exp(1j * t["phase_rad"]), t["doppler_hz"], tap=k)
        for k, t in enumerate(scene.taps)
    ]
    for c in causes:
        out = c.paths(out, scene)
    return out


def _field(scene, sheet, paths, t, turning, clock_tx, leak, own_clock):
    """Sum over paths of what the antenna receives, at the instants t."""
    fs, total = scene.rate_hz, np.zeros(len(t), complex)
    for p in paths:
        moving = p.moving_hz / scene.carrier_hz * t
        still = clock_tx == 1.0 and not own_clock and np.max(np.abs(moving)) * fs < 1e-5
        if still:
            s = sheet.on_lattice(scene.grid, scene.delay + p.delay_s * fs)
        else:
            s = sheet.at((t - p.delay_s + moving) * fs * clock_tx - scene.delay)
        s = s + leak
        for c in turning:
            s = s * c.factor(t - p.delay_s, scene)
        if p.doppler_hz or p.moving_hz:
            s = s * np.exp(2j * np.pi * (p.doppler_hz + p.moving_hz) * t)
        if p.fading is not None:
            s = s * p.fading
        total += p.gain * s
    return total


def received(scene, causes, rng=None):
    """The recording's complex samples; without rng, free of noise."""
    causes = _mine(causes, scene)
    fs, n = scene.rate_hz, scene.grid
    clock_rx = 1 + sum(c.ppm for c in causes if c.family == "sample_clock_offset" and c.level == "rx") * 1e-6
    clock_tx = 1 + sum(c.ppm for c in causes if c.family == "sample_clock_offset" and c.level == "tx") * 1e-6
    t = n / fs * clock_rx
    sheet, leak = scene.sheet(), 0.0
    f = sheet.frequencies()
    for c in causes:  # causes come in the chain's order
        if c.stage == "tx_iq":
            sheet = sheet.changed(c.imbalanced(sheet.fine))
        elif c.stage == "tx_leak":
            if scene.wave.repeat:
                sheet = sheet.changed(sheet.fine + c.leak(scene))
            else:
                leak = c.leak(scene)  # before and after the burst too
        elif c.stage == "tx_filter" and c.level == "tx":
            sheet = sheet.filtered(c.response(f, scene))
        elif c.stage == "pa":
            sheet = sheet.changed(c.amplified(sheet.fine))
    offset = sum(c.offset_hz for c in causes if c.family == "carrier_frequency_offset") / fs
    offset = offset if abs(offset) > 0.01 else 0.0
    if offset or any(c.stage == "pa" for c in causes):  # the receiver's own band
        sheet = sheet.filtered(np.abs(f + offset) < 0.5)
    sheet = sheet.changed(sheet.fine * scene.amplitude)
    turning = [c for c in causes if c.stage in ("oscillator", "gain", "foreign_gain") and c.level == "tx"]
    total = _field(scene, sheet, _paths(scene, causes), t, turning, clock_tx, leak * scene.amplitude, clock_rx != 1.0)
    for c in causes:
        if c.stage == "tail":
            late = sheet.filtered(c.response(f, scene))
            total += _field(scene, late, [Path(0.0, 1.0)], t, turning, clock_tx, 0.0, clock_rx != 1.0)
        elif c.stage == "second":
            total += c.second(scene)
        elif c.stage == "foreign_channel":
            total = c.channel(total, sheet, scene)
    total = total * scene.gain
    receiver = [c for c in causes if c.stage == "oscillator" and c.level == "rx"]
    turned = np.ones(len(n), complex)
    for c in receiver:
        turned *= c.factor(t, scene)
    for c in causes:
        if c.stage == "air":
            total = total + c.air(total, scene, rng) * np.exp(-2j * np.pi * sum(r.known_turn for r in receiver) * t)
    if rng is not None:
        power = scene.white
        for c in causes:
            power *= c.floor
        total = total + np.sqrt(power / 2) * (rng.standard_normal(len(n)) + 1j * rng.standard_normal(len(n)))
    total = total * turned
    for c in causes:
        if c.stage == "inversion":
            total = total.conj()
    for c in causes:
        if c.stage == "tx_filter" and c.level == "rx":
            g = np.fft.fftfreq(len(n))
            h = c.response(g, scene)
            total = np.fft.ifft(np.fft.fft(total) * h / np.sqrt(np.mean(np.abs(h) ** 2)))
    for c in causes:
        if c.stage in ("gain", "foreign_gain") and c.level == "rx":
            total = total * c.factor(n / fs, scene)
    for c in causes:
        if c.stage == "rx_iq":
            total = c.imbalanced(total)
        elif c.stage == "dc":
            total = total + c.constant(n / fs, scene)
    for stage in ("clip", "steps"):
        for c in causes:
            if c.stage == stage:
                total = c.converted(total)
    index = np.arange(scene.n)
    for c in causes:
        if c.stage == "loss":
            index = c.moved(index)
    return total[index + BEFORE]


class Prediction:
    """What the twin predicts, and what is left of a recording after its gain, phase and delay are fitted."""

    def __init__(self, scene):
        self.scene = scene
        self.at = self.evaluated(0.0)
        self.slope = (self.evaluated(0.05) - self.evaluated(-0.05)) / 0.1

    def evaluated(self, later):
        scene = self.scene
        kept = scene.delay
        scene.delay = kept + later
        out = received(scene, scene.known)
        scene.delay = kept
        return out

    def around(self, later):
        return self.evaluated(later), (self.evaluated(later + 0.05) - self.evaluated(later - 0.05)) / 0.1

    def left(self, y):
        """Residual after the fit by the tangent; where the delay moves far, from the nearest whole sample, step by step."""
        p, d, moved = self.at, self.slope, 0.0
        for turn in range(12):
            c = np.vdot(p, y) / np.vdot(p, p).real
            if abs(c) == 0:
                return y
            basis = np.stack([p, 1j * p, c * d], 1)
            rows = np.concatenate([basis.real, basis.imag])
            solution, *_ = np.linalg.lstsq(rows.T @ rows, rows.T @ np.concatenate([y.real, y.imag]), rcond=1e-13)
            if abs(solution[2]) < 0.02:
                return y - basis @ solution
            if turn == 0 and abs(solution[2]) > 0.3:
                near = [abs(np.vdot(np.roll(self.at, k)[16:-16], y[16:-16])) for k in range(-12, 13)]
                moved = float(np.argmax(near) - 12)
            else:
                moved += float(np.clip(solution[2], -0.5, 0.5))
            p, d = self.around(moved)
        c = np.vdot(p, y) / np.vdot(p, p).real
        return y - c * p
