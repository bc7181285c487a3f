# SPDX-License-Identifier: GPL-3.0-or-later
"""Laws of the worlds `space` and `factory`: what the files hold is what the truths say, by formulas of the contract alone.

The waveform is evaluated as an exact trigonometric sum at a few hundred recorded instants, so that nothing here shares the
interpolation, the chain or the causes of the worlds.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

from worlds import factory, space
from worlds._craft import draw as craft
from worlds.factory.world import WORLD as FACTORY
from worlds.space.world import WORLD as SPACE

WORLDS = {"space": SPACE, "factory": FACTORY}
MODULES = {"space": space, "factory": factory}
SCALES = {"ci16_le": ("<i2", 32768.0, 0.0), "ci8": ("i1", 128.0, 0.0), "cu8": ("u1", 128.0, 127.5)}
KINDS = ("null", "single", "double", "triple", "network", "outside", "ambiguous", "absent")
FORMULAS = (
    "carrier_frequency_offset",
    "sample_clock_offset",
    "dc_offset",
    "lo_leakage",
    "gain_step",
    "gain_drift",
    "power_supply_hum",
    "extra_path",
    "missing_path",
    "tap_gain_error",
    "tap_delay_error",
    "tap_doppler",
    "second_transmitter",
    "tone_interference",
    "sample_loss",
    "spectral_inversion",
    "iq_imbalance",
)
ENERGIES = ("pa_nonlinearity", "front_end_filter", "diffuse_tail", "tap_fading", "phase_noise", "adc_clipping")


def sigmf(folder, stem):
    meta = json.loads((folder / f"{stem}.sigmf-meta").read_text())
    kind = meta["global"]["core:datatype"]
    if kind == "cf32_le":
        return np.fromfile(folder / f"{stem}.sigmf-data", "<c8").astype(complex)
    dtype, scale, middle = SCALES[kind]
    pairs = (np.fromfile(folder / f"{stem}.sigmf-data", dtype).reshape(-1, 2).astype(float) - middle) / scale
    return pairs[:, 0] + 1j * pairs[:, 1]


def at(x, repeat, instants):
    """The band-limited signal through the samples x at any instants, by its Fourier sum."""
    if not repeat:
        x = np.concatenate([x, np.zeros(6000)])
    line = np.fft.fft(x) / len(x)
    k = np.rint(np.fft.fftfreq(len(x)) * len(x))
    keep = np.abs(line) > 1e-7 * np.abs(line).max()
    line, k, out = line[keep], k[keep], np.empty(len(instants), complex)
    for a in range(0, len(instants), 200):
        u = instants[a : a + 200]
        out[a : a + 200] = np.exp(2j * np.pi / len(x) * (u % len(x))[:, None] * k[None, :]) @ line
    if not repeat:
        out[(instants < -40) | (instants > len(x) - 40)] = 0
    return out


class Model:
    """A case with one recording, read back; `columns` is the contract's formula with these effects in it."""

    def __init__(self, folder, truth, count=350):
        self.folder, self.truth, self.straight = folder, truth, False
        self.twin = yaml.safe_load((folder / "twin.yaml").read_text())
        self.y = sigmf(folder, "recording")
        self.rate, self.n = self.twin["sample_rate_hz"], len(self.y)
        self.fit = truth["fit"][0]
        self.power = np.mean(np.abs(self.y) ** 2)
        self.floor = self.power * 10 ** (self.fit["noise_floor_db"] / 10)
        rng = np.random.default_rng(1)
        first, last = 0, self.n
        wave = self.twin["waveforms"]["w1"]
        self.x, self.repeat = sigmf(folder, wave["file"]), wave["repeat"]
        if not self.repeat:
            first, last = int(self.fit["delay_samples"]), min(self.n, int(self.fit["delay_samples"]) + len(self.x))
            count = min(count, 120)
        self.index = np.sort(rng.choice(np.arange(first, last), count, replace=False))

    def columns(self, effects):
        """-> the wanted signal by the formula, and the columns whose complex factors a truth does not state."""

        def p(e, k):
            return e["parameters"][k]["value"] if k in e["parameters"] else 0.0

        def of(family):
            return [e for e in effects if e["family"] == family]

        n = self.index.astype(float)
        t = n / self.rate
        index = n.copy()
        for e in of("sample_loss"):
            index[t >= p(e, "time_s") - 1e-9 / self.rate] += p(e, "samples")
        clock = 1 + 1e-6 * sum(p(e, "offset_ppm") for e in of("sample_clock_offset"))
        s = index / self.rate
        turn = np.ones(len(s), complex)
        for e in of("carrier_frequency_offset"):
            turn *= np.exp(2j * np.pi * (p(e, "offset_hz") * s + p(e, "drift_hz_per_s") / 2 * s * s))
        carrier = self.twin["center_frequency_hz"]
        taps = [{**tap, "move": 0.0} for tap in self.twin["links"][0]["taps"]]
        for e in of("missing_path"):
            taps = [tap for tap in taps if tap["delay_s"] != p(e, "delay_s")]
        for tap in taps:
            for e in effects:
                if e["parameters"].get("delay_s", {}).get("value") != tap["delay_s"]:
                    continue
                if e["family"] == "tap_gain_error":
                    tap["gain_db"] += p(e, "error_db")
                    tap["phase_rad"] += p(e, "error_rad")
                elif e["family"] == "tap_doppler":
                    tap["move"] += p(e, "doppler_hz")
                elif e["family"] == "tap_delay_error":
                    tap["later"] = p(e, "error_s")
        taps += [
            {
                "delay_s": p(e, "delay_s"),
                "gain_db": p(e, "gain_db"),
                "phase_rad": p(e, "phase_rad"),
                "doppler_hz": 0.0,
                "move": p(e, "doppler_hz"),
            }
            for e in of("extra_path")
        ]
        amplitude, delay = self.twin["nodes"]["tx1"]["amplitude"], self.fit["delay_samples"]
        gain = self.fit["gain"] * np.exp(1j * self.fit["phase_rad"])
        wanted, flat, image = np.zeros(len(s), complex), np.zeros(len(s), complex), np.zeros(len(s), complex)
        for tap in taps:
            u = (s - tap["delay_s"] - tap.get("later", 0.0) + tap["move"] / carrier * s) * self.rate * clock - delay
            turned = tap["phase_rad"] + 2 * np.pi * (tap["doppler_hz"] + tap["move"]) * s
            factor = 10 ** (tap["gain_db"] / 20) * np.exp(1j * turned)
            x = at(self.x, self.repeat, u)
            wanted += factor * x
            image += factor * x.conj()
            flat += factor
        wanted, image, flat = (v * amplitude * gain * turn for v in (wanted, image, flat))
        more = []
        for e in effects:
            if e["family"] == "gain_step":
                wanted = wanted * np.where(t >= p(e, "time_s") - 1e-9 / self.rate, 10 ** (p(e, "step_db") / 20), 1)
            elif e["family"] == "gain_drift":
                x, total = t / (self.n / self.rate), p(e, "total_db")
                if "time_constant_s" in e["parameters"]:
                    c = self.n / self.rate / p(e, "time_constant_s")
                    wanted = wanted * 10 ** (total / 20 * (1 - np.exp(-c * x)) / (1 - np.exp(-c)))
                else:  # linear in dB, or in amplitude
                    wanted = wanted * (1 + (10 ** (total / 20) - 1) * x if self.straight else 10 ** (total * x / 20))
            elif e["family"] == "spectral_inversion":
                wanted = wanted.conj()
            elif e["family"] == "iq_imbalance":
                more.append(image if e["owner"]["level"] == "tx" else wanted.conj())
            elif e["family"] == "lo_leakage":
                more.append(flat * np.sqrt(np.mean(np.abs(self.x) ** 2)))
            elif e["family"] == "dc_offset":
                more.append(np.exp(-t / p(e, "decay_s")) if "decay_s" in e["parameters"] else np.ones(len(t)))
            elif e["family"] == "tone_interference":
                more.append(np.exp(2j * np.pi * p(e, "frequency_hz") * t))
            elif e["family"] == "power_supply_hum":
                for k in (1, 2, 3):
                    w = 2 * np.pi * k * p(e, "frequency_hz") * t
                    more += [wanted * np.cos(w), wanted * np.sin(w)]
            elif e["family"] == "second_transmitter":
                entry = self.twin["waveforms"]["w9"]
                other = sigmf(self.folder, entry["file"])
                u = s * self.rate - delay - p(e, "delay_s") * self.rate
                more.append(at(other, entry["repeat"], u) * self.fit["gain"] * turn)
        return wanted, more

    def fitted(self, effects):
        """-> (residual power over the floor, factor of the wanted signal, factors of the columns, std of them all)."""
        wanted, more = self.columns(effects)
        basis = np.stack([wanted, *more], 1)
        factor, *_ = np.linalg.lstsq(basis, self.y[self.index], rcond=None)
        left = self.y[self.index] - basis @ factor
        std = np.sqrt(self.floor * np.diag(np.linalg.inv(basis.conj().T @ basis)).real)
        return np.sum(np.abs(left) ** 2) / (len(left) - basis.shape[1]) / self.floor, factor[0], factor[1:], std


def made(world, tmp_path, family, seed=0, kind="single"):
    folder = tmp_path / f"{world}_{family}_{seed}"
    truth = craft.case(WORLDS[world], np.random.default_rng([len(family), seed]), kind, folder, [family])
    return folder, truth


def effects_of(model):
    return [*model.twin["effects"], *model.truth["effects"]]


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("family", FORMULAS)
def test_closed_form_of_a_truth_leaves_the_stated_floor(world, family, tmp_path):
    folder, truth = made(world, tmp_path, family, seed=3)
    model = Model(folder, truth)
    ratio, main, factors, std = model.fitted(effects_of(model))
    if family == "gain_drift" and abs(abs(main) - 1) > 0.02:
        model.straight = True
        ratio, main, factors, std = model.fitted(effects_of(model))
    count = len(model.index)
    assert abs(ratio - 1) < 5 / np.sqrt(count) + 0.03
    if family != "iq_imbalance":
        assert abs(abs(main) - 1) < 0.01 + 5 * std[0]
    e = truth["effects"][0]
    value = {k: v["value"] for k, v in e["parameters"].items()}

    def near(got, want, k):
        return abs(got - want) < 6 * std[k + 1] + 0.01 * want

    if family == "tone_interference":
        wanted, _ = model.columns(effects_of(model))
        assert near(abs(factors[0]), np.sqrt(10 ** (value["power_dbc"] / 10) * wanted_power(model)), 0)
    elif family == "dc_offset":
        assert near(abs(factors[0]), np.sqrt(10 ** (value["level_dbc"] / 10) * wanted_power(model)), 0)
    elif family == "lo_leakage":
        assert near(abs(factors[0]), 10 ** (value["level_dbc"] / 20), 0)
    elif family == "iq_imbalance":
        assert near(abs(factors[0] / main), 10 ** (-value["image_rejection_db"] / 20), 0)
    elif family == "power_supply_hum":
        assert near(np.hypot(*factors[:2].real), value["depth"], 0)
    elif family == "second_transmitter":
        assert near(abs(factors[0]), 10 ** (value["gain_db"] / 20), 0)


def wanted_power(model):
    quiet = [e for e in effects_of(model) if e["family"] not in ("tone_interference", "dc_offset")]
    kept = model.index
    if not model.repeat:
        model.index = np.sort(np.random.default_rng(2).choice(model.n, 400, replace=False))
    wanted, _ = model.columns(quiet)
    model.index = kept
    return np.mean(np.abs(wanted) ** 2)


def predicted(model, later=0.0):
    """The contract's prediction on every sample, with a carrier offset that the twin lists."""
    n = np.arange(model.n)
    total = np.zeros(model.n, complex)
    length = len(model.x) if model.repeat else model.n + len(model.x) + 6000
    line = np.fft.fft(model.x, length)
    f = np.fft.fftfreq(length)
    for tap in model.twin["links"][0]["taps"]:
        d = model.fit["delay_samples"] + tap["delay_s"] * model.rate + later
        x = np.fft.ifft(line * np.exp(-2j * np.pi * f * d))[n % length]
        turned = tap["phase_rad"] + 2 * np.pi * tap["doppler_hz"] * n / model.rate
        total += 10 ** (tap["gain_db"] / 20) * np.exp(1j * turned) * x
    for e in model.twin["effects"]:
        assert e["family"] == "carrier_frequency_offset"
        total *= np.exp(2j * np.pi * e["parameters"]["offset_hz"]["value"] * n / model.rate)
    return total * model.twin["nodes"]["tx1"]["amplitude"] * model.fit["gain"] * np.exp(1j * model.fit["phase_rad"])


def left_by(model):
    """Residual after gain, phase and delay."""
    later = 0.0
    for _ in range(20):
        p = predicted(model, later)
        d = (predicted(model, later + 0.02) - predicted(model, later - 0.02)) / 0.04
        c = np.vdot(p, model.y) / np.vdot(p, p)
        r = model.y - c * p
        d = c * d
        d -= p * np.vdot(p, d) / np.vdot(p, p)
        step = np.vdot(d, r).real / np.vdot(d, d).real
        later += float(np.clip(step, -0.7, 0.7))
        if abs(step) < 1e-3:
            break
    return r - step * d


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("family", ENERGIES)
def test_lambda_is_the_energy_left_over_the_noise(world, family, tmp_path):
    folder, truth = made(world, tmp_path, family, seed=5)
    model = Model(folder, truth, 50)
    left = left_by(model)
    shown = (np.sum(np.abs(left) ** 2) - model.n * model.floor) / model.floor
    lam = truth["effects"][0]["lambda"]
    share = 0.6 if family == "adc_clipping" else 0.1  # rails take part of the noise too
    assert abs(shown - lam) < share * lam + 8 * np.sqrt(lam) + 40
    assert 10 * np.log10(np.mean(np.abs(left) ** 2) / model.power) == pytest.approx(truth["fit"][0]["twin_nmse_db"], abs=0.1)


@pytest.mark.parametrize(
    "world, seed", [*((w, [31, k]) for w in WORLDS for k in (1, 2, 3, 4)), ("space", [897521454, 0, sum(b"space")])]
)
def test_a_null_leaves_the_noise_that_its_twin_states(world, seed, tmp_path):
    rng = np.random.default_rng(seed)
    truth = MODULES[world].draw(rng, "null", tmp_path / "case")
    model = Model(tmp_path / "case", truth, 600)
    effects = model.twin["effects"]
    ratio, main, _, _ = model.fitted(effects)
    assert truth["effects"] == []
    refined = any(p["std"] > 0 for e in effects for p in e["parameters"].values())
    assert abs(ratio - 1) < 5 / np.sqrt(len(model.index)) + (3.0 if refined else 0.03)
    if "noise" in model.twin:
        assert 10 * np.log10(model.floor) == pytest.approx(model.twin["noise"]["rx1"]["power_db"], abs=0.15)


@pytest.mark.parametrize("world", WORLDS)
def test_noise_laws_hold_in_the_residual(world, tmp_path):
    folder, truth = made(world, tmp_path, "noise_floor", 2)
    model = Model(folder, truth, 20)
    r = left_by(model)
    change = truth["effects"][0]["parameters"]["change_db"]["value"]
    assert 10 * np.log10(np.mean(np.abs(r) ** 2)) == pytest.approx(model.twin["noise"]["rx1"]["power_db"] + change, abs=0.15)

    folder, truth = made(world, tmp_path, "signal_dependent_noise", 2)
    model = Model(folder, truth, 20)
    r, e = np.abs(left_by(model)) ** 2, np.abs(predicted(model)) ** 2
    a = np.stack([np.ones(model.n), e / np.mean(e)], 1)
    weight = 1 / np.maximum(a @ np.linalg.lstsq(a, r, rcond=None)[0], 1e-3 * np.mean(r)) ** 2
    cov = np.linalg.inv((a.T * weight) @ a)
    flat, slope = cov @ (a.T * weight) @ r
    want = 10 ** (truth["effects"][0]["parameters"]["slope_db"]["value"] / 10)
    assert abs(slope / flat - want) < 6 * np.sqrt(cov[1, 1]) / flat + 0.05 * want

    folder, truth = made(world, tmp_path, "narrowband_interference", 2)
    model = Model(folder, truth, 20)
    s = np.abs(np.fft.fft(left_by(model))) ** 2 / model.n**2
    f, p = np.fft.fftfreq(model.n, 1 / model.rate), truth["effects"][0]["parameters"]
    inside = np.abs(f - p["frequency_hz"]["value"]) < p["bandwidth_hz"]["value"]
    outside = np.mean(s[~inside])
    got = np.sum(s[inside]) - outside * np.sum(inside)
    want = 10 ** (p["power_dbc"]["value"] / 10) * np.mean(np.abs(predicted(model)) ** 2)
    assert got == pytest.approx(want, rel=0.25)

    folder, truth = made(world, tmp_path, "pulsed_interference", 2)
    model = Model(folder, truth, 20)
    p = {k: v["value"] for k, v in truth["effects"][0]["parameters"].items()}
    want = 10 ** (p["power_dbc"] / 10) * p["duty_cycle"] * np.mean(np.abs(predicted(model)) ** 2)
    more = np.mean(np.abs(left_by(model)) ** 2) - model.floor
    assert more == pytest.approx(want, rel=0.3, abs=4 * model.floor / np.sqrt(model.n))


@pytest.mark.parametrize("world", WORLDS)
def test_converters_are_as_stated(world, tmp_path):
    folder, truth = made(world, tmp_path, "adc_clipping", 1)
    y, level = sigmf(folder, "recording"), truth["effects"][0]["parameters"]["level"]["value"]
    parts = np.abs(np.concatenate([y.real, y.imag]))
    assert parts.max() == pytest.approx(level, abs=3e-5) and np.sum(parts > level - 3e-5) > 1
    folder, truth = made(world, tmp_path, "quantization", 1)
    y, step = sigmf(folder, "recording"), truth["effects"][0]["parameters"]["step"]["value"]
    u = np.concatenate([y.real, y.imag]) / step * 2
    assert np.max(np.abs(u - np.rint(u))) < 2e-4 + 3.2e-5 / step


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("how", ["noise", "other", "faint", "blocker"])
def test_an_absent_waveform_is_nowhere(world, how, tmp_path):
    folder, truth = made(world, tmp_path, how, 1, "absent")
    twin = yaml.safe_load((folder / "twin.yaml").read_text())
    y, x = sigmf(folder, "recording"), sigmf(folder, twin["waveforms"]["w1"]["file"])
    if how == "blocker":  # its lines would hide what is sought
        s = np.fft.fft(y)
        y = np.fft.ifft(s / np.maximum(np.abs(s), 1e-12))
    length = len(x) if twin["waveforms"]["w1"]["repeat"] else len(x) + len(y)
    folded = y[: len(y) // length * length].reshape(-1, length).sum(0) if twin["waveforms"]["w1"]["repeat"] else y
    c = np.abs(np.fft.ifft(np.fft.fft(folded, length) * np.fft.fft(x, length).conj())) ** 2
    assert c.max() < 35 * c.mean()
    assert truth["kind"] == "outside" and truth["absent"] is True
    assert set(truth["tolerated"]) <= {"tone_interference", "narrowband_interference", "pulsed_interference"}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_written_read_back_and_drawn_alike(world, kind, tmp_path):
    truths = [MODULES[world].draw(np.random.default_rng(77), kind, tmp_path / run / "case_x") for run in "ab"]
    assert json.dumps(truths[0]) == json.dumps(truths[1])
    files = sorted(f.name for f in (tmp_path / "a/case_x").iterdir())
    assert files == sorted(f.name for f in (tmp_path / "b/case_x").iterdir())
    assert all((tmp_path / "a/case_x" / f).read_bytes() == (tmp_path / "b/case_x" / f).read_bytes() for f in files)
    twin, t = yaml.safe_load((tmp_path / "a/case_x/twin.yaml").read_text()), truths[0]
    keys = {
        "cast_twin",
        "sample_rate_hz",
        "center_frequency_hz",
        "waveforms",
        "nodes",
        "links",
        "recordings",
        "noise",
        "unknown",
        "effects",
    }
    assert set(twin) <= keys and twin["cast_twin"] == 1
    for r in twin["recordings"]:
        y = sigmf(tmp_path / "a/case_x", r["file"])
        assert len(y) == t["conditions"]["samples"] and np.all(np.isfinite(y)) and np.max(np.abs([y.real, y.imag])) < 4
    assert t["kind"] == {"absent": "outside"}.get(kind, kind) and t["case"] == "case_x"
    assert [f["recording"] for f in t["fit"]] == [r["file"] for r in twin["recordings"]]
    assert len(t["effects"]) == {"null": 0, "double": 2, "triple": 3}.get(kind, len(t["effects"]))
    assert (t["ambiguous"] is not None) == (kind == "ambiguous")
    for e in t["effects"]:
        assert {"family", "owner", "owners_ok", "parameters", "values", "where", "recordings", "lambda", "same_as"} == set(e)
        assert e["owner"]["name"] in e["owners_ok"] and np.isfinite(e["lambda"])
        for p in e["parameters"].values():
            assert set(p) == {"value", "z", "also", "unsigned"} and np.isfinite([p["value"], *p["also"]]).all()
        for low, high in e["where"].values():
            assert low <= high
