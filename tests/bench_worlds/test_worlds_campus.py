# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the world `campus`: the twin, with the told truth put into the contract's formula, leaves the noise and nothing else.

The formulas are written a second time, at the sample rate, from the contract; what a truth tells no phase of is fitted.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

from worlds import build
from worlds.campus import cases, causes_transmitter, menu, scene, strength, waveforms

pytestmark = pytest.mark.timeout(120)
TURN = 2 * np.pi
# How far the residual may be from the noise where the formula is not exact: dense echoes, curves by a few terms, random courses.
LOOSE = {
    "front_end_filter": 0.05,
    "pa_nonlinearity": 0.05,
    "diffuse_tail": 0.05,
    "tap_fading": 0.05,
    "quantization": 0.1,
    "narrowband_interference": 0.15,
    "pulsed_interference": 0.25,
    "signal_dependent_noise": 0.2,
    "impulsive_noise": 0.25,
    "adc_clipping": 0.45,
}
RANDOM = ("phase_noise",)  # has no formula
NOISES = ("noise_floor", "signal_dependent_noise", "narrowband_interference", "pulsed_interference", "impulsive_noise")
KINDS = ("null", "absent", "single", "double", "triple", "network", "outside", "ambiguous")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(scene, "LENGTHS", (5000, 9000))


# ---------------------------------------------------------------- reading, by the contract alone
def read(folder, stem):
    """(samples, noise of the file's rounding)"""
    kind = json.loads((folder / f"{stem}.sigmf-meta").read_text())["global"]["core:datatype"]
    if kind == "cf32_le":
        return np.fromfile(folder / f"{stem}.sigmf-data", "<c8").astype(complex), 0.0
    number, scale = ("<i2", 32768) if kind == "ci16_le" else ("i1", 128)
    v = np.fromfile(folder / f"{stem}.sigmf-data", number).astype(float) / scale
    return v[::2] + 1j * v[1::2], 1 / 6 / scale**2


def register(entry):
    mask = {6: 0x21, 7: 0x41, 8: 0x8E, 9: 0x108, 10: 0x204}[entry["degree"]]
    r, out = entry["seed"], []
    for _ in range(2 ** entry["degree"] - 1):
        out.append(2.0 * (r & 1) - 1)
        r = (r >> 1) ^ (mask if r & 1 else 0)
    return np.repeat(out, entry["samples_per_chip"]).astype(complex)


def waveform(folder, entry):
    return (register(entry), True) if "code" in entry else (read(folder, entry["file"])[0], entry["repeat"])


class Sent:
    """A band-limited waveform at whole samples and any delay; `stretch`: time that runs fast or slow."""

    def __init__(self, x, repeat, n):
        size = len(x) if repeat else 1 << (n + len(x) + 3000).bit_length()
        self.x = np.concatenate([x, np.zeros(size - len(x))])
        self.line, self.f = np.fft.fft(self.x), np.fft.fftfreq(size)

    def at(self, n, delay, line=None, stretch=0.0):
        size = len(self.x)
        line = (self.line if line is None else line) * np.exp(-1j * TURN * self.f * delay)
        if stretch == 0:
            return np.fft.ifft(line)[n % size]
        v = finer(np.fft.ifft(line), 16)
        p = n * (1 + stretch) * 16
        i = np.floor(p).astype(int)
        u = p - i
        a, b, c, e = (v[(i + q) % len(v)] for q in (-1, 0, 1, 2))
        return b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - e + u * (3 * (b - c) + e - a)))


def finer(x, times):
    line, wide, half = np.fft.fft(x), np.zeros(len(x) * times, complex), (len(x) - 1) // 2
    wide[: half + 1], wide[-half:] = line[: half + 1], line[-half:]
    return np.fft.ifft(wide) * times


def coarser(v, times):
    n = len(v) // times
    line, out, half = np.fft.fft(v), np.zeros(n, complex), (n - 1) // 2
    out[: half + 1], out[-half:] = line[: half + 1], line[-half:]
    return np.fft.ifft(out) / times


class Case:
    """A recording of one link, read back; `columns` hold the contract's formula with the truth's effects, the wanted first."""

    def __init__(self, folder, truth, number=0):
        self.folder, self.truth, self.fit = folder, truth, truth["fit"][number]
        self.twin = yaml.safe_load((folder / "twin.yaml").read_text())
        entry = self.twin["recordings"][number]
        tx, name = entry["transmitters"][0], entry["file"]
        mine = (link for link in self.twin["links"] if (link["tx"], link["rx"]) == (tx, entry["receiver"]))
        self.rate, self.taps = self.twin["sample_rate_hz"], next(mine)["taps"]
        self.y, self.rounding = read(folder, name)
        node = self.twin["nodes"][tx]
        x, repeat = waveform(folder, self.twin["waveforms"][node["transmit"]])
        self.amplitude = node["amplitude"]
        x, self.n, self.delay = x * self.amplitude, np.arange(len(self.y)), self.fit["delay_samples"]
        self.keep = np.ones(len(self.y), bool)
        self.hidden = bool(np.isnan(x.real).any())
        if self.hidden:  # what the twin does not know is silent, and so is all that it reaches
            hidden = np.zeros(len(self.y) + len(x) + 2000)
            hidden[int(self.delay) : int(self.delay) + len(x)] = np.isnan(x.real)
            reach = int(max(t["delay_s"] for t in self.taps) * self.rate) + 260
            self.keep = ~(np.roll(np.convolve(hidden, np.ones(reach))[: len(hidden)], -30)[: len(self.y)] > 0.5)
            x = np.where(np.isnan(x.real), 0, x)
        self.repeat, self.sent = repeat, Sent(x, repeat, len(self.y))
        self.effects = {e["family"]: e for e in truth["effects"] if name in e["recordings"]}
        self.noise = 10 ** (self.fit["snr_db"] / -10)  # re the wanted power, which the fit's gain gives
        self.offset = sum(e["parameters"]["offset_hz"]["value"] for e in self.twin["effects"])

    def value(self, family, name):
        p = self.effects[family]["parameters"] if family in self.effects else {}
        return p[name]["value"] if name in p else None

    def through(self, line=None, extra=0.0, only=None, stretch=0.0):
        """Over the twin's paths, with the truth's errors of taps."""
        t, out = self.n / self.rate, np.zeros(len(self.y), complex)
        for tap in self.taps if only is None else [only]:
            d, doppler, motion = tap["delay_s"], tap["doppler_hz"], 0.0
            gain = 10 ** (tap["gain_db"] / 20) * np.exp(1j * tap["phase_rad"])
            for family in ("missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler"):
                place = self.value(family, "delay_s")
                if place is None or abs(place - tap["delay_s"]) > 1e-12:
                    continue
                if family == "missing_path":
                    gain = 0
                elif family == "tap_gain_error":
                    error = self.value(family, "error_db") / 20, self.value(family, "error_rad")
                    gain = gain * 10 ** error[0] * np.exp(1j * error[1])
                elif family == "tap_delay_error":
                    d += self.value(family, "error_s")
                else:
                    doppler += self.value(family, "doppler_hz")
                    motion = self.value(family, "doppler_hz") / self.twin["center_frequency_hz"]
            x = self.sent.at(self.n, d * self.rate + self.delay + extra, line, stretch + motion)
            out += gain * np.exp(1j * TURN * doppler * t) * x
        return out

    def columns(self):
        """-> ([wanted, derivative, …], {family: first column of its own})"""
        whole, own, v = len(self.y) / self.rate, {}, self.value
        if "sample_loss" in self.effects:  # all that the receiver hears jumps
            joint = round(v("sample_loss", "time_s") * self.rate)
            self.n = np.where(self.n < joint, self.n, self.n + int(v("sample_loss", "samples")))
        t = self.n / self.rate
        stretch = 1e-6 * (v("sample_clock_offset", "offset_ppm") or 0.0)
        turn = np.exp(1j * TURN * self.offset * t)
        if "carrier_frequency_offset" in self.effects:
            f, drift = v("carrier_frequency_offset", "offset_hz"), v("carrier_frequency_offset", "drift_hz_per_s") or 0.0
            self.turn = np.exp(1j * TURN * (f * t + 0.5 * drift * t**2))
            turn = turn * self.turn
        if "gain_step" in self.effects:
            when, step = v("gain_step", "time_s"), v("gain_step", "step_db")
            turn = turn * 10 ** (step / 20 * (t >= when - 1e-9 / self.rate))
        if "gain_drift" in self.effects:
            tau = v("gain_drift", "time_constant_s")
            course = t / whole if tau is None else np.expm1(-t / tau) / math.expm1(-whole / tau)
            turn = turn * 10 ** (v("gain_drift", "total_db") * course / 20)
        base = self.through(stretch=stretch) * turn
        slope = self.through(self.sent.line * 1j * TURN * self.sent.f) * turn
        out = [base, slope]
        for family in self.effects:
            own[family] = len(out)
            out += self.more(family, base, turn, t, stretch)
        if "spectral_inversion" in self.effects:
            out = [np.conj(c) for c in out]
        return out, own

    def more(self, family, base, turn, t, stretch):
        """Columns of an effect whose phase the truth does not tell."""
        v, rate, e = self.value, self.rate, self.effects[family]
        if family == "power_supply_hum":
            w = TURN * v(family, "frequency_hz") * t
            return [base * course(k * w) for k in (1, 2, 3) for course in (np.cos, np.sin)]
        if family == "front_end_filter":
            return [self.through(extra=k) * turn for k in range(-26, 27) if k]
        if family == "pa_nonlinearity":
            u = finer(self.sent.x, 4)
            r = np.abs(u) / np.abs(u).max()
            lines = {k: np.fft.fft(coarser(u * r**k, 4)) for k in (2, 4, 6, 8)}
            return [self.through(line, q) * turn for k, line in lines.items() for q in ((0, 1, 2) if k == 2 else (0,))]
        if family == "iq_imbalance":
            image = self.through(np.fft.fft(np.conj(self.sent.x))) * turn
            return [image if e["owner"]["level"] == "tx" else np.conj(base)]
        if family == "lo_leakage":
            level = [10 ** (p["gain_db"] / 20) * np.exp(1j * p["phase_rad"] + 1j * TURN * p["doppler_hz"] * t) for p in self.taps]
            return [sum(level) * turn]
        if family == "dc_offset":
            decay = v(family, "decay_s")
            return [np.exp(-t / decay) if decay else np.ones(len(t))]
        if family == "extra_path":
            doppler = v(family, "doppler_hz")
            moving = stretch + doppler / self.twin["center_frequency_hz"]
            x = self.sent.at(self.n, v(family, "delay_s") * rate + self.delay, None, moving)
            return [np.exp(1j * TURN * doppler * t) * x * turn]
        if family == "diffuse_tail":
            a, b = e["where"]["delay_s"]
            late = np.arange(a * rate - 1, (a + 2.1 * (b - a)) * rate + 2, 0.6)
            return [self.sent.at(self.n, q + self.delay) * turn for q in late]
        if family == "tap_fading":
            tap = min(self.taps, key=lambda p: abs(p["delay_s"] - v(family, "delay_s")))
            cycles = np.arange(-v(family, "doppler_spread_hz") * t[-1] - 3, v(family, "doppler_spread_hz") * t[-1] + 3.1, 0.5)
            c = self.through(only=tap) * turn
            return [c * np.exp(1j * TURN * q * t / t[-1]) for q in cycles]
        if family == "second_transmitter":
            x, repeat = waveform(self.folder, self.twin["waveforms"][e["values"]["code"]])
            x = Sent(x, repeat, len(self.y)).at(self.n, v(family, "delay_s") * rate + self.delay)
            mine = self.effects.get("carrier_frequency_offset", {"owner": {"level": "tx"}})["owner"]["level"] == "rx"
            return [x * np.exp(1j * TURN * self.offset * t) * (self.turn if mine else 1)]
        if family == "tone_interference":
            return [np.exp(1j * TURN * v(family, "frequency_hz") * t)]
        return []

    def expected(self, wanted):
        """Noise that the truth leaves, for this power of the wanted signal."""
        s, v = self.noise * wanted, self.value
        out = s + self.rounding
        for family in self.effects:
            if family in ("narrowband_interference", "pulsed_interference"):
                out += wanted * 10 ** (v(family, "power_dbc") / 10) * (v(family, "duty_cycle") or 1.0)
            elif family == "impulsive_noise":
                energy = self.effects[family]["parameters"]["power_db"]["also"][0]
                out += 10 ** (energy / 10) * v(family, "rate_hz") / self.rate
            elif family == "noise_floor":
                out += s * (10 ** (v(family, "change_db") / 10) - 1)
            elif family == "signal_dependent_noise":
                out += s * 10 ** (v(family, "slope_db") / 10)
            elif family == "quantization":
                out += v(family, "step") ** 2 / 6
        return out

    def solved(self):
        """(residual power over the expected noise, factors of the columns, {family: column}, power of the wanted signal)"""
        columns, own = self.columns()
        if "adc_clipping" in self.effects:
            level = 0.999 * self.value("adc_clipping", "level")
            self.keep &= (np.abs(self.y.real) < level) & (np.abs(self.y.imag) < level)
        if "sample_loss" in self.effects:
            joint = round(self.value("sample_loss", "time_s") * self.rate)
            self.keep[joint - 1 : joint + 1] = False
        a, y = np.stack(columns, 1)[self.keep], self.y[self.keep]
        size = np.sqrt(np.mean(np.abs(a) ** 2, 0)) + 1e-30
        gram = (a / size).conj().T @ (a / size) + 1e-9 * len(a) * np.eye(a.shape[1])
        c = np.linalg.solve(gram, (a / size).conj().T @ y) / size
        left = float(np.mean(np.abs(y - a @ c) ** 2)) * len(y) / max(1, len(y) - a.shape[1])
        if self.hidden and "noise" in self.twin:
            wanted = (10 ** (self.twin["noise"]["rx1"]["power_db"] / 10) - self.rounding) / self.noise
        elif self.hidden:  # data that the twin does not know are on the air too
            wanted = float(np.mean(np.abs(self.y) ** 2)) / (1 + self.noise)
        else:
            wanted = self.fit["gain"] ** 2 * float(np.mean(np.abs(self.plain()) ** 2))
        return left / self.expected(wanted), c, own, wanted

    def plain(self):
        """The twin's own prediction at gain 1, where all is known."""
        effects, self.effects, n, self.n = self.effects, {}, self.n, np.arange(len(self.y))
        out = self.through()
        self.effects, self.n = effects, n
        return out


def drawn(tmp_path, families, seed=0, kind="single", accept=lambda truth: True):
    for again in range(20):
        folder = tmp_path / f"{kind}{again}"
        truth = cases.draw(np.random.default_rng([sum(map(len, families)), seed, again]), kind, folder, families)
        if accept(truth):
            return Case(folder, truth)
    raise AssertionError("no such case")


def wholly_known(truth):
    return truth["conditions"]["waveform"] != "ofdm_pilots"


# ---------------------------------------------------------------- laws of single causes
@pytest.mark.parametrize("family", [f for f in menu.FAMILIES if f not in RANDOM])
def test_the_told_truth_leaves_the_noise(family, tmp_path):
    case = drawn(tmp_path, [family], accept=wholly_known)
    ratio, c, own, wanted = case.solved()
    loose = LOOSE.get(family, 0.01) + 5 / math.sqrt(case.keep.sum())
    assert 1 - loose < ratio < 1 + loose
    effect, got, level = case.effects[family], c[own[family] :], None
    if family == "power_supply_hum":
        assert np.hypot(*(got[:2] / c[0]).real) == pytest.approx(case.value(family, "depth"), rel=0.1, abs=0.003)
    elif family == "iq_imbalance":
        level, told = 20 * np.log10(abs(c[0] / got[0])), case.value(family, "image_rejection_db")
    elif family == "lo_leakage":
        told = case.value(family, "level_dbc")
        level = 20 * np.log10(abs(got[0] / c[0])) - 10 * np.log10(np.mean(np.abs(case.sent.x[: len(case.sent.x)]) ** 2))
        level = level if case.repeat else told
    elif family in ("dc_offset", "tone_interference"):
        told = case.value(family, "level_dbc" if family == "dc_offset" else "power_dbc")
        level = 20 * np.log10(abs(got[0])) - 10 * np.log10(wanted)
    elif family in ("extra_path", "second_transmitter"):
        level, told = 20 * np.log10(abs(got[0] / c[0])), case.value(family, "gain_db")
    if level is not None:
        assert abs(level - told) < 8.7 * 4 / math.sqrt(2 * effect["lambda"]) + 0.1


def test_a_filters_mean_delay_is_the_links_and_not_the_filters():
    f, late = np.linspace(-1e5, 1e5, 9), 37e-6
    shape = lambda f: 1 / (1 + 1j * f / 4e5)  # noqa: E731
    once, again = (
        causes_transmitter.centred(shape, 1e5),
        causes_transmitter.centred(lambda f: shape(f) * np.exp(-1j * TURN * late * f), 1e5),
    )
    assert np.allclose(once(f), again(f)) and np.allclose(np.abs(once(f)), np.abs(shape(f)))
    assert abs(np.polyfit(f, np.angle(once(f)), 1)[0]) < 0.02 * abs(np.polyfit(f, np.angle(shape(f)), 1)[0])


@pytest.mark.parametrize("family", ["pa_nonlinearity", "front_end_filter", "diffuse_tail", "extra_path", "tap_gain_error"])
def test_lambda_of_a_signal_is_its_energy_over_the_noise(family, tmp_path):
    case = drawn(tmp_path, [family], 3, accept=wholly_known)
    share = 10 ** ((case.fit["twin_nmse_db"] - case.fit["noise_floor_db"]) / 10) - 1
    lam, n = case.truth["effects"][0]["lambda"], len(case.y)
    assert abs(share * n - lam) < 0.1 * lam + 6 * math.sqrt(n) + 6 * math.sqrt(2 * lam)


def test_lambda_of_noise_is_the_log_likelihood_of_its_law(tmp_path):
    case = drawn(tmp_path, ["noise_floor"], accept=wholly_known)
    r = 10 ** (case.value("noise_floor", "change_db") / 10)
    assert case.truth["effects"][0]["lambda"] == pytest.approx(len(case.y) * (r - 1 - math.log(r)), rel=1e-6)

    boxed = lambda t: wholly_known(t) and t["effects"][0]["where"]  # noqa: E731
    case = drawn(tmp_path / "band", ["narrowband_interference"], accept=boxed)
    rho, b = 10 ** (case.value("narrowband_interference", "power_dbc") / 10) / case.noise, None
    b = case.value("narrowband_interference", "bandwidth_hz") / case.rate
    law = len(case.y) * (math.log1p(rho) - b * math.log1p(rho / b))
    assert case.truth["effects"][0]["lambda"] == pytest.approx(law, rel=0.03)

    # Laws that are tried on noise drawn by them: the ratio's mean over draws.
    rng, v, total = np.random.default_rng(1), np.repeat([1.0, 9.0], [4000, 1000]), 0.0
    for _ in range(20):
        w = rng.exponential(v)
        total += np.sum(-w / v - np.log(v) + w / np.mean(v) + np.log(np.mean(v))) / 20
    assert strength.uneven(v) == pytest.approx(total, rel=0.03)
    assert strength.modes(5000, [8.0] * 1000) == pytest.approx(strength.uneven(v), rel=1e-9)
    train = np.where(rng.random(20000) < 0.01, 10.0, 0)
    known = np.sum(np.log(np.mean(1 + train**2)) + (np.abs(train) ** 2 - train**2))
    assert 0.5 * known < strength.impulses(train, 0.01, [10.0], 1.0, rng) < known


@pytest.mark.parametrize("family", [*NOISES, "tap_fading", "phase_noise"])
def test_noise_is_drawn_over_the_whole_range(family, tmp_path, monkeypatch):
    got = []
    for seed, aim in enumerate((45.0, 3000.0)):
        monkeypatch.setattr(strength, "target", lambda rng, aim=aim: aim)
        truth = cases.draw(np.random.default_rng([7, seed]), "single", tmp_path / f"{seed}", [family])
        got.append(truth["effects"][0]["lambda"])
    assert strength.LEAST <= got[0] < 200 and 600 < got[1] < 20_000


def test_phase_noise_has_the_rms_that_is_told(tmp_path):
    steady = lambda t: t["conditions"]["waveform"] in ("gmsk", "fmcw", "builtin") and t["conditions"]["taps"] == 1  # noqa: E731
    case = drawn(tmp_path, ["phase_noise"], accept=lambda t: steady(t) and t["fit"][0]["snr_db"] > 10)
    base = case.fit["gain"] * np.exp(1j * case.fit["phase_rad"]) * case.columns()[0][0]
    loud = np.abs(base) > 0.5 * np.abs(base).max()
    phase = np.angle(case.y * np.conj(base))[loud]
    line = np.polyval(np.polyfit(np.flatnonzero(loud), phase, 1), np.flatnonzero(loud))
    noise = case.noise * np.mean(np.abs(base) ** 2) * np.mean(1 / np.abs(base[loud]) ** 2) / 2
    rms2 = case.value("phase_noise", "rms_rad") ** 2
    assert np.mean((phase - line) ** 2) - noise == pytest.approx(rms2, rel=0.2, abs=0.15 * noise)


def test_converters_are_as_stated(tmp_path):
    case = drawn(tmp_path, ["adc_clipping"])
    parts, level = np.abs([case.y.real, case.y.imag]), case.value("adc_clipping", "level")
    assert parts.max() == pytest.approx(level, abs=3.1e-5) and np.sum(parts > level - 3.1e-5) >= 5
    case = drawn(tmp_path / "steps", ["quantization"])
    u = np.concatenate([case.y.real, case.y.imag]) / case.value("quantization", "step") * 2
    assert np.abs(u - np.rint(u)).max() < 1e-3


# ---------------------------------------------------------------- laws of waveforms and of whole cases
@pytest.mark.parametrize("kind", waveforms.MAKERS)
def test_no_line_lies_at_half_the_sample_rate(kind):
    for seed in range(4):
        x, traits, repeat = waveforms.wave(np.random.default_rng([seed, 5]), 6000, [kind])
        assert np.mean(np.abs(x) ** 2) == pytest.approx(1, rel=1e-3)
        assert traits["bw"] > 0 and traits["spc"] >= 1
        if len(x) % 2 == 0:
            assert abs(np.mean(x * (1 - 2.0 * (np.arange(len(x)) % 2)))) < 1e-7


@pytest.mark.parametrize("seed", range(5))
def test_a_null_leaves_the_noise_that_its_twin_states(seed, tmp_path):
    truth = cases.draw(np.random.default_rng([seed, 41]), "null", tmp_path / "case")
    case = Case(tmp_path / "case", truth)
    ratio, _, _, wanted = case.solved()
    allowed = 5 / math.sqrt(case.keep.sum())
    assert abs(ratio - 1) < 0.01 + allowed
    assert truth["effects"] == [] and truth["fit"][0]["twin_nmse_db"] == pytest.approx(truth["fit"][0]["noise_floor_db"], abs=0.1)
    if "noise" in case.twin and wholly_known(truth):
        told = 10 ** (case.twin["noise"]["rx1"]["power_db"] / 10)
        assert ratio * case.expected(wanted) == pytest.approx(told, rel=0.01 + allowed)


@pytest.mark.parametrize(
    "families", [["extra_path", "carrier_frequency_offset"], ["tone_interference", "extra_path", "iq_imbalance"]]
)
def test_several_causes_leave_the_noise(families, tmp_path):
    case = drawn(tmp_path, families, 2, {2: "double", 3: "triple"}[len(families)], accept=wholly_known)
    ratio, c, own, _ = case.solved()
    assert abs(ratio - 1) < 0.04 + 5 / math.sqrt(case.keep.sum())
    if "tone_interference" in own:  # its level is re what is wanted in the world, not in the twin
        columns, k = case.columns()[0], own["tone_interference"]
        wanted = np.mean(np.abs(sum(a * x for i, (a, x) in enumerate(zip(c, columns, strict=True)) if i != k)) ** 2)
        got = 20 * np.log10(abs(c[k])) - 10 * np.log10(wanted)
        allowed = 8.7 * 4 / math.sqrt(2 * case.effects["tone_interference"]["lambda"]) + 0.02
        assert abs(got - case.value("tone_interference", "power_dbc")) < allowed


def test_a_network_has_its_causes_where_they_are_told(tmp_path):
    for seed in range(2):
        folder = tmp_path / f"{seed}"
        truth = cases.draw(np.random.default_rng([seed, 3]), "network", folder)
        for k in range(len(truth["fit"])):
            case = Case(folder, truth, k)
            loose = 10 if set(RANDOM) & set(case.effects) else sum(LOOSE.get(f, 0.01) for f in case.effects)
            assert abs(case.solved()[0] - 1) < 0.01 + loose + 5 / math.sqrt(case.keep.sum())


def test_an_outsider_stays(tmp_path):
    truth = cases.draw(np.random.default_rng(8), "outside", tmp_path / "case")
    assert truth["fit"][0]["twin_nmse_db"] > truth["fit"][0]["noise_floor_db"] + 0.2
    assert truth["verdicts_ok"] == ["unexplained"] and truth["tolerated"]


@pytest.mark.parametrize("form", cases.ABSENT[:2] + cases.ABSENT[3:])
def test_an_absent_waveform_is_nowhere(form, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "ABSENT", (form,))
    truth = cases.draw(np.random.default_rng(4), "absent", tmp_path / "case")
    case = Case(tmp_path / "case", truth)
    y = case.y * np.exp(-1j * TURN * case.offset * case.n / case.rate)
    if form is cases.blocker:  # its lines would hide what is sought
        line = np.fft.fft(y)
        y = np.fft.ifft(line / np.maximum(np.abs(line), 1e-12))
    x, size = case.sent.x, len(case.sent.x)
    y = y[: len(y) // size * size].reshape(-1, size).sum(0) if case.repeat else np.pad(y, (0, size - len(y)))
    c = np.abs(np.fft.ifft(np.fft.fft(y) * np.fft.fft(x).conj())) ** 2
    assert c.max() < 40 * c.mean()
    assert truth["kind"] == "outside" and truth["absent"] is True and truth["verdicts_ok"] == ["unexplained"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_what_the_scorer_reads_and_one_seed_draws_one_case(kind, tmp_path):
    draw = cases.draw
    truths = [draw(np.random.default_rng([6, 6]), kind, tmp_path / run) for run in "ab"]
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / run).iterdir()} for run in "ab")
    assert one == two and json.dumps(truths[0]) == json.dumps(truths[1])
    truth, twin = truths[0], yaml.safe_load((tmp_path / "a" / "twin.yaml").read_text())
    assert truth["kind"] == {"absent": "outside"}.get(kind, kind)
    assert len(truth["effects"]) == {"null": 0, "double": 2, "triple": 3}.get(kind, len(truth["effects"]))
    assert [f["recording"] for f in truth["fit"]] == [r["file"] for r in twin["recordings"]]
    assert {"sample_rate_hz", "samples", "duration_s", "samples_per_chip"} <= set(truth["conditions"])
    for entry in twin["recordings"]:
        y, _ = read(tmp_path / "a", entry["file"])
        assert len(y) == truth["conditions"]["samples"] and np.isfinite(y).all()
    assert (truth["ambiguous"] is not None) == (kind == "ambiguous")
    for e in truth["effects"]:
        assert e["lambda"] >= strength.LEAST and e["owner"]["name"] in e["owners_ok"]
        for p in e["parameters"].values():
            assert set(p) == {"value", "z", "also", "unsigned"} and np.isfinite([p["value"], *p["also"]]).all()
        assert all(a <= b for a, b in e["where"].values())


def test_a_build_draws_every_kind_and_is_sealed(tmp_path):
    argv = ["--world", "campus", "--cases", "3", "--nulls", "1", "--absent", "1", "--seed", "3", "--output"]
    for run in "ab":
        build.main([*argv, str(tmp_path / run)])
    seals = {(tmp_path / run / build.SEAL).read_text() for run in "ab"}
    assert len(seals) == 1 and len(list((tmp_path / "a" / "cases").iterdir())) == 5


def test_every_family_of_the_contract_has_a_cause():
    assert len(menu.FAMILIES) == 29 and set(LOOSE) <= set(menu.FAMILIES)
    rng = np.random.default_rng(2)
    assert all(menu.compatible(menu.families(rng, 3)) for _ in range(20))
    with pytest.raises(ValueError, match="kind"):
        cases.draw(rng, "nonsense", "nowhere")
