# SPDX-License-Identifier: GPL-3.0-or-later
"""The experiment against closed forms: bands, levels, times, and the modem alone."""

import numpy as np
import pytest
from gr_cast.blocks.frames import FrameEmulator
from gr_cast.blocks.modem import open_modem
from gr_cast.core.errors import CastError
from gr_cast.emulation import reference
from gr_cast.experiments import hall, jamming
from gr_cast.scenario import LinkTaps, Scenario
from scipy import signal
from scipy.linalg import toeplitz

RATE_HZ = 20e6
QPSK = open_modem("802.11a", "qpsk1/2")


def flat(jammer_delay_s=0.0):
    one = LinkTaps(delay_s=[[0.0]], gain=[[1e-3]])
    other = LinkTaps(delay_s=[[jammer_delay_s]], gain=[[2e-4j]])
    return Scenario(name="flat", nodes=("tx", "rx", "jammer"), links={("tx", "rx"): one, ("jammer", "rx"): other})


def setting(kind, sinr_db, scenario=None, centre_hz=0.0, snr_db=40.0, on_s=(0.0, np.inf)):
    jammer = None if kind == "none" else jamming.Jammer(bandwidth_hz=jamming.BANDWIDTH_HZ[kind], centre_hz=centre_hz, on_s=on_s)
    snr_db, sinr_db = (sinr_db, None) if jammer is None else (snr_db, sinr_db)
    return jamming.Setting(scenario=scenario or flat(), jammer=jammer, snr_db=snr_db, sinr_db=sinr_db, seed=3)


def play(s, count, payload=200, frames_per_s=20.0, modem=QPSK):
    emulator = FrameEmulator(s.scenario, s.transmitters, s.rx, RATE_HZ, s.noise_power, s.seed)
    times_s = jamming.frame_times_s(count / frames_per_s, frames_per_s, 1e-3)
    return list(jamming.frames(s, modem, emulator, times_s, payload))


class Deaf:
    """The modem for what needs no reception."""

    sample_rate_hz, name = RATE_HZ, "deaf"
    modulate = staticmethod(QPSK.modulate)

    def demodulate(self, samples):
        return []


@pytest.mark.parametrize("bandwidth_hz, centre_hz", [(156e3, 0), (156e3, 2.5e6), (10e6, 0), (5e6, -6e6)])
def test_the_jammer_has_power_one_inside_its_band_and_none_outside(bandwidth_hz, centre_hz):
    jammer = jamming.Jammer(bandwidth_hz=bandwidth_hz, centre_hz=centre_hz)
    x = jammer.samples(np.random.default_rng(1), 1 << 18, 5.0, RATE_HZ)
    f, density = signal.welch(x, RATE_HZ, nperseg=4096, return_onesided=False)
    far = np.abs(f - centre_hz) > bandwidth_hz / 2 + 40e3
    assert np.mean(np.abs(x) ** 2) == pytest.approx(1, rel=4 / np.sqrt(bandwidth_hz * len(x) / RATE_HZ))
    assert density[far].sum() < 1e-4 * density.sum()


def test_the_jammer_is_on_when_it_is_said_to_be():
    jammer = jamming.Jammer(bandwidth_hz=10e6, on_s=(1.0, 1.0001))
    x = jammer.samples(np.random.default_rng(1), 4000, 0.99995, RATE_HZ)
    on = np.flatnonzero(x)
    assert (on[0], on[-1]) == (1000, 2999)


def test_a_harmonic_is_twice_as_wide_and_as_strong_as_said():
    jammer = jamming.Jammer(bandwidth_hz=156e3, harmonic=(5e6, -10.0))
    x = jammer.samples(np.random.default_rng(2), 1 << 20, 0.0, RATE_HZ)
    f, density = signal.welch(x, RATE_HZ, nperseg=4096, return_onesided=False)
    near = np.abs(f - 5e6) < 180e3
    assert 10 * np.log10(density[near].sum() / density[np.abs(f) < 100e3].sum()) == pytest.approx(-10, abs=0.5)
    weight = density[near] / density[near].sum()
    width = np.sqrt(np.sum(weight * (f[near] - 5e6) ** 2))
    # The spectrum of the square is the band convolved with itself: its variance doubles.
    assert width == pytest.approx(np.sqrt(2) * 156e3 / np.sqrt(12), rel=0.05)


def test_a_stretch_is_what_the_reference_emulator_has_there():
    """Frames out of a run, over a channel that moves, are those of the whole run, noise and all."""
    rng = np.random.default_rng(4)
    times_s = np.arange(6) * 1e-4
    moving = LinkTaps(delay_s=np.tile([0.0, 3.3e-7], (6, 1)), gain=rng.normal(size=(6, 2)) + 1j * rng.normal(size=(6, 2)))
    still = LinkTaps(delay_s=[[1.2e-7]], gain=[[0.5j]])
    s = Scenario(name="m", nodes=("a", "b", "c"), links={("a", "b"): still, ("c", "b"): moving}, time_s=times_s)
    x = rng.normal(size=(2, 12_000)) + 1j * rng.normal(size=(2, 12_000))
    emulator = FrameEmulator(s, ["a", "c"], "b", RATE_HZ, 0.1, seed=7)
    inputs = np.zeros((3, 12_000), complex)
    inputs[[0, 2]] = x
    whole = reference.emulate(inputs, reference.scenario_updates(s, RATE_HZ), 3, noise_power=[0, 0.1, 0], seed=7)[1]
    alone = reference.emulate(inputs * [[1], [0], [0]], reference.scenario_updates(s, RATE_HZ), 3)[1]
    noise = np.sqrt(0.1) * (reference.receiver_noise(7, 0, 12_000) - reference.receiver_noise(7, 1, 12_000))
    for begin, end in ((600, 1500), (1900, 2300), (3100, 9000), (11_000, 12_000)):
        received, wanted = emulator.receive(begin, x[:, begin - emulator.past : end])
        np.testing.assert_allclose(received, whole[begin:end] + noise[begin:end], atol=1e-5 * np.abs(whole).max())
        np.testing.assert_allclose(wanted, alone[begin:end], atol=1e-5 * np.abs(whole).max())
    with pytest.raises(CastError, match="before the end 12000"):
        emulator.receive(5000, x)


@pytest.mark.parametrize("kind, centre_hz", [("none", 0), ("narrowband", 0), ("narrowband", 2.5e6), ("wideband", 0)])
@pytest.mark.parametrize("scenario", [flat(), hall.scenario("static")], ids=["flat", "hall"])
@pytest.mark.parametrize("sinr_db", [-5, 5, 15, 30])
def test_the_sinr_that_is_measured_is_the_one_that_was_set(kind, centre_hz, scenario, sinr_db):
    # A frame of a narrowband jammer is a few dozen independent samples of its noise: 40 frames bring it within 0.5 dB.
    count = 60 if kind == "narrowband" else 8
    found = play(setting(kind, sinr_db, scenario, centre_hz), count, modem=Deaf())
    measured_db = 10 * np.log10(sum(f.wanted for f in found) / sum(f.disturbance for f in found))
    assert measured_db == pytest.approx(sinr_db, abs=0.5)


def test_the_sinr_agrees_with_a_measurement_from_the_sent_samples_alone():
    """Least squares of the received on the sent samples, without knowing channel, noise or jammer."""
    s = setting("wideband", 8.0, hall.scenario("static"))
    emulator = FrameEmulator(s.scenario, s.transmitters, "rx", RATE_HZ, s.noise_power, 0)
    sent = QPSK.modulate(bytes(500))
    inputs = np.zeros((2, emulator.past + len(sent)), complex)
    inputs[0, emulator.past :] = sent
    inputs[1] = s.jammer_amplitude * s.jammer.samples(np.random.default_rng(1), inputs.shape[1], 0.0, RATE_HZ)
    received, wanted = emulator.receive(2000, inputs)
    taps = 48
    columns = toeplitz(sent, np.zeros(taps))
    fitted = columns @ np.linalg.lstsq(columns, received, rcond=1e-3)[0]
    from_sent_db = 10 * np.log10(np.sum(np.abs(fitted) ** 2) / np.sum(np.abs(received - fitted) ** 2))
    known_db = 10 * np.log10(np.sum(np.abs(wanted) ** 2) / np.sum(np.abs(received - wanted) ** 2))
    assert from_sent_db == pytest.approx(known_db, abs=0.3)


@pytest.mark.parametrize("snr_db", [3.5, 4.5, 5.5])
def test_loss_through_the_emulator_is_that_of_the_modem_alone_in_white_noise(snr_db):
    count = 80
    through = sum(not frame.delivered for frame in play(setting("none", snr_db), count))
    rng, alone = np.random.default_rng(5), 0
    for _ in range(count):
        payload = rng.bytes(200)
        sent = np.pad(QPSK.modulate(payload), 400)
        noise = np.sqrt(10 ** (-snr_db / 10) / 2) * (rng.normal(size=len(sent)) + 1j * rng.normal(size=len(sent)))
        alone += not any(packet.payload == payload for packet in QPSK.demodulate(sent + noise))
    share = (through + alone) / (2 * count)
    assert abs(through - alone) <= 3 * np.sqrt(2 * count * share * (1 - share)) + 1


def test_a_jammer_where_no_carrier_is_harms_least_and_one_on_a_carrier_most():
    """At one and the same SINR: the carrier in the middle is not used, a jammed one outvotes the others in the decoder."""
    lost = {
        name: sum(not frame.delivered for frame in play(setting(kind, 5.0, centre_hz=centre_hz), 20, payload=500))
        for name, kind, centre_hz in (("middle", "narrowband", 0), ("wide", "wideband", 0), ("carrier", "narrowband", 2.5e6))
    }
    assert lost["middle"] < lost["wide"] <= lost["carrier"] and lost["carrier"] >= 15


def test_the_time_of_the_jammer_is_found_within_a_fifth_of_a_second():
    s = setting("wideband", 3.0, hall.scenario("static"), snr_db=20.0, on_s=(3.03, 6.41))
    found = play(s, 90, payload=20, frames_per_s=10, modem=Deaf())
    first_s, last_s = jamming.interval_of_harm(np.array([f.time_s for f in found]), np.array([f.sinr_db for f in found]))
    assert first_s == pytest.approx(3.03, abs=0.2) and last_s == pytest.approx(6.41, abs=0.2)


def test_noise_alone_has_no_time_of_harm():
    rng = np.random.default_rng(6)
    assert jamming.interval_of_harm(np.arange(600) / 10, rng.normal(20, 0.3, 600)) is None


def test_series_average_powers_and_count_what_arrived():
    made = [
        jamming.Frame(time_s=t, delivered=d, wanted=w, disturbance=1.0, spectrum=np.zeros(1))
        for t, d, w in ((0.1, True, 10.0), (0.6, False, 30.0), (2.5, True, 1.0))
    ]
    columns = jamming.series(made, 1.0, 8.0)
    np.testing.assert_allclose(columns["throughput_mbit_per_s"], [4, np.nan, 8])
    np.testing.assert_allclose(columns["sinr_db"], [10 * np.log10(20), np.nan, 0], atol=1e-12)
    np.testing.assert_allclose(columns["time_s"], [0.5, 1.5, 2.5])


def test_settings_that_contradict_are_refused():
    with pytest.raises(CastError, match="a jammer adds power"):
        setting("wideband", 50.0)
    with pytest.raises(CastError, match="limit .*the saturated link"):
        jamming.frame_times_s(1, 5000, 1e-3)
    with pytest.raises(CastError, match="no link x>rx"):
        jamming.mean_gain(flat(), ("x", "rx"), 1e6)
