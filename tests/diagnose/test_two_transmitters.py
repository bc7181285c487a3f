# SPDX-License-Identifier: GPL-3.0-or-later
"""Two transmitters heard at once, as the ports of one base station are: each has a front end of its own."""

import numpy as np
import pytest
from gr_cast.diagnose import diagnose, read_case
from gr_cast.signals import recording

RATE_HZ, PERIOD, COUNT, BAND = 1e6, 1500, 4500, 0.4  # band: of the rate, to either side of the carrier
STRAIGHT, FIRST, SECOND = {0: 1.0}, {-1: 0.3j, 0: 1.0, 1: 0.5, 2: -0.2}, {-1: -0.2, 0: 1.0, 1: -0.4j, 2: 0.3 + 0.2j}


def heard(world, folder, filters) -> dict:
    """The diagnosis of two waveforms of Gaussian envelope, each sent through a filter {lag: tap}, in white noise."""
    inside = np.abs(np.fft.fftfreq(PERIOD)) < BAND
    draw = world.rng.normal(size=(2, PERIOD)) + 1j * world.rng.normal(size=(2, PERIOD))
    waves = np.fft.ifft(np.fft.fft(draw) * inside)
    sent = [sum(tap * np.roll(wave, lag + 37) for lag, tap in taps.items()) for wave, taps in zip(waves, filters, strict=True)]
    world.noise_rms = 0.03
    twin = world.twin() | {
        "waveforms": {f"w{k}": {"file": f"wave{k}", "repeat": True} for k in (1, 2)},
        "nodes": {"tx1": {"transmit": "w1"}, "tx2": {"transmit": "w2"}, "rx1": {}},
        "links": [
            {"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0}]},
            {"tx": "tx2", "rx": "rx1", "taps": [{"delay_s": 0.0}], "unknown": ["gain", "phase"]},
        ],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1", "tx2"]}],
    }
    world.twin = lambda: twin
    folder = world.write(folder, world.noisy(np.resize(0.3 * sent[0] + 0.2j * sent[1], len(world.n)))[:COUNT])
    for k, wave in enumerate(waves, 1):
        recording.write(folder / f"wave{k}", wave, sample_rate_hz=RATE_HZ)
    return diagnose(read_case(folder), budget_s=1000).document


def ripple_db(taps) -> float:
    f = np.linspace(-BAND, BAND, 4001)
    response = np.abs(sum(tap * np.exp(-2j * np.pi * f * lag) for lag, tap in taps.items()))
    return 20 * np.log10(response.max() / response.min())


@pytest.mark.parametrize("filters", [(FIRST, SECOND), (STRAIGHT, SECOND)], ids=["both", "second"])
def test_every_transmitter_heard_has_its_own_filter_and_no_amplifier(world, tmp_path, filters):
    document = heard(world, tmp_path / "case", filters)
    found = {e["owner"]["name"]: e["parameters"]["ripple_db"] for e in document["effects"]}
    assert {e["family"] for e in document["effects"]} == {"front_end_filter"}
    assert set(found) == {f"tx{k}" for k, taps in enumerate(filters, 1) if taps is not STRAIGHT}
    for name, ripple in found.items():
        assert ripple["value"] == pytest.approx(ripple_db(filters[int(name[-1]) - 1]), abs=4 * ripple["std"] + 0.1)
    assert document["fit"]["corrected_nmse_db"] == pytest.approx(document["fit"]["noise_floor_db"], abs=0.7)


def of_two_ports(world, folder, hear, gains=None, budget_s=300) -> dict:
    """The diagnosis of two waveforms of different periods, heard as `hear` adds them: with `gains` that the twin knows, else each
    of a gain and phase of its own."""
    rng, delay, twin = world.rng, 1300, world.twin()
    waves = [rng.normal(size=size) + 1j * rng.normal(size=size) for size in (701, 1203)]
    ports = [{"tx": f"tx{k}", "rx": "rx1", "taps": [{"delay_s": 0.0}], "unknown": ["gain", "phase"]} for k in (1, 2)]
    for port, gain in zip(ports, gains or (), strict=False):
        port["taps"][0] |= {"gain_db": float(20 * np.log10(abs(gain))), "phase_rad": float(np.angle(gain))}
        del port["unknown"]
    twin |= {
        "waveforms": {f"w{k}": {"file": f"wave{k}", "repeat": True} for k in (1, 2)},
        "nodes": {"tx1": {"transmit": "w1"}, "tx2": {"transmit": "w2"}, "rx1": {}},
        "links": ports,
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1", "tx2"]}],
    }
    world.twin = lambda: twin
    folder = world.write(folder, world.noisy(hear([wave[(world.n - delay) % len(wave)] for wave in waves])))
    for k, wave in enumerate(waves, 1):
        recording.write(folder / f"wave{k}", wave, sample_rate_hz=RATE_HZ)
    return diagnose(read_case(folder), budget_s=budget_s).document


def test_waveforms_of_different_periods_are_found_at_their_common_delay(world, tmp_path):
    """Each alone tells a delay within its own period; ports of no common phase are then fitted together."""
    document = of_two_ports(world, tmp_path / "case", lambda heard: 0.02 * heard[0] + 0.3j * heard[1], budget_s=100)
    assert document["verdict"] == "no_mismatch"
    assert document["fit"]["twin_nmse_db"] == pytest.approx(document["fit"]["noise_floor_db"], abs=0.3)


@pytest.mark.parametrize("off", [0, 1])
def test_a_carrier_that_is_far_off_is_that_of_the_one_transmitter_that_has_it(world, tmp_path, off):
    """Under a carrier common to both, neither delay nor phase of the one that is off is found."""
    cycles_per_sample = -0.0133
    turn = np.exp(2j * np.pi * cycles_per_sample * world.n)
    document = of_two_ports(
        world,
        tmp_path / "case",
        lambda heard: sum(
            a * one * (turn if k == off else 1.0) for k, (a, one) in enumerate(zip((0.2, 0.3j), heard, strict=True))
        ),
    )
    (told,) = document["effects"]
    assert told["family"] == "carrier_frequency_offset" and told["owner"]["name"] == f"tx{off + 1}"
    offset = told["parameters"]["offset_hz"]
    assert offset["value"] == pytest.approx(cycles_per_sample * RATE_HZ, abs=4 * offset["std"])


@pytest.mark.parametrize("cycles", [0.3, 2.3, -41.7])
def test_the_carrier_of_one_of_two_whose_phases_the_twin_knows_turns_from_the_first_sample_on(world, tmp_path, cycles):
    """So it is no Doppler of this one's paths, and leaves no phase of theirs wrong."""
    turn = np.exp(2j * np.pi * cycles * world.n / len(world.n))
    document = of_two_ports(
        world, tmp_path / "case", lambda heard: 0.2 * heard[0] + 0.3j * heard[1] * turn, gains=(0.2, 0.3j), budget_s=1000
    )
    (told,) = document["effects"]
    assert (document["verdict"], told["family"], told["owner"]["name"]) == ("identified", "carrier_frequency_offset", "tx2")
    offset = told["parameters"]["offset_hz"]
    assert offset["value"] == pytest.approx(cycles * RATE_HZ / len(world.n), abs=4 * offset["std"])
