# SPDX-License-Identifier: GPL-3.0-or-later
"""What the diagnosis says of causes put in by closed formulas."""

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ, noise, sent_once
from gr_cast.diagnose import diagnose, read_case
from gr_cast.signals import codes, recording
from scipy import signal

PATIENCE_S = 3000.0  # the time limit has a test of its own; a busy machine decides nothing here


def named(document):
    return [e["family"] for e in document["effects"]]


def said(document, family, name):
    return next(e["parameters"][name] for e in document["effects"] if e["family"] == family)


def run(world, tmp_path, y, datatype="cf32_le"):
    return diagnose(read_case(world.write(tmp_path / "case", y, datatype)), budget_s=PATIENCE_S).document


def run_of_wave(world, tmp_path, y, datatype="cf32_le"):
    """As `run`, of a twin that has the waveform in a file."""
    folder = world.write(tmp_path / "case", y, datatype)
    recording.write(folder / "sent", world.x, sample_rate_hz=RATE_HZ)
    twin = yaml.safe_load((folder / "twin.yaml").read_text()) | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    return diagnose(read_case(folder), budget_s=PATIENCE_S).document


def test_a_true_twin_is_not_accused(world, tmp_path):
    document = run(world, tmp_path, world.noisy(world.clean()))
    assert document["verdict"] == "no_mismatch" and document["effects"] == []
    assert document["fit"]["corrected_nmse_db"] == pytest.approx(document["fit"]["noise_floor_db"], abs=0.3)


def test_a_carrier_offset_is_measured_within_its_interval(world, tmp_path):
    turn = np.exp(2j * np.pi * 7.0 * world.n / RATE_HZ)
    document = run(world, tmp_path, world.noisy(world.clean() * turn))
    assert named(document) == ["carrier_frequency_offset"]
    offset = said(document, "carrier_frequency_offset", "offset_hz")
    assert abs(offset["value"] - 7.0) < 4 * offset["std"] < 1.0


def test_a_floor_beside_a_gain_step_is_told_over_the_noise_of_the_whole_recording(world, tmp_path):
    """The contract tells the noise of a sample of the recording; nearly all of them are behind the step."""
    world.noise_rms = 0.03
    world.twin = (lambda twin: lambda: twin)(world.twin())
    world.noise_rms *= 10 ** (6 / 20) / 1.3
    y = world.noisy(world.clean()) * np.where(world.n < 130, 1.0, 1.3)
    document = run(world, tmp_path, y)
    assert sorted(named(document)) == ["gain_step", "noise_floor"]
    change = said(document, "noise_floor", "change_db")
    assert abs(change["value"] - 6) < 3 * change["std"] and abs(change["value"] - 6) < 0.3


@pytest.mark.parametrize("is_told", [True, False])
def test_noise_that_follows_is_told_over_the_floor_alone_not_over_the_steps_of_the_file(world, tmp_path, is_told):
    """A file of 8 bits adds step²/6 to the floor, here half as much as is there."""
    world.noise_rms, twin = np.sqrt(2 / 6) / 128, world.twin
    lines = np.fft.fft(world.rng.normal(size=(len(world.x), 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(len(world.x))) < 0.17)
    world.x = np.fft.ifft(lines)
    world.x *= 0.7 / np.abs(world.clean()).max()
    power = np.abs(world.clean()) ** 2
    white = world.rng.normal(size=(len(world.n), 2)) @ [1, 1j] / np.sqrt(2)
    y = world.noisy(world.clean()) + white * world.noise_rms * np.sqrt(10 * power / power.mean())
    world.twin = lambda: twin() if is_told else {k: v for k, v in twin().items() if k != "noise"}
    document = run_of_wave(world, tmp_path, y, datatype="ci8")
    assert named(document) == ["signal_dependent_noise"]
    slope = said(document, "signal_dependent_noise", "slope_db")
    assert abs(slope["value"] - 10) < 3 * slope["std"] < 1.5


def test_a_chirp_at_another_delay_is_no_carrier_offset(world, tmp_path):
    """A Zadoff-Chu sequence limited to a band, at a delay between two samples: at another delay, under an offset of one line, it
    falls on whole samples."""
    k, size, within = np.arange(1151), 1426, np.fft.fftfreq(1151, 1 / 1151).astype(int)
    lines = np.zeros(size, complex)
    lines[within] = np.fft.fft(np.exp(-1j * np.pi * 300 * k * (k + 1) / 1151))
    world.x, world.taps, world.n = np.fft.ifft(lines), [(0, 1.0)], np.arange(8_263)
    heard = np.fft.ifft(lines * np.exp(-2j * np.pi * np.fft.fftfreq(size) * 0.4))
    y = 0.3 * heard[(world.n - 37) % size]
    world.noise_rms = 0.45 * np.sqrt(np.mean(np.abs(y) ** 2))
    document = run_of_wave(world, tmp_path, y + world.noise_rms / np.sqrt(2) * world.rng.normal(size=(len(y), 2)) @ [1, 1j])
    assert document["verdict"] == "no_mismatch" and named(document) == []


@pytest.mark.parametrize("std", [0.0, 0.05])
def test_a_clock_that_the_twin_knows_of_one_radio_says_nothing_of_the_others(world, tmp_path, std):
    known = {"family": "sample_clock_offset", "owner": {"level": "tx", "name": "tx1"}}
    twin = world.twin() | {"effects": [known | {"parameters": {"offset_ppm": {"value": -3.0, "std": std}}}]}
    world.twin, size, lines = lambda: twin, len(world.x), np.fft.fft(world.x) / len(world.x)
    later = (world.n * (1 - 7e-6) - 37)[:, None] - np.array([d for d, _ in world.taps])
    paths = np.exp(2j * np.pi * np.fft.fftfreq(size) * later[..., None]) @ lines
    document = run(world, tmp_path, world.noisy(0.3 * paths @ np.array([a for _, a in world.taps])))
    assert named(document) == ["sample_clock_offset"]
    ppm = said(document, "sample_clock_offset", "offset_ppm")
    assert abs(ppm["value"] + 4.0) < 2.5 * ppm["std"] < 1.0 and ppm["std"] > std


@pytest.mark.parametrize(
    ("samples", "late", "louder"), [(1, 0, 60.0), (4, -3, 60.0), (4, -2, 60.0), (4, -2, 2.0), (4, 1, 60.0), (16, 9, 60.0)]
)
def test_noise_that_follows_the_mean_of_some_samples_is_no_other_floor(world, tmp_path, samples, late, louder):
    """`louder`: its power at mean wanted power over the floor, which the twin tells."""
    lines = np.fft.fft(world.rng.normal(size=(len(world.x), 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(len(world.x))) < 0.17)
    world.x = np.fft.ifft(lines)
    power = np.abs(world.clean()) ** 2
    follows = np.mean([np.roll(power, k) for k in np.arange(samples) + late - (samples - 1) // 2], axis=0)
    white = world.rng.normal(size=(len(world.n), 2)) @ [1, 1j] / np.sqrt(2)
    y = world.noisy(world.clean()) + white * world.noise_rms * np.sqrt(louder * follows / power.mean())
    document = run_of_wave(world, tmp_path, y)
    assert named(document) == ["signal_dependent_noise"]
    assert said(document, "signal_dependent_noise", "slope_db")["value"] == pytest.approx(10 * np.log10(louder), abs=1.0)
    model = document["effects"][0]["model"]
    assert (model["smooth_samples"], model["smooth_late_samples"]) == (samples, late)


@pytest.mark.parametrize("late", [0.5, 1.5])
def test_an_amplifier_that_remembers_what_it_bends_alone_has_no_filter(world, tmp_path, late):
    """A delayed third order (Ku and Kenney 2003), between two samples."""
    world.noise_rms = 0.03
    size = len(world.x)
    lines = np.fft.fft(world.rng.normal(size=(size, 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(size)) < 0.17)
    sent = world.x = np.fft.ifft(lines) / np.abs(np.fft.ifft(lines)).max()
    bends = np.fft.fft(sent * np.abs(sent) ** 2)
    world.x = sent - 0.1 * np.fft.ifft(bends * (1 + 0.7j * np.exp(-2j * np.pi * np.fft.fftfreq(size) * late)))
    y = world.noisy(world.clean())
    world.x = sent
    document = run_of_wave(world, tmp_path, y)
    assert named(document) == ["pa_nonlinearity"] and document["effects"][0]["parameters"]["memory"]
    assert document["effects"][0]["model"]["bent_alone"]


def test_an_amplifier_that_remembers_a_fraction_of_a_sample_is_all_there_is(world, tmp_path):
    """A quarter of one, which only many samples on either side tell, as clearly heard as here."""
    rng, size, finer, count = np.random.default_rng(2), 1847, 8, 15_000
    f = np.fft.fftfreq(size)
    symbols = rng.choice([-3, -1, 1, 3], size=(size, 2)) @ [1, 1j] * (np.arange(size) % 2 == 0)
    lines = np.fft.fft(symbols) * np.sin(np.pi / 2 * np.clip((0.3375 - abs(f)) / 0.175, 0, 1))
    zeros = np.zeros((finer - 1) * size)
    fine = finer * np.fft.ifft(np.insert(lines, (size + 1) // 2, zeros))
    sent = fine[::finer].copy()
    bends = 0.33 * fine * np.minimum(abs(fine) / abs(sent).max(), 1.3) ** 2
    fine = fine - bends - 0.6 * np.exp(-2j) * np.roll(bends, finer // 4)
    lines = np.delete(np.fft.fft(fine) / finer, np.arange(len(zeros)) + (size + 1) // 2)
    world.x, world.taps, world.n, world.rng = np.fft.ifft(lines), [(0, 1.0)], np.arange(count), rng
    world.noise_rms = 10 ** (-28 / 20) * np.sqrt(np.mean(abs(world.clean()) ** 2))
    y = world.clean() + world.noise_rms / np.sqrt(2) * rng.normal(size=(count, 2)) @ [1, 1j]
    world.x = sent
    document = run_of_wave(world, tmp_path, y)
    assert document["verdict"] == "identified" and named(document) == ["pa_nonlinearity"]


def test_a_drift_that_the_twin_rules_out_is_found_beside_an_offset_that_it_leaves_open(world, tmp_path):
    seconds = world.n / RATE_HZ
    drift_hz_per_s = -0.6 / seconds[-1] ** 2
    told = {"offset_hz": {"value": 300.0, "std": 40.0}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
    own = {"family": "carrier_frequency_offset", "owner": {"level": "rx", "name": "rx1"}, "parameters": told}
    world.twin = (lambda twin: lambda: twin)(world.twin() | {"effects": [own]})
    for drifts in (0.0, drift_hz_per_s):
        turn = np.exp(2j * np.pi * (311.0 * seconds + 0.5 * drifts * seconds**2))
        document = run(world, tmp_path / str(drifts), world.noisy(world.clean() * turn))
        assert named(document) == (["carrier_frequency_offset"] if drifts else [])
    found = said(document, "carrier_frequency_offset", "drift_hz_per_s")
    assert abs(found["value"] - drift_hz_per_s) < 4 * found["std"] < 0.2 * abs(drift_hz_per_s)
    offset = said(document, "carrier_frequency_offset", "offset_hz")  # which the twin's own leaves open
    assert abs(offset["value"] - 11.0) < 40.0 == pytest.approx(offset["std"], rel=0.1)


@pytest.mark.parametrize("offset_hz", [-23e3, 9e3])
@pytest.mark.parametrize("side", ["tx", "rx"])
def test_late_paths_tell_whose_a_large_offset_is_and_its_sign(world, tmp_path, side, offset_hz):
    turn = lambda n: np.exp(2j * np.pi * offset_hz * n / RATE_HZ)  # noqa: E731
    paths = [(a * world.path(d), world.n - d * (side == "tx")) for d, a in world.taps]
    document = run(world, tmp_path, world.noisy(0.3 * sum(y * turn(when) for y, when in paths)))
    assert named(document) == ["carrier_frequency_offset"]
    assert document["effects"][0]["owner"]["level"] == side
    offset = said(document, "carrier_frequency_offset", "offset_hz")
    assert abs(offset["value"] - offset_hz) < 4 * offset["std"] < 2.0


@pytest.mark.parametrize("side", ["tx", "rx"])
def test_a_fast_hum_is_on_the_side_that_late_paths_and_noise_tell(world, tmp_path, side):
    hum = lambda n: 1 + 0.08 * np.cos(2 * np.pi * 151.3 * n / len(world.n) + 1)  # noqa: E731
    if side == "tx":
        y = world.noisy(0.3 * sum(a * world.path(d) * hum(world.n - d) for d, a in world.taps))
    else:
        y = world.noisy(world.clean()) * hum(world.n)
    document = run(world, tmp_path, y)
    assert named(document) == ["power_supply_hum"]
    assert document["effects"][0]["owner"]["level"] == side
    assert said(document, "power_supply_hum", "depth")["value"] == pytest.approx(0.08, abs=0.002)


@pytest.mark.parametrize(
    "cause", ["phase_noise", "front_end_filter", "tone_interference", "narrowband_interference", "diffuse_tail"]
)
def test_behind_an_inversion_other_causes_are_what_they_are(world, tmp_path, cause):
    y, n, rng = world.clean(), len(world.n), world.rng
    if cause == "phase_noise":
        y = y * np.exp(0.2j * np.convolve(rng.normal(size=n), np.hanning(600) / 15, "same"))
    elif cause == "front_end_filter":
        y = np.convolve(y, [0.0, 1.0, 0.2 - 0.15j, -0.1j])[:n]
    elif cause == "diffuse_tail":
        tail = np.exp(-np.arange(40) / 24) * (rng.normal(size=40) + 1j * rng.normal(size=40)) * 0.05
        y = np.convolve(y, np.concatenate([[1.0], tail]))[:n]
    elif cause == "tone_interference":
        y = y + 0.02 * np.exp(2j * np.pi * 0.21 * world.n)
    else:
        band = np.abs(np.fft.fftfreq(n) - 0.21) < 0.02
        y = y + np.fft.ifft(band * np.fft.fft(rng.normal(size=n) + 1j * rng.normal(size=n))) * 0.1
    document = run(world, tmp_path, np.conj(world.noisy(y)))
    assert set(named(document)) == {"spectral_inversion", cause}
    if cause.endswith("_interference"):  # told as recorded
        assert said(document, cause, "frequency_hz")["value"] == pytest.approx(-0.21 * RATE_HZ, abs=0.01 * RATE_HZ)
    else:
        assert document["fit"]["corrected_nmse_db"] < document["fit"]["noise_floor_db"] + 1.0


def test_an_echo_is_placed_on_the_scale_of_the_taps(world, tmp_path):
    echo = 0.3 * np.exp(0.4j) * 0.1 * np.exp(1j) * world.path(23)
    document = run(world, tmp_path, world.noisy(world.clean() + echo))
    assert named(document) == ["extra_path"]
    assert said(document, "extra_path", "delay_s")["value"] == pytest.approx(23 / RATE_HZ, abs=2e-8)
    assert said(document, "extra_path", "gain_db")["value"] == pytest.approx(-20.0, abs=0.3)
    low, high = document["effects"][0]["where"]["delay_s"]
    assert low < 23 / RATE_HZ < high


def test_a_path_that_is_gone_is_called_missing(world, tmp_path):
    gone, world.taps = world.taps[1], [*world.taps, (17, 0.3 * np.exp(2j))]
    y = world.clean() - 0.3 * np.exp(0.4j) * gone[1] * world.path(gone[0])
    document = run(world, tmp_path, world.noisy(y))
    assert named(document) == ["missing_path"]
    assert said(document, "missing_path", "delay_s")["value"] == pytest.approx(9e-6)


def test_dc_with_a_carrier_offset_in_the_twin_is_dc_and_not_leakage(world, tmp_path):
    y = world.clean() * np.exp(2j * np.pi * 180 * world.n / RATE_HZ)
    level = 0.01 * np.sqrt(np.mean(np.abs(y) ** 2)) * 3
    folder = world.write(tmp_path / "case", world.noisy(y + level * np.exp(2j)))
    twin = (folder / "twin.yaml").read_text()
    owner = "owner: {level: rx, name: rx1}"
    value = "parameters: {offset_hz: {value: 180.0, std: 0}}"
    offset = f"effects: [{{family: carrier_frequency_offset, {owner}, {value}}}]\n"
    (folder / "twin.yaml").write_text(twin + offset)
    document = diagnose(read_case(folder), budget_s=PATIENCE_S).document
    assert named(document) == ["dc_offset"]
    assert said(document, "dc_offset", "level_dbc")["value"] == pytest.approx(20 * np.log10(0.03), abs=0.5)


def test_noise_that_a_receiver_colours_beside_the_signal_is_no_mismatch(world, tmp_path):
    """A low-pass far outside the band of a narrow waveform: the wanted signal passes as it is."""
    code = np.repeat(np.sign(world.rng.normal(size=50)), 16)
    wave = signal.lfilter(signal.firwin(127, 0.08), 1, np.resize(code, 4000)).astype(np.complex64)[2400:3200]
    world.x = wave
    noise = world.noisy(np.zeros(len(world.n)))
    coloured = signal.filtfilt(*signal.butter(2, 0.75), noise)
    document = run_of_wave(world, tmp_path, world.clean() + coloured)
    assert document["verdict"] == "no_mismatch" and document["effects"] == []


def test_rails_are_found_to_the_last_bit(world, tmp_path):
    y = world.noisy(world.clean())
    document = run(world, tmp_path, np.clip(y.real, -0.3, 0.3) + 1j * np.clip(y.imag, -0.3, 0.3))
    assert named(document) == ["adc_clipping"]
    assert said(document, "adc_clipping", "level")["value"] == pytest.approx(0.3, abs=1e-5)


def leaning(world):
    """The world with one path and a waveform that is far from zero at one end alone."""
    world.taps = world.taps[:1]
    world.x = (signal.lfilter(signal.firwin(31, 0.3), 1, np.resize(world.x, 4000))[2400:3200] + 0.5).astype(np.complex64)
    return world.clean()


def test_rails_at_one_end_are_found(world, tmp_path):
    y = world.noisy(leaning(world))
    level = np.quantile(y.real, 0.98)
    document = run_of_wave(world, tmp_path, np.minimum(y.real, level) + 1j * y.imag)
    assert document["verdict"] == "identified" and named(document) == ["adc_clipping"]


def test_rails_that_noise_softens_are_no_amplifier(world, tmp_path):
    world.x = signal.lfilter(signal.firwin(31, 0.3), 1, np.resize(world.x, 4000))[2400:3200].astype(np.complex64)
    world.taps = world.taps[:1]
    world.noise_rms = 0.3 * np.sqrt(np.mean(np.abs(world.clean()) ** 2))
    y = world.noisy(world.clean())
    level = np.quantile(np.abs(y.real), 0.9)
    document = run_of_wave(world, tmp_path, np.clip(y.real, -level, level) + 1j * np.clip(y.imag, -level, level))
    assert document["verdict"] == "identified" and named(document) == ["adc_clipping"]


def test_a_gain_step_is_found_at_its_moment(world, tmp_path):
    y = world.clean() * np.where(world.n < 13_000, 1.0, 10 ** (-0.2 / 20))
    document = run(world, tmp_path, world.noisy(y))
    assert named(document) == ["gain_step"]
    assert said(document, "gain_step", "time_s")["value"] == pytest.approx(0.013, abs=1e-4)
    assert said(document, "gain_step", "step_db")["value"] == pytest.approx(-0.2, abs=0.03)


def test_lost_samples_are_counted_modulo_the_period(world, tmp_path):
    y = world.clean()
    y = np.concatenate([y[:8000], y[8040:], world.clean()[:40] * 0])[: len(y)]
    document = run(world, tmp_path, world.noisy(y))
    assert "sample_loss" in named(document)
    assert said(document, "sample_loss", "samples")["value"] % 510 == 40


def test_more_noise_than_the_twin_says_is_a_noise_floor_where_the_power_is_not_constant(world, tmp_path):
    world.noise_rms *= 1.2
    y = world.noisy(world.clean())
    world.noise_rms /= 1.2
    document = run(world, tmp_path, y)
    assert named(document) == ["noise_floor"]
    assert said(document, "noise_floor", "change_db")["value"] == pytest.approx(20 * np.log10(1.2), abs=0.15)


def test_a_recording_for_the_vault_is_predicted_and_never_fitted(world, tmp_path):
    turn = np.exp(2j * np.pi * 7.0 * world.n / RATE_HZ)
    folder = world.write(tmp_path / "case", world.noisy(world.clean() * turn))
    recording.write(folder / "second", world.noisy(world.clean() * turn)[:15_000], sample_rate_hz=RATE_HZ)
    twin = world.twin()
    twin["recordings"].append({"file": "second", "receiver": "rx1", "transmitters": ["tx1"], "use": "vault"})
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    document = diagnose(read_case(folder), budget_s=PATIENCE_S).document
    assert [e["where"]["recording"] for e in document["effects"]] == ["recording"]
    fit = document["fit"]
    assert fit["twin_nmse_db"] > fit["noise_floor_db"] + 1
    assert fit["corrected_nmse_db"] == pytest.approx(fit["noise_floor_db"], abs=0.3)


def network(world, tmp_path, factor, converted=lambda rx, y: y):
    """The diagnosis of two transmitters that two receivers hear one by one, each link times factor(transmitter), asked anew for
    every recording, and each recording as `converted(receiver, y)`."""
    names = [(tx, rx) for tx in ("tx1", "tx2") for rx in ("rx1", "rx2")]
    folder = world.write(tmp_path / "case", world.noisy(world.clean()))
    twin = world.twin()
    link = twin["links"][0]
    twin["nodes"] = {"tx1": {"transmit": "w1"}, "tx2": {"transmit": "w1"}, "rx1": {}, "rx2": {}}
    twin["noise"]["rx2"] = twin["noise"]["rx1"]
    twin["links"] = [{**link, "tx": tx, "rx": rx} for tx, rx in names]
    files = [f"{tx}_{rx}" for tx, rx in names]
    twin["recordings"] = [
        {"file": file, "receiver": rx, "transmitters": [tx]} for file, (tx, rx) in zip(files, names, strict=True)
    ]
    for file, (tx, rx) in zip(files, names, strict=True):
        y = converted(rx, world.noisy(world.clean() * factor(tx)))
        recording.write(folder / file, y, sample_rate_hz=RATE_HZ)
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    return diagnose(read_case(folder), budget_s=PATIENCE_S).document


def test_an_owner_is_the_node_whose_recordings_show_the_effect(world, tmp_path):
    document = network(world, tmp_path, lambda tx: np.exp(2j * np.pi * 6.0 * (tx == "tx2") * world.n / RATE_HZ))
    assert named(document) == ["carrier_frequency_offset"]
    assert document["effects"][0]["owner"] == {"level": "tx", "name": "tx2"}
    assert document["effects"][0]["where"]["recording"] == ["tx2_rx1", "tx2_rx2"]


def test_a_fine_grid_is_its_receivers_though_no_fit_gains_by_it(world, tmp_path):
    step = world.noise_rms / 14
    document = network(
        world,
        tmp_path,
        lambda tx: 1.0,
        lambda rx, y: y if rx == "rx1" else step * (np.round(y.real / step) + 1j * np.round(y.imag / step)),
    )
    assert named(document) == ["quantization"]
    assert document["effects"][0]["owner"] == {"level": "rx", "name": "rx2"}


@pytest.mark.parametrize("steps_of_noise", [1.5, 4.0])
def test_the_dither_of_a_grid_is_no_other_floor(world, tmp_path, steps_of_noise):
    """Uniform dither over one step before a mid-rise converter (Gray and Stockham 1993)."""
    world.noise_rms, step = 0.05, 0.05 / steps_of_noise
    y = world.noisy(world.clean())
    dithered = (np.stack([y.real, y.imag]) + step * world.rng.uniform(-0.5, 0.5, (2, len(y)))) / step
    document = run(world, tmp_path, step * np.array([1, 1j]) @ (np.floor(dithered) + 0.5))
    assert named(document) == ["quantization"]


@pytest.mark.parametrize(("gain", "steps_of_noise"), [(0.35, 0.15), (0.35, 0.3), (0.5, 0.15), (0.5, 0.3)])
def test_a_dither_that_hides_how_coarse_a_grid_is_is_no_law_of_the_noise(world, tmp_path, gain, steps_of_noise):
    """Its error is ± half a step amid two points of the grid and none on a point, so that it follows a signal of few levels."""
    y, step = world.noisy(gain * world.clean()), world.noise_rms / steps_of_noise
    dithered = (np.stack([y.real, y.imag]) + step * world.rng.uniform(-0.5, 0.5, (2, len(y)))) / step
    document = run(world, tmp_path, step * np.array([1, 1j]) @ np.round(dithered))
    assert named(document) == ["quantization"] and document["verdict"] == "identified"


def test_a_small_step_whose_moment_no_recording_tells_well_is_one_step(world, tmp_path):
    document = network(world, tmp_path, lambda tx: np.where((tx == "tx1") & (world.n >= 6000), 10 ** (-0.06 / 20), 1.0))
    assert named(document) == ["gain_step"]
    assert document["effects"][0]["where"]["recording"] == ["tx1_rx1", "tx1_rx2"]
    moment = said(document, "gain_step", "time_s")
    assert all(abs(m["value"] - 0.006) < 4 * m["std"] for m in moment.get("per_recording", {"": moment}).values())


def test_the_wander_of_one_oscillator_is_no_offset_where_it_happens_to_be_slow(world, tmp_path):
    walk = np.random.default_rng(3)
    course = lambda: np.cumsum(walk.normal(size=len(world.n))) * 4e-5  # noqa: E731
    document = network(world, tmp_path, lambda tx: np.exp(1j * course()) if tx == "tx1" else 1.0)
    assert named(document) == ["phase_noise"]
    assert document["effects"][0]["owner"] == {"level": "tx", "name": "tx1"}


def test_a_band_of_noise_beside_a_senders_filter_is_not_the_colour_of_a_receivers(world, tmp_path):
    world.noise_rms = 0.03
    y, band = world.clean(), signal.firwin(401, 0.02)
    y = y + 0.1 * np.roll(y, 1) - 0.06 * np.roll(y, 2)
    interference = signal.lfilter(band, 1, world.noisy(np.zeros(len(world.n))))
    interference *= 0.012 / np.sqrt(np.mean(np.abs(interference) ** 2)) * np.exp(2j * np.pi * 0.1 * world.n)
    document = run(world, tmp_path, world.noisy(y) + interference)
    assert sorted(named(document)) == ["front_end_filter", "narrowband_interference"]
    assert said(document, "narrowband_interference", "frequency_hz")["value"] == pytest.approx(1e5, abs=3e3)


def test_dc_and_leakage_stay_open_without_a_carrier_offset(world, tmp_path):
    y = world.clean()
    document = run(world, tmp_path, world.noisy(y + 0.02 * np.exp(1j)))
    assert document["verdict"] == "ambiguous"
    families = {frozenset(a["families"]) for a in document["ambiguous"]}
    assert frozenset({"dc_offset", "lo_leakage"}) in families
    assert document["ambiguous"][0]["record_next"] in ("offset_carrier", "mute_transmitter", "second_link")


@pytest.mark.parametrize("datatype", ["ci8", "cu8", "ci16_le"])
def test_the_grid_of_the_file_itself_is_no_finding(world, tmp_path, datatype):
    world.noise_rms = 0.02
    document = run(world, tmp_path, world.noisy(world.clean()), datatype)
    assert "quantization" not in named(document)


def test_dc_is_told_relative_to_the_wanted_signal_however_late_that_is_found(world, tmp_path):
    turn = np.exp(2j * np.pi * 400.0 * world.n / RATE_HZ)  # eight turns: before they are found, all but nothing is wanted
    y = world.clean() * turn
    dc = 0.05 * np.exp(2.0j)
    document = run(world, tmp_path, world.noisy(y + dc))
    assert set(named(document)) == {"carrier_frequency_offset", "dc_offset"}
    want = 20 * np.log10(abs(dc) / np.sqrt(np.mean(np.abs(y) ** 2)))
    assert said(document, "dc_offset", "level_dbc")["value"] == pytest.approx(want, abs=0.1)


def test_a_small_doppler_of_a_tap_is_no_error_of_its_phase(world, tmp_path):
    world.taps = [*world.taps, (23, 0.4 * np.exp(-2j))]
    turn = np.exp(2j * np.pi * 0.3 * world.n / RATE_HZ)
    y = world.clean() + 0.3 * np.exp(0.4j) * world.taps[1][1] * (turn - 1) * world.path(9)
    document = run(world, tmp_path, world.noisy(y))
    assert document["verdict"] == "identified" and named(document) == ["tap_doppler"]
    doppler = said(document, "tap_doppler", "doppler_hz")
    assert abs(doppler["value"] - 0.3) < 4 * doppler["std"] < 0.3


def test_a_small_error_of_a_taps_phase_is_no_doppler(world, tmp_path):
    world.taps = [*world.taps, (23, 0.4 * np.exp(-2j))]
    y = world.clean() + 0.3 * np.exp(0.4j) * world.taps[1][1] * (np.exp(0.008j) - 1) * world.path(9)
    document = run(world, tmp_path, world.noisy(y))
    assert document["verdict"] == "identified" and named(document) == ["tap_gain_error"]
    error = said(document, "tap_gain_error", "error_rad")
    assert abs(error["value"] - 0.008) < 4 * error["std"] < 0.004


def test_a_doppler_of_a_tap_whose_phase_is_another_too_is_one_cause(world, tmp_path):
    world.taps = [*world.taps, (23, 0.4 * np.exp(-2j))]
    turn = np.exp(2j * np.pi * 3.0 * world.n / RATE_HZ + 0.5j)
    y = world.clean() + 0.3 * np.exp(0.4j) * world.taps[1][1] * (turn - 1) * world.path(9)
    document = run(world, tmp_path, world.noisy(y))
    assert document["verdict"] == "identified" and named(document) == ["tap_doppler"]
    assert abs(document["effects"][0]["model"]["phase_rad"] - 0.5) < 0.02


def test_an_echo_that_moves_may_be_another_transmitter_of_the_same_code(world, tmp_path):
    world.taps = world.taps[:1]
    echo = 0.3 * np.exp(1.4j) * 0.03 * world.path(23) * np.exp(2j * np.pi * 4.0 * world.n / RATE_HZ)
    folder = world.write(tmp_path / "case", world.noisy(world.clean() + echo))
    twin = yaml.safe_load((folder / "twin.yaml").read_text())
    twin["waveforms"]["w9"] = twin["waveforms"]["w1"]
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    document = diagnose(read_case(folder), budget_s=PATIENCE_S).document
    assert [set(a["families"]) for a in document["ambiguous"]] == [{"extra_path", "second_transmitter"}]


@pytest.mark.parametrize(("samples_per_chip", "found"), [(1, []), (2, ["tone_interference"])])
def test_a_line_at_half_the_rate_is_a_tone_where_the_signal_has_nothing(world, tmp_path, samples_per_chip, found):
    world.code["samples_per_chip"] = samples_per_chip
    world.x = codes.from_spec(world.code).astype(complex)
    line = world.noise_rms * np.sqrt(80 / len(world.n)) * np.exp(2j * np.pi * 0.4996 * world.n)
    assert named(run(world, tmp_path, world.noisy(world.clean() + line))) == found


def test_a_long_tail_is_told_with_its_decay_and_is_no_row_of_echoes(world, tmp_path):
    k, rng = np.arange(110), world.rng
    gains = np.exp(-k / 44) * (rng.normal(size=110) + 1j * rng.normal(size=110))  # the power falls by e in 22 samples
    gains *= 0.15 / np.sqrt(np.sum(np.abs(gains) ** 2))
    tail = 0.3 * np.exp(0.4j) * sum(g * world.path(d) for d, g in zip(3 + k, gains, strict=True))
    document = run(world, tmp_path, world.noisy(world.clean() + tail))
    assert named(document) == ["diffuse_tail"] and document["verdict"] == "identified"
    power, decay = said(document, "diffuse_tail", "power_db"), said(document, "diffuse_tail", "decay_s")
    assert power["value"] == pytest.approx(20 * np.log10(0.15), abs=2 * power["std"])
    assert decay["value"] == pytest.approx(22 / RATE_HZ, abs=2 * decay["std"])
    assert decay["std"] < 0.25 * decay["value"]


@pytest.mark.parametrize("cycles", [1.6, 37.3])
def test_a_hum_with_harmonics_is_one_hum_with_the_frequency_of_its_fundamental(world, tmp_path, cycles):
    t = 2 * np.pi * cycles * world.n / len(world.n)
    hum = 1 + 0.02 * np.cos(t + 1) + 0.008 * np.cos(2 * t - 0.5) + 0.005 * np.cos(3 * t + 2)
    document = run(world, tmp_path, world.noisy(world.clean()) * hum)
    assert named(document) == ["power_supply_hum"] and document["verdict"] == "identified"
    frequency, depth = said(document, "power_supply_hum", "frequency_hz"), said(document, "power_supply_hum", "depth")
    assert frequency["value"] == pytest.approx(cycles * RATE_HZ / len(world.n), abs=4 * frequency["std"])
    assert depth["value"] == pytest.approx(0.02, abs=4 * depth["std"])


def test_a_hum_with_every_other_harmonic_has_the_frequency_of_its_own_fundamental(tmp_path):
    """Half of it explains as much, and is no fundamental: nothing hums there."""
    rng, count, cycles = np.random.default_rng(4), 15_000, 7.92
    sent = np.fft.ifft(np.fft.fft(noise(rng, count)) * (np.abs(np.fft.fftfreq(count)) < 0.3))
    t = 2 * np.pi * cycles * np.arange(count) / count
    hum = 1 + 0.3 * np.cos(t + 2) + 0.09 * np.cos(2 * t - 0.5)
    clock = np.interp(np.arange(count) * (1 + 7e-6), np.arange(count), sent.real)
    clock = clock + 1j * np.interp(np.arange(count) * (1 + 7e-6), np.arange(count), sent.imag)
    case = sent_once(tmp_path, clock * hum + noise(rng, count, 0.1), sent)
    document = diagnose(case).document
    assert said(document, "power_supply_hum", "frequency_hz")["value"] == pytest.approx(cycles * RATE_HZ / count, rel=0.01)
    assert said(document, "power_supply_hum", "depth")["value"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("sweep", [0.0, 1.5e-4])
def test_pulses_of_a_wave_below_the_noise_are_pulses_and_no_band_of_noise(world, tmp_path, sweep):
    period, first, width = 1733.0, 210.0, 160
    into = (world.n - first) % period
    phase = np.exp(2j * np.pi * world.rng.random(20))[((world.n - first) // period).astype(int)]
    wave = (into < width) * phase * np.exp(2j * np.pi * (0.17 * world.n + 0.5 * sweep * (into - width / 2) ** 2))
    document = run(world, tmp_path, world.noisy(world.clean() + 0.006 * wave))  # −4 dB of the noise while on
    assert named(document) == ["pulsed_interference"] and document["verdict"] == "identified"
    told = {name: said(document, "pulsed_interference", name) for name in ("period_s", "duty_cycle", "power_dbc")}
    wanted_db = 10 * np.log10(np.mean(np.abs(world.clean()) ** 2))
    true = {"period_s": period / RATE_HZ, "duty_cycle": width / period, "power_dbc": 20 * np.log10(0.006) - wanted_db}
    for name, value in true.items():
        assert told[name]["value"] == pytest.approx(value, abs=3 * told[name]["std"])
    assert told["duty_cycle"]["std"] < 0.2 * true["duty_cycle"]


def test_a_single_path_may_fade(world, tmp_path):
    world.taps = world.taps[:1]
    rng, t = world.rng, np.arange(len(world.n)) / len(world.n)
    gaussian = lambda n: (rng.normal(size=n) + 1j * rng.normal(size=n)) / np.sqrt(2)  # noqa: E731
    turns, angles = gaussian(24), rng.uniform(0, 2 * np.pi, 24)
    scattered = sum(a * np.exp(2j * np.pi * 6 * np.cos(b) * t) for a, b in zip(turns, angles, strict=True)) / np.sqrt(24)
    document = run(world, tmp_path, world.noisy(world.clean() * (1 + 0.15 * scattered)))
    assert named(document) == ["tap_fading"] and document["verdict"] == "identified"
    k_factor = said(document, "tap_fading", "k_factor_db")
    assert k_factor["value"] == pytest.approx(-20 * np.log10(0.15), abs=3 * k_factor["std"] + 2.0)


def test_a_path_at_another_delay_that_turns_otherwise_is_told_by_its_delay_and_its_doppler(world, tmp_path):
    f = np.fft.fftfreq(510)
    late = np.fft.ifft(np.fft.fft(world.x) * np.exp(-2j * np.pi * f * 0.4))
    moved = late[(world.n - 9 - 37) % 510] * np.exp(2j * np.pi * 1.7 * world.n / len(world.n))
    y = 0.3 * np.exp(0.4j) * (world.path(0) + world.taps[1][1] * moved)
    document = run(world, tmp_path, world.noisy(y))
    assert sorted(named(document)) == ["tap_delay_error", "tap_doppler"]
    error, doppler = said(document, "tap_delay_error", "error_s"), said(document, "tap_doppler", "doppler_hz")
    assert error["value"] == pytest.approx(0.4 / RATE_HZ, abs=4 * error["std"] + 0.02 / RATE_HZ)
    assert doppler["value"] == pytest.approx(1.7 * RATE_HZ / len(world.n), abs=4 * doppler["std"])


def test_an_image_far_below_a_radios_usual_one_is_told_where_the_data_carry_it(world, tmp_path):
    world.noise_rms = 1e-4
    y = world.clean() * np.exp(2j * np.pi * 2.3 * world.n / len(world.n))  # a carrier turns the signal against its image
    beta = 10 ** (-62 / 20) * np.exp(1j)
    document = run(world, tmp_path, world.noisy(y + beta * np.conj(y)))
    assert sorted(named(document)) == ["carrier_frequency_offset", "iq_imbalance"]
    assert said(document, "iq_imbalance", "image_rejection_db")["value"] == pytest.approx(62.0, abs=1.0)


@pytest.mark.parametrize(("seed", "in_decibels"), [(1, False), (2, True)])
def test_a_drift_that_a_burst_shows_in_part_holds_both_laws_in_its_interval(tmp_path, seed, in_decibels):
    """A third of the recording; evenly in decibels or in amplitude differ by a parabola of 0.03 dB there, and 0.4 dB in all."""
    rng, count = np.random.default_rng(seed), 12000
    sent, y, u = noise(rng, 4000), np.zeros(count, complex), np.arange(count) / count
    y[6000:10000] = sent
    gain = 10 ** (-4 * u / 20) if in_decibels else 1 + (10 ** (-4 / 20) - 1) * u
    (told,) = diagnose(sent_once(tmp_path, y * gain + noise(rng, count, 0.08), sent)).document["effects"]
    total_db = told["parameters"]["total_db"]
    assert abs(total_db["value"] + 4) < 2.5 * total_db["std"] < 0.6
