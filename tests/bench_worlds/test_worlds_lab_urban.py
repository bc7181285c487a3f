# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the worlds `lab` and `urban`: what the truths say, put into the contract's formula, is what the files hold.

The formulas here are written a second time, from the contract, by Fourier series and sinc sums: nothing of the worlds' own
interpolation is used.
"""

import importlib
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1] / "bench"
sys.path.insert(0, str(ROOT))

from worlds import build  # noqa: E402
from worlds.rig import drawing, waves  # noqa: E402
from worlds.rig import world as world_module  # noqa: E402

pytestmark = pytest.mark.timeout(120)
WORLDS = ("lab", "urban")
LOOKED_AT = 400  # samples of a recording that a law is checked on


def the_world(name):
    module = importlib.import_module(f"worlds.{name}.world")
    return module.Lab() if name == "lab" else module.Urban()


# ---------------------------------------------------------------- reading, by the contract alone
def read(folder, stem):
    kind = json.loads((folder / f"{stem}.sigmf-meta").read_text())["global"]["core:datatype"]
    raw = (folder / f"{stem}.sigmf-data").read_bytes()
    if kind == "cf32_le":
        return np.frombuffer(raw, "<c8").astype(complex)
    number, middle, scale = {"ci16_le": ("<i2", 0, 32768), "ci8": ("i1", 0, 128), "cu8": ("u1", 127.5, 128)}[kind]
    pairs = (np.frombuffer(raw, number) - float(middle)) / scale
    return pairs[::2] + 1j * pairs[1::2]


class Case:
    def __init__(self, folder, truth):
        self.folder, self.truth = folder, truth
        self.twin = yaml.safe_load((folder / "twin.yaml").read_text())
        self.rate = self.twin["sample_rate_hz"]
        entry = self.twin["recordings"][0]
        self.tx = entry["transmitters"][0]
        self.y = read(folder, entry["file"])
        node = self.twin["nodes"][self.tx]
        self.wave, self.repeat = self.waveform(node["transmit"])
        self.amplitude = node["amplitude"]
        self.taps = [dict(t) for t in self.twin["links"][0]["taps"]]
        self.fit = truth["fit"][0]
        self.noise = 10 ** (self.fit["noise_floor_db"] / 10) * self.recorded_power
        self.offset, self.ppm, self.step = 0.0, 0.0, None
        for e in self.twin["effects"]:
            p = {k: v["value"] for k, v in e["parameters"].items()}
            if e["family"] == "carrier_frequency_offset":
                self.offset += p["offset_hz"]
            elif e["family"] == "sample_clock_offset":
                self.ppm += p["offset_ppm"]
            elif e["family"] == "extra_path":
                self.taps.append(p)
            else:
                self.step = (p["time_s"], p["step_db"])

    @property
    def recorded_power(self):
        return float(np.mean(np.abs(self.y) ** 2))

    def waveform(self, key):
        entry = self.twin["waveforms"][key]
        if "file" in entry:
            return read(self.folder, entry["file"]), entry["repeat"]
        return waves.builtin(entry).samples, True

    def sent(self, positions, wave=None, repeat=None):
        """The waveform at any positions, in samples: a Fourier series, or a sum of sincs."""
        x = self.wave if wave is None else wave
        repeat = self.repeat if repeat is None else repeat
        out = np.empty(len(positions), complex)
        if repeat:
            n = len(x)
            k = np.fft.fftfreq(n, 1 / n)
            s = np.fft.fft(x) / n
            if n % 2 == 0:
                k, s = np.append(k, n // 2), np.append(s, s[n // 2] / 2)
                s[n // 2] /= 2
        for at in range(0, len(positions), 100):
            p = np.asarray(positions[at : at + 100])[:, None]
            if repeat:
                out[at : at + 100] = np.exp(2j * np.pi * (p % n) / n * k) @ s
            else:
                out[at : at + 100] = np.sinc(p - np.arange(len(x))) @ x
        return out

    def predicted(self, n, taps=None, ppm=0.0, offset=None):
        """The contract's formula at the samples n (not necessarily whole), but for the common gain."""
        t = n / self.rate
        out = 0
        for tap in self.taps if taps is None else taps:
            gain = 10 ** (tap["gain_db"] / 20) * np.exp(1j * tap["phase_rad"] + 2j * np.pi * tap["doppler_hz"] * t)
            delay = tap["delay_s"] * self.rate + self.fit["delay_samples"]
            out = out + gain * self.amplitude * self.sent(n * (1 + 1e-6 * (ppm + self.ppm)) - delay)
        if self.step:
            out = out * 10 ** (self.step[1] / 20 * (t >= self.step[0] - 1e-12))
        return out * np.exp(2j * np.pi * (self.offset if offset is None else offset) * t)

    def looked_at(self, rng, count=LOOKED_AT):
        return np.sort(rng.choice(np.arange(40, len(self.y) - 40), count, replace=False)).astype(float)


def left(y, columns):
    """(power that a linear fit leaves, coefficients)"""
    a = np.column_stack(columns)
    c = np.linalg.lstsq(a, y, rcond=None)[0]
    return float(np.mean(np.abs(y - a @ c) ** 2)) * len(y) / (len(y) - a.shape[1]), c


def about(value, expected, count, slack=0.0):
    """The power of `count` complex noise samples, within five standard deviations."""
    return abs(value / expected - 1) < 5 / math.sqrt(count) + slack


# ---------------------------------------------------------------- drawing what a law needs
@pytest.fixture(autouse=True)
def short(monkeypatch):
    def length(rng, wave):
        if not wave.repeat:
            return int(len(wave.samples) * 1.2) + 900
        return max(12_000, 4 * len(wave.samples))

    monkeypatch.setattr(world_module, "length", length)


def plain(scene):
    """A repeated, wholly known waveform, and nothing in the twin but a fixed offset."""
    wave = scene.wave("tx1")
    told = [p["std"] for e in scene.twin_effects for p in e["parameters"].values()]
    listed = {e["family"] for e in scene.twin_effects} <= {"carrier_frequency_offset"}
    return wave.repeat and wave.known is None and listed and not any(told)


def drawn(name, family, folder, monkeypatch, lam=1.5e4, accept=lambda case: True, direct=False, still=False):
    """A case of this one family, about as strong as `lam`; direct: over one path; still: without an offset."""
    monkeypatch.setattr(drawing, "spread", lambda *a: lam)
    world = the_world(name)
    world.menu = {family: world.menu[family]}
    draw_scene = world.scene

    def scene(rng):
        while True:
            made = draw_scene(rng, offset=False if still else None, taps=1 if direct else None)
            if plain(made):
                return made

    world.scene = scene
    for seed in range(40):
        place = folder / f"{seed}"
        truth = drawing.draw(world, np.random.default_rng([seed, 99]), "single", place)
        case = Case(place, truth)
        if accept(case):
            return case, truth["effects"][0]
    raise AssertionError(f"no plain case of {family}")


def value(effect, key):
    return effect["parameters"][key]["value"]


def check(case, n, columns):
    power, c = left(case.y[n.astype(int)], columns)
    assert about(power, case.noise, len(n), 0.05), (power / case.noise, case.folder)
    return c


# ---------------------------------------------------------------- laws, one per family
@pytest.mark.parametrize("name", WORLDS)
def test_a_carrier_offset_turns_the_twins_prediction(name, tmp_path, monkeypatch):
    case, e = drawn(name, "carrier_frequency_offset", tmp_path, monkeypatch, direct=True)
    n = case.looked_at(np.random.default_rng(1))
    t = n / case.rate
    drift = value(e, "drift_hz_per_s") if "drift_hz_per_s" in e["parameters"] else 0.0
    check(case, n, [case.predicted(n) * np.exp(2j * np.pi * (value(e, "offset_hz") * t + drift * t**2 / 2))])


@pytest.mark.parametrize("name", WORLDS)
def test_a_positive_clock_offset_lets_the_waveform_run_fast(name, tmp_path, monkeypatch):
    case, e = drawn(name, "sample_clock_offset", tmp_path, monkeypatch, direct=True, still=True)
    n = case.looked_at(np.random.default_rng(1))
    check(case, n, [case.predicted(n, ppm=value(e, "offset_ppm"))])


@pytest.mark.parametrize("name", WORLDS)
def test_an_image_lies_its_rejection_below(name, tmp_path, monkeypatch):
    case, e = drawn(name, "iq_imbalance", tmp_path, monkeypatch, direct=True, still=True)
    n = case.looked_at(np.random.default_rng(1), 2 * LOOKED_AT)
    base = case.predicted(n)
    c = check(case, n, [base, np.conj(base)])
    got = -20 * np.log10(abs(c[1] / c[0]))
    assert abs(got - value(e, "image_rejection_db")) < 1.0


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("family", ["dc_offset", "lo_leakage"])
def test_a_line_stands_at_the_receivers_zero_or_the_transmitters_carrier(name, family, tmp_path, monkeypatch):
    case, e = drawn(name, family, tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1), 2 * LOOKED_AT)
    t = n / case.rate
    base = case.predicted(n)
    if family == "dc_offset":
        line = np.exp(-t / value(e, "decay_s")) if "decay_s" in e["parameters"] else np.ones(len(n))
        level = np.mean(np.abs(base) ** 2)
    else:
        line = np.exp(2j * np.pi * case.offset * t)
        through = sum(
            10 ** (p["gain_db"] / 20) * np.exp(1j * p["phase_rad"] + 2j * np.pi * p["doppler_hz"] * t) for p in case.taps
        )
        line, level = line * through, np.mean(np.abs(case.amplitude * case.wave) ** 2)
    c = check(case, n, [base, line])
    got = 20 * np.log10(abs(c[1] / c[0])) - 10 * np.log10(level)
    assert abs(got - value(e, "level_dbc")) < 1.0


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("family", ["gain_step", "gain_drift", "power_supply_hum"])
def test_a_gain_takes_its_course(name, family, tmp_path, monkeypatch):
    simple = lambda c: c.truth["effects"][0]["form"] != "with harmonics"  # noqa: E731
    case, e = drawn(name, family, tmp_path, monkeypatch, accept=simple)
    n = case.looked_at(np.random.default_rng(1))
    t, base = n / case.rate, case.predicted(n)
    if family == "gain_step":
        columns = [base * 10 ** (value(e, "step_db") / 20 * (t >= value(e, "time_s") - 1e-12))]
    elif family == "gain_drift":
        u = t * case.rate / len(case.y)
        if "time_constant_s" in e["parameters"]:
            tau = value(e, "time_constant_s")
            u = np.expm1(-t / tau) / np.expm1(-len(case.y) / case.rate / tau)
        columns = [base * 10 ** (value(e, "total_db") / 20 * u)]
    else:
        w = 2 * np.pi * value(e, "frequency_hz") * t
        columns = [base, base * np.cos(w), base * np.sin(w)]
    got, c = left(case.y[n.astype(int)], columns)
    # A receiver's gain takes its noise along.
    assert abs(got / case.noise - 1) < 5 / math.sqrt(len(n)) + 0.3
    assert got < 0.9 * left(case.y[n.astype(int)], [base])[0] or e["lambda"] < 0.2 * len(case.y)
    if family == "power_supply_hum":
        assert abs(np.hypot(abs(c[1]), abs(c[2])) / abs(c[0]) / value(e, "depth") - 1) < 0.25


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("family", ["extra_path", "missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler"])
def test_paths_are_on_the_scale_of_the_twins_taps(name, family, tmp_path, monkeypatch):
    case, e = drawn(name, family, tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    taps = [dict(t) for t in case.taps]
    if family == "extra_path":
        taps.append({"doppler_hz": 0.0} | {k: p["value"] for k, p in e["parameters"].items()})
    else:
        k = next(k for k, t in enumerate(taps) if t["delay_s"] == value(e, "delay_s"))
        if family == "missing_path":
            del taps[k]
        elif family == "tap_gain_error":
            taps[k]["gain_db"] += value(e, "error_db")
            taps[k]["phase_rad"] += value(e, "error_rad")
        elif family == "tap_delay_error":
            taps[k]["delay_s"] += value(e, "error_s")
        else:
            taps[k]["doppler_hz"] += value(e, "doppler_hz")
    check(case, n, [case.predicted(n, taps)])


@pytest.mark.parametrize("name", WORLDS)
def test_a_second_transmitter_sends_a_listed_code(name, tmp_path, monkeypatch):
    case, e = drawn(name, "second_transmitter", tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    wave, repeat = case.waveform(e["values"]["code"])
    other = case.sent(n - value(e, "delay_s") * case.rate, wave, repeat)
    c = check(case, n, [case.predicted(n), other])
    assert abs(20 * np.log10(abs(c[1] / c[0])) - value(e, "gain_db")) < 1.0


@pytest.mark.parametrize("name", WORLDS)
def test_a_tone_lies_where_it_is_recorded(name, tmp_path, monkeypatch):
    case, e = drawn(name, "tone_interference", tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    base = case.predicted(n)
    c = check(case, n, [base, np.exp(2j * np.pi * value(e, "frequency_hz") * n / case.rate)])
    got = 20 * np.log10(abs(c[1])) - 10 * np.log10(np.mean(np.abs(c[0] * base) ** 2))
    assert abs(got - value(e, "power_dbc")) < 1.0


@pytest.mark.parametrize("name", WORLDS)
def test_an_inverted_spectrum_is_the_conjugate(name, tmp_path, monkeypatch):
    case, e = drawn(name, "spectral_inversion", tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    check(case, n, [np.conj(case.predicted(n))])


@pytest.mark.parametrize("name", WORLDS)
def test_lost_samples_are_missing_at_their_place(name, tmp_path, monkeypatch):
    case, e = drawn(name, "sample_loss", tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    place, k = round(value(e, "time_s") * case.rate), value(e, "samples")
    n = n[(n < place) | (n >= place + max(0, -k))]
    check(case, n, [case.predicted(np.where(n >= place, n + k, n))])


@pytest.mark.parametrize("name", WORLDS)
def test_clipped_samples_lie_on_the_rails(name, tmp_path, monkeypatch):
    case, e = drawn(name, "adc_clipping", tmp_path, monkeypatch)
    level = value(e, "level")
    step = {"cf32_le": 1e-6, "ci16_le": 1 / 32768, "ci8": 1 / 128, "cu8": 1 / 128}[case.truth["conditions"]["datatype"]]
    parts = np.concatenate([case.y.real, case.y.imag])
    assert abs(np.abs(parts).max() - level) <= step
    assert np.mean(np.abs(parts) > level - 1.01 * step) > 1e-4


@pytest.mark.parametrize("name", WORLDS)
def test_a_quantiser_leaves_its_lattice(name, tmp_path, monkeypatch):
    case, e = drawn(name, "quantization", tmp_path, monkeypatch)
    u = np.concatenate([case.y.real, case.y.imag]) / value(e, "step")
    u = u - (0.5 if "mid-rise" in e["form"] else 0.0)
    assert np.abs(u - np.rint(u)).max() < 0.01


@pytest.mark.parametrize("name", WORLDS)
def test_the_floor_differs_from_the_twins_by_what_is_told(name, tmp_path, monkeypatch):
    case, e = drawn(name, "noise_floor", tmp_path, monkeypatch)
    n = case.looked_at(np.random.default_rng(1))
    power, _ = left(case.y[n.astype(int)], [case.predicted(n)])
    told = 10 ** ((case.twin["noise"]["rx1"]["power_db"] + value(e, "change_db")) / 10)
    assert about(power, told, len(n), 0.03)


@pytest.mark.parametrize("name", WORLDS)
def test_a_tail_is_echoes_within_its_place(name, tmp_path, monkeypatch):
    brief = lambda c: value(c.truth["effects"][0], "decay_s") * c.rate < 25  # noqa: E731
    case, e = drawn(name, "diffuse_tail", tmp_path, monkeypatch, accept=brief)
    start, stop = (int(round(d * case.rate)) for d in e["where"]["delay_s"])
    reach = 3 * (stop - start) + 8
    n = np.arange(2000.0, 2000 + 8 * reach)
    early = np.arange(n[0] - start - reach, n[-1] + 8)  # one run of samples holds all the echoes
    x = case.amplitude * case.sent(early - case.fit["delay_samples"])
    turn = np.exp(2j * np.pi * case.offset * n / case.rate)
    echoes = [x[start + reach - d :][: len(n)] * turn for d in range(start - 4, start + reach)]
    y, base = case.y[n.astype(int)], case.predicted(n)
    power, _ = left(y, [base, *echoes])
    assert power < 1.25 * case.noise + 0.03 * left(y, [base])[0]


@pytest.mark.parametrize("name", WORLDS)
def test_phase_noise_has_the_rms_that_is_told(name, tmp_path, monkeypatch):
    def steady(c):
        even = np.abs(c.wave).min() > 0.5 * np.abs(c.wave).max()
        return even and c.fit["snr_db"] > 12 and value(c.truth["effects"][0], "rms_rad") < 0.4

    case, e = drawn(name, "phase_noise", tmp_path, monkeypatch, accept=steady, direct=True)
    n = np.linspace(40, len(case.y) - 41, 800).astype(int).astype(float)
    base = case.predicted(n)
    g = np.vdot(base, case.y[n.astype(int)]) / np.vdot(base, base)
    phase = np.angle(case.y[n.astype(int)] / (g * base))
    noise = case.noise / 2 * np.mean(1 / np.abs(g * base) ** 2)
    line = np.polyval(np.polyfit(n, phase, 1), n)
    got = np.mean((phase - line) ** 2) - noise
    assert abs(got - value(e, "rms_rad") ** 2) < 0.2 * value(e, "rms_rad") ** 2 + 0.2 * noise


@pytest.mark.parametrize("name", WORLDS)
def test_an_amplifier_loses_gain_at_the_largest_amplitude(name, tmp_path, monkeypatch):
    def clear(c):
        return c.fit["snr_db"] > 20 and not c.truth["effects"][0]["values"]["memory"]

    case, e = drawn(name, "pa_nonlinearity", tmp_path, monkeypatch, 4e4, accept=clear, direct=True)
    n = case.looked_at(np.random.default_rng(1), 1200)
    x = case.predicted(n)
    r = np.abs(x) / np.abs(case.amplitude * case.wave).max()
    power, c = left(case.y[n.astype(int)], [x * r ** (2 * k) for k in range(4)])
    # What the amplifier spreads beyond the sampled band never reached the file.
    assert power < 1.3 * case.noise + 0.1 * left(case.y[n.astype(int)], [x])[0]
    got = -20 * np.log10(abs(np.sum(c) / c[0]))
    allowed = [value(e, "compression_db"), *e["parameters"]["compression_db"]["also"]]
    assert min(abs(abs(got) - abs(v)) for v in allowed) < 0.35


@pytest.mark.parametrize("name", WORLDS)
def test_a_filter_has_the_ripple_that_is_told(name, tmp_path, monkeypatch):
    case, e = drawn(name, "front_end_filter", tmp_path, monkeypatch, 4e4, accept=lambda c: c.fit["snr_db"] > 18, direct=True)
    period, t = len(case.wave), np.arange(len(case.y)) / case.rate
    y = case.y * np.exp(-2j * np.pi * case.offset * t)
    k = len(y) // period
    mean = y[: k * period].reshape(k, period).mean(0)
    s, r = np.fft.fft(case.wave), np.fft.fft(mean)
    bins = np.argsort(np.fft.fftfreq(period))
    width = max(8, period // 60)
    box = np.ones(width) / width
    density = np.convolve(np.abs(s[bins]) ** 2, box, "same")
    gain = 10 * np.log10(np.convolve(np.abs(r[bins]) ** 2, box, "same") / density)
    held = density > 0.02 * density.max()
    got = gain[held].max() - gain[held].min()
    allowed = [value(e, "ripple_db"), *e["parameters"]["ripple_db"]["also"]]
    assert 0.6 * min(allowed) - 0.3 < got < 1.5 * max(allowed) + 0.6


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize(
    "family", ["narrowband_interference", "pulsed_interference", "impulsive_noise", "signal_dependent_noise"]
)
def test_what_is_added_has_the_power_that_is_told(name, family, tmp_path, monkeypatch):
    case, e = drawn(name, family, tmp_path, monkeypatch, direct=True)
    if family == "impulsive_noise":
        assert np.abs(case.y).max() > 0.3 * 10 ** (value(e, "power_db") / 20)
        return
    n = np.arange(2000.0, 6000.0)
    base = case.predicted(n)
    y = case.y[n.astype(int)]
    g = np.vdot(base, y) / np.vdot(base, base)
    rest, wanted = y - g * base, np.mean(np.abs(g * base) ** 2)
    if family == "narrowband_interference":
        s = np.abs(np.fft.fft(rest * np.hanning(len(n)))) ** 2
        f = np.fft.fftfreq(len(n), 1 / case.rate)
        inside = np.abs(f - value(e, "frequency_hz")) < 0.75 * value(e, "bandwidth_hz") + 3 * case.rate / len(n)
        over = s[inside].sum() - np.median(s[~inside]) / np.log(2) * inside.sum()
        got = 10 * np.log10(over / np.sum(np.hanning(len(n)) ** 2) / len(n) / wanted)
        assert abs(got - value(e, "power_dbc")) < 3.5
    elif family == "pulsed_interference":
        window = max(4, int(0.3 * value(e, "duty_cycle") * value(e, "period_s") * case.rate))
        loud = np.convolve(np.abs(case.y - 0) ** 2, np.ones(window) / window, "valid")
        assert loud.max() > 0.4 * (10 ** (value(e, "power_dbc") / 10) + 0.5) * wanted
    else:
        told = 10 ** (value(e, "slope_db") / 10)
        assert about(np.mean(np.abs(rest) ** 2), case.noise, len(n) / 4, 0.1)
        assert about(case.noise, wanted / 10 ** (case.fit["snr_db"] / 10) * (1 + told), len(n) / 4, 0.1)


# ---------------------------------------------------------------- laws of whole worlds
def test_what_a_right_twin_leaves_is_the_floor(tmp_path):
    for name in WORLDS:
        draw, seen = importlib.import_module(f"worlds.{name}").draw, 0
        for seed in range(40):
            place = tmp_path / f"{name}{seed}"
            truth = draw(np.random.default_rng([seed, 3]), "null", place)
            case = Case(place, truth)
            assert abs(case.fit["twin_nmse_db"] - case.fit["noise_floor_db"]) < 0.02
            stds = [p["std"] for e in case.twin["effects"] for p in e["parameters"].values()]
            if any(stds) or np.isnan(case.wave).any() or not case.repeat:
                continue
            n = case.looked_at(np.random.default_rng(seed))
            power, _ = left(case.y[n.astype(int)], [case.predicted(n)])
            assert about(power, case.noise, len(n)), (name, seed)
            if "noise" in case.twin:
                told = 10 ** (case.twin["noise"]["rx1"]["power_db"] / 10)
                assert about(case.noise, told, len(case.y), 1e-3)
            seen += 1
            if seen == 2:
                break
        assert seen == 2


@pytest.mark.parametrize("known", ["clock", "step", "path"])
def test_physics_that_the_twin_lists_is_in_the_recording(known, tmp_path):
    name = "urban" if known == "path" else "lab"
    world = the_world(name)
    draw_scene = world.scene

    def scene(rng, **more):
        while True:
            made = draw_scene(rng, still=True, offset=False)
            if made.wave("tx1").repeat and made.wave("tx1").known is None:
                break
        if known == "clock":
            world_module.know_clock(rng, made, 11.0)
        elif known == "step":
            world_module.know_step(rng, made, -1.5)
        else:
            world_module.know_path(rng, made, made.links[("tx1", "rx1")][-1]["delay_s"] + 9.3 / made.rate, -8.0, 1.0)
        return made

    world.scene = scene
    truth = drawing.draw(world, np.random.default_rng(12), "null", tmp_path / "case")
    case = Case(tmp_path / "case", truth)
    n = case.looked_at(np.random.default_rng(1))
    assert len(case.twin["effects"]) == 1
    check(case, n, [case.predicted(n)])


def test_an_absent_waveform_is_not_there(tmp_path):
    """No lag of the waveform correlates with the recording beyond what noise and a stranger's signal do."""
    for name in WORLDS:
        draw = importlib.import_module(f"worlds.{name}").draw
        for seed in range(6):
            place = tmp_path / f"{name}{seed}"
            truth = draw(np.random.default_rng([seed, 4]), "absent", place)
            assert truth["absent"] is True and truth["kind"] == "outside" and truth["verdicts_ok"] == ["unexplained"]
            case = Case(place, truth)
            if truth["effects"][0]["form"] not in ("noise", "too_weak") or np.isnan(case.wave).any():
                continue
            size = 1 << (len(case.y) + len(case.wave)).bit_length()
            x = np.tile(case.wave, len(case.y) // len(case.wave) + 1)[: len(case.y)] if case.repeat else case.wave
            t = np.arange(len(case.y)) / case.rate
            y = case.y * np.exp(-2j * np.pi * case.offset * t)
            c = np.abs(np.fft.ifft(np.fft.fft(y, size) * np.conj(np.fft.fft(x, size)))) ** 2
            assert c.max() / (np.sum(np.abs(x) ** 2) * case.recorded_power) < np.log(size) + 12


@pytest.mark.parametrize("kind", ["network", "outside", "ambiguous", "triple"])
def test_truths_have_what_the_scorer_reads(kind, tmp_path):
    for name in WORLDS:
        truth = importlib.import_module(f"worlds.{name}").draw(np.random.default_rng([5, 6]), kind, tmp_path / name)
        truth = json.loads(json.dumps(truth))
        twin = yaml.safe_load((tmp_path / name / "twin.yaml").read_text())
        assert truth["kind"] == kind and truth["verdicts_ok"]
        assert {"sample_rate_hz", "samples", "duration_s", "samples_per_chip"} <= set(truth["conditions"])
        assert [f["recording"] for f in truth["fit"]] == [r["file"] for r in twin["recordings"]]
        for f in truth["fit"]:
            assert np.isfinite([f["twin_nmse_db"], f["noise_floor_db"]]).all()
            assert len(read(tmp_path / name, f["recording"])) == truth["conditions"]["samples"]
        for e in truth["effects"]:
            assert e["lambda"] > 0 and e["owners_ok"] and isinstance(e["same_as"], list)
            for p in e["parameters"].values():
                assert math.isfinite(p["value"]) and set(p) == {"value", "z", "also", "unsigned"}
            for a, b in e["where"].values():
                assert a <= b
        if kind == "ambiguous":
            assert truth["ambiguous"]["family_sets"] and truth["ambiguous"]["record_next"]
        if kind == "network":
            names = set(twin["nodes"]) | {"environment"} | {f"{k['tx']}>{k['rx']}" for k in twin["links"]}
            assert all(set(e["owners_ok"]) <= names for e in truth["effects"])


def test_one_seed_draws_one_case(tmp_path):
    for name in WORLDS:
        draw = importlib.import_module(f"worlds.{name}").draw
        for n in (1, 2):
            draw(np.random.default_rng([7, 8]), "double", tmp_path / f"{name}{n}")
        one, two = ({p.name: p.read_bytes() for p in (tmp_path / f"{name}{n}").iterdir()} for n in (1, 2))
        assert one == two


def test_a_build_goes_on_where_it_stopped_and_is_sealed(tmp_path, capsys):
    argv = ["--world", "lab", "--cases", "2", "--nulls", "1", "--absent", "1", "--seed", "3", "--output", str(tmp_path / "a")]
    build.main(argv)
    seal = (tmp_path / "a" / "SEAL.sha256").read_text()
    truths = sorted((tmp_path / "a" / "truth").glob("*.json"))
    assert len(truths) == 4 and {p.stem for p in truths} == {p.name for p in (tmp_path / "a" / "cases").iterdir()}
    assert all(json.loads(p.read_text())["case"] == p.stem for p in truths)
    truths[1].unlink()
    build.main(argv)
    assert (tmp_path / "a" / "SEAL.sha256").read_text() == seal and seal.strip() in capsys.readouterr().out


def test_built_in_codes_are_the_projects():
    try:
        from gr_cast import codes
    except ImportError:
        codes = pytest.importorskip("gr_cast.signals.codes")
    entries = [{"code": "glfsr", "degree": d, "mask": 0, "seed": 77} for d in (8, 9, 10)]
    entries += [{"code": "gold", "length": n} for n in (63, 127, 511)] + [{"code": c} for c in ("ls", "ga128", "gb128")]
    entries += [{"code": "zadoff_chu", "length": 353, "root": 25}, {"code": "zadoff_chu", "length": 64, "root": 5}]
    for entry in entries:
        entry = {**entry, "samples_per_chip": 3}
        assert np.allclose(waves.builtin(entry).samples, codes.from_spec(entry), atol=1e-6), entry


def test_shares_of_kinds():
    kinds = build.kinds(250, 100, 10)
    assert len(kinds) == 360 and kinds.count("null") == 100 and kinds.count("absent") == 10
    assert abs(kinds.count("single") - 88) <= 1 and abs(kinds.count("triple") - 38) <= 1 and kinds.count("network") == 20


def test_every_family_of_the_contract_has_forms():
    contract = {
        "carrier_frequency_offset", "sample_clock_offset", "phase_noise", "iq_imbalance", "dc_offset", "lo_leakage",
        "pa_nonlinearity", "adc_clipping", "quantization", "gain_step", "gain_drift", "power_supply_hum", "front_end_filter",
        "extra_path", "missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading", "diffuse_tail",
        "second_transmitter", "tone_interference", "narrowband_interference", "pulsed_interference", "impulsive_noise",
        "noise_floor", "signal_dependent_noise", "sample_loss", "spectral_inversion",
    }  # fmt: skip
    assert all(set(the_world(name).menu) == contract for name in WORLDS)
