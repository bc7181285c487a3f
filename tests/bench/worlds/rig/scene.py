# SPDX-License-Identifier: GPL-3.0-or-later
"""A radio scene and what its receivers record: the parts act in the order in which a radio has them.

code → DAC clock → transmitter's I/Q, leakage, filter, amplifier, gain, oscillator → paths → others on the air → noise of the
first stage → receiver's oscillator, filter, gain → ADC clock → I/Q → offset → ADC.
All runs on a grid with a margin at both ends.
"""

from dataclasses import dataclass, field

import numpy as np

from . import numeric

MARGIN = 3000
TRANSMIT = ("tx_clock", "tx_iq", "tx_leak", "tx_filter", "pa", "tx_gain", "tx_lo")
RECEIVE = ("rx_lo", "rx_filter", "rx_gain", "rx_clock", "rx_iq", "rx_dc", "late", "adc_time", "adc_clip", "adc_step")


@dataclass(kw_only=True)
class Tap:
    """One path; `course` is a complex gain over the grid that replaces `gain` where a path changes; moving: its Doppler shift
    moves its delay too. The twin's own paths turn their phase alone, as the contract predicts them."""

    delay_s: float
    gain: complex
    doppler_hz: float = 0.0
    course: object = None
    moving: bool = True

    @staticmethod
    def of(entry):
        gain = 10 ** (entry["gain_db"] / 20) * np.exp(1j * entry["phase_rad"])
        return Tap(delay_s=entry["delay_s"], gain=gain, doppler_hz=entry["doppler_hz"], moving=False)


@dataclass(kw_only=True)
class Recording:
    name: str
    receiver: str
    transmitters: list
    gain: complex
    delay: float  # samples
    index: int
    amplitude: dict = field(default_factory=dict)


@dataclass(kw_only=True)
class Scene:
    rate: float
    carrier: float
    count: int  # samples of a recording
    waves: dict  # name → Wave
    transmitters: dict  # name → (wave's name, amplitude)
    receivers: list
    links: dict  # (tx, rx) → [tap entries as in twin.yaml]
    recordings: list
    noise: dict  # rx → noise power per complex sample
    link_unknown: dict = field(default_factory=dict)
    link_turn: dict = field(default_factory=dict)  # (tx, rx) → complex gain that the twin does not claim
    known: list = field(default_factory=list)  # causes that the twin lists
    twin_effects: list = field(default_factory=list)
    tell_noise: bool = True
    datatype: str = "cf32_le"
    seed: int = 0
    present: float = 1.0  # what is on the air of the twin's waveform: 0 where it is absent
    cache: dict = field(default_factory=dict)

    @property
    def duration(self):
        return self.count / self.rate

    @property
    def network(self):
        return len(self.links) > 1

    def wave(self, tx):
        return self.waves[self.transmitters[tx][0]]


class Context:
    """What a part may ask about the recording in which it acts."""

    def __init__(self, scene, recording, transmitter=None):
        self.scene, self.recording, self.transmitter = scene, recording, transmitter
        self.rate, self.carrier, self.count = scene.rate, scene.carrier, scene.count
        self.duration = scene.duration
        self.length = grid_length(scene, recording)
        self.time = (np.arange(self.length) - MARGIN) / scene.rate
        self.window = slice(MARGIN, MARGIN + scene.count)
        self.sigma2 = scene.noise[recording.receiver]
        self.clean = None  # what arrives, before noise
        self.shift_hz = 0.0  # of the receiver's oscillator, concealed or known
        self.stretch = 1.0  # what the receiver's clock makes of a frequency
        self.mirror = 1.0  # −1 where the receiver turns the spectrum about

    def meet(self, causes):
        """Frequencies are told as recorded; what the receiver does to them on the way is undone here."""
        for c in causes:
            if c.slot == "rx_lo" and c.family == "carrier_frequency_offset":
                self.shift_hz += c.signed
            if c.slot == "rx_clock" and c.family == "sample_clock_offset":
                self.stretch *= 1 + 1e-6 * c.sign * c.knob
            if c.family == "spectral_inversion":
                self.mirror = -self.mirror

    def arriving(self, recorded_hz):
        """The frequency at the antenna of what lies there in the recording."""
        return (self.mirror * recorded_hz - self.shift_hz) / self.stretch

    @property
    def wanted(self):
        """Mean wanted power in the recording, before any cause."""
        return float(np.mean(np.abs(baseline(self.scene, self.recording)[self.window]) ** 2))


def grid_length(scene, recording):
    """A whole number of periods, so that what repeats is repeated exactly."""
    need = scene.count + 2 * MARGIN
    waves = [scene.wave(tx) for tx in recording.transmitters]
    if all(w.repeat for w in waves):
        period = int(np.lcm.reduce([len(w.samples) for w in waves]))
        if period <= need // 2:
            return period * -(-need // period)
    return need + need % 2


def placed(wave, delay, length):
    """The waveform on the grid: periodic, or once among zeros."""
    if wave.repeat:
        x = numeric.delayed(wave.samples, delay % len(wave.samples))
        return x[(np.arange(length) - MARGIN) % len(x)]
    x = np.zeros(length, complex)
    start = MARGIN + int(np.floor(delay))
    x[start : start + len(wave.samples)] = wave.samples
    return numeric.delayed(x, delay % 1.0)


def through(x, taps, context):
    """The sum over the paths: those that stand still as one filter."""
    n, rate = len(x), context.rate
    f = np.fft.fftfreq(n, 1 / rate)
    still, out = np.zeros(n, complex), np.zeros(n, complex)
    for tap in taps:
        motion = abs(tap.doppler_hz) / context.carrier * context.duration * rate if context.carrier else 0.0
        if tap.doppler_hz == 0 and tap.course is None:
            still += tap.gain * np.exp(-2j * np.pi * f * tap.delay_s)
            continue
        if tap.moving and motion > 2e-4:
            y = numeric.at(x, np.arange(n) - tap.delay_s * rate + tap.doppler_hz / context.carrier * context.time * rate)
        else:
            y = numeric.delayed(x, tap.delay_s * rate)
        course = tap.gain if tap.course is None else tap.course
        out += y * course * np.exp(2j * np.pi * tap.doppler_hz * context.time)
    if n % 2 == 0:
        still[n // 2] = still[n // 2].real
    return out + numeric.filtered(x, still, rate) if still.any() else out


def concerned(cause, recording, tx=None):
    level, name = cause.level, cause.name
    if level == "tx":
        return name == tx if tx else name in recording.transmitters
    if level == "rx":
        return name == recording.receiver
    if level == "link":
        a, b = name.split(">")
        return b == recording.receiver and (a == tx if tx else a in recording.transmitters)
    return True


def simulate(scene, recording, causes=(), noise=True):
    """What the receiver records, on the grid."""
    every = list(scene.known) + list(causes)
    total = 0
    for tx in recording.transmitters:
        context = Context(scene, recording, tx)
        mine = [c for c in every if concerned(c, recording, tx)]
        context.meet([c for c in every if c.level == "rx" and concerned(c, recording)])
        _, amplitude = scene.transmitters[tx]
        amplitude = recording.amplitude.get(tx, amplitude)
        x = amplitude * placed(scene.wave(tx), recording.delay, context.length)
        for slot in TRANSMIT:
            for c in mine:
                if c.slot == slot:
                    x = c.act(x, context)
        taps = [Tap.of(e) for e in scene.links[(tx, recording.receiver)]]
        for c in mine:
            if c.slot == "paths":
                taps = c.act(taps, context)
        turn = scene.link_turn.get((tx, recording.receiver), 1.0)
        total = total + recording.gain * turn * through(x, taps, context)
    context = Context(scene, recording)
    mine = [c for c in every if concerned(c, recording)]
    y = total
    context.meet(mine)
    for c in mine:
        if c.slot == "air":
            y = c.act(y, context)
    rng = np.random.default_rng([scene.seed, recording.index, 77])
    early = [c for c in mine if c.slot == "rx_front"]
    for c in early:
        y = c.act(y, context)
    context.clean = y
    if noise:
        n = len(y)
        y = y + np.sqrt(context.sigma2 / 2) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
        for c in mine:
            if c.slot == "noise":
                y = c.act(y, context)
    for slot in RECEIVE:
        for c in mine:
            if c.slot == slot:
                y = c.act(y, context)
    return y


def baseline(scene, recording):
    """Without noise and causes: what a right twin predicts."""
    key = ("baseline", recording.name)
    if key not in scene.cache:
        scene.cache[key] = simulate(scene, recording, (), noise=False)
    return scene.cache[key]


def known_mask(scene, recording):
    """Recorded samples for which all that the model reaches of the waveform is known."""
    key = ("mask", recording.name)
    if key in scene.cache:
        return scene.cache[key]
    mask = np.ones(scene.count, bool)
    for tx in recording.transmitters:
        wave = scene.wave(tx)
        if wave.known is None:
            continue
        hidden = np.zeros(grid_length(scene, recording))
        bad = ~wave.known
        if wave.repeat:
            hidden = bad[(np.arange(len(hidden)) - MARGIN - int(round(recording.delay))) % len(bad)].astype(float)
        else:
            start = MARGIN + int(np.floor(recording.delay))
            hidden[start : start + len(bad)] = bad
        spread = np.zeros(len(hidden))
        for e in scene.links[(tx, recording.receiver)]:
            k = int(round(e["delay_s"] * scene.rate))
            moved = np.roll(hidden, k)
            steps = np.cumsum(np.concatenate([[0], moved]))
            reach = 24
            lo = np.clip(np.arange(len(hidden)) - reach, 0, len(hidden))
            hi = np.clip(np.arange(len(hidden)) + reach + 1, 0, len(hidden))
            spread += steps[hi] - steps[lo]
        mask &= spread[MARGIN : MARGIN + scene.count] == 0
    scene.cache[key] = mask
    return mask


def energy_left(scene, recording, cause):
    """λ of one cause in one recording: energy that gain, phase and delay leave of it, over the noise variance."""
    if not concerned(cause, recording):
        return 0.0
    context = Context(scene, recording)
    if cause.noise_like:
        return float(cause.nats(context))
    window, mask = context.window, known_mask(scene, recording)
    base = baseline(scene, recording)
    if cause.slot.startswith("adc"):
        with_it, without = simulate(scene, recording, [cause]), simulate(scene, recording, [])
        y = base + with_it - without
    else:
        y = simulate(scene, recording, [cause], noise=False)
    if len(recording.transmitters) > 1:
        left = several_left(scene, recording, y, window, mask)
    else:
        left = numeric.refit(y, base, window, mask)[0]
    return float(np.vdot(left, left).real / context.sigma2)


def several_left(scene, recording, y, window, mask):
    """The same where every transmitter has a gain and phase of its own."""
    columns = []
    for tx in recording.transmitters:
        alone = Recording(**{**recording.__dict__, "transmitters": [tx], "name": f"{recording.name}/{tx}"})
        columns.append(simulate(scene, alone, (), noise=False)[window][mask])
    a = np.array(columns).T
    whole = numeric.slope(baseline(scene, recording))[window][mask]
    a = np.column_stack([a, whole])
    target = y[window][mask]
    return target - a @ np.linalg.lstsq(a, target, rcond=None)[0]
