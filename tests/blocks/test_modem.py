# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets through channels of closed form."""

import numpy as np
import pytest
from gr_cast.blocks import modem
from gr_cast.core.errors import CastError
from gr_cast.signals import wifi
from scipy.special import erfc

MODES = list(wifi.MODES)
# Sum of bit errors of all code words at each distance, generators 133 and 171 (Conan 1984).
DISTANCE_SPECTRUM = {10: 36, 12: 211, 14: 1404, 16: 11633, 18: 77433}


def noise(rng, size, power):
    return np.sqrt(power / 2) * (rng.normal(size=size) + 1j * rng.normal(size=size))


def silence_around(frame, before=700, after=500):
    return np.concatenate([np.zeros(before), frame, np.zeros(after)])


@pytest.fixture(params=MODES)
def ofdm(request):
    return modem.open_modem("802.11a", request.param)


@pytest.mark.parametrize("size", [1, 47, 1000])
def test_a_packet_comes_out_as_it_went_in(ofdm, size):
    payload = np.random.default_rng(size).bytes(size)
    (packet,) = ofdm.demodulate(silence_around(ofdm.modulate(payload)))
    assert packet.payload == payload and abs(packet.start_sample - 700) <= wifi.GUARD


def test_packets_of_one_capture_come_out_in_order(ofdm):
    payloads = [bytes([k]) * (50 + k) for k in range(5)]
    rng = np.random.default_rng(1)
    samples = np.concatenate([silence_around(ofdm.modulate(p), rng.integers(10, 999)) for p in payloads])
    found = ofdm.demodulate(samples + noise(rng, len(samples), 1e-2))
    assert [packet.payload for packet in found] == payloads


# Echoes within the guard, one as strong as the direct path, one stronger and later; none on a whole fraction of the band.
@pytest.mark.parametrize("taps", [{0: 1, 15: 1j}, {0: 0.5, 3: 1, 11: -0.6j}, {0: 0.3, 13: 1}], ids=["equal", "three", "late"])
def test_echoes_within_the_guard_and_a_carrier_offset_cost_no_packet(ofdm, taps):
    rng = np.random.default_rng(2)
    response = np.zeros(16, complex)
    response[list(taps)] = list(taps.values())
    payload = rng.bytes(300)
    samples = np.convolve(silence_around(ofdm.modulate(payload)), response / np.linalg.norm(response))
    samples = samples * np.exp(2j * np.pi * 40e3 / 20e6 * np.arange(len(samples)))
    found = ofdm.demodulate(samples + noise(rng, len(samples), 10**-2.8))
    assert [packet.payload for packet in found] == [payload]


def test_noise_alone_is_no_packet(ofdm):
    assert ofdm.demodulate(noise(np.random.default_rng(3), 400_000, 1.0)) == []
    assert ofdm.demodulate(np.zeros(5000)) == [] and ofdm.demodulate(np.zeros(10)) == []


def test_a_frame_that_is_cut_or_spoilt_is_no_packet(ofdm):
    frame = silence_around(ofdm.modulate(bytes(200)))
    spoilt = frame.copy()
    spoilt[1400:1800] = 0
    assert ofdm.demodulate(spoilt) == [] and ofdm.demodulate(frame[:-700]) == []


def test_a_wrong_length_hides_no_frame_after_it(ofdm):
    long, short = ofdm.modulate(bytes(2000)), silence_around(ofdm.modulate(b"after"))
    samples = np.concatenate([np.zeros(100), long[:500], short, np.zeros(len(long))])
    assert [packet.payload for packet in ofdm.demodulate(samples)] == [b"after"]


def bit_error_bound(ebn0):
    """Union bound of the code's bit error rate with soft decisions in white noise (Proakis, section 8.2)."""
    return sum(weight * erfc(np.sqrt(distance / 2 * ebn0)) / 2 for distance, weight in DISTANCE_SPECTRUM.items())


@pytest.mark.parametrize("mode", ["bpsk1/2", "qpsk1/2"])
def test_loss_in_white_noise_is_the_codes_with_the_price_of_an_estimated_channel(mode):
    """From where the code's own bound loses one packet in ten it takes at most 3 dB until nearly none is lost:
    1.8 dB for gains from two training symbols, the rest for their phase; and at 2 dB less than the bound nearly all are lost."""
    ofdm, rng, size = modem.open_modem("802.11a", mode), np.random.default_rng(4), 250
    ebn0_db = np.linspace(0, 8, 400)
    loss = 8 * size * bit_error_bound(10 ** (ebn0_db / 10))
    threshold_db = ebn0_db[np.argmax(loss < 0.1)]
    # Information bits per carrier, and power that 52 of 64 carriers hold.
    snr_db = threshold_db + 10 * np.log10(wifi.MODES[mode].bits_per_carrier / 2 * 52 / 64)
    received = []
    for level_db in (snr_db - 2, snr_db + 3):
        payloads = [rng.bytes(size) for _ in range(40)]
        samples = np.concatenate([silence_around(ofdm.modulate(p)) for p in payloads])
        found = ofdm.demodulate(samples + noise(rng, len(samples), 10 ** (-level_db / 10)))
        received.append(len(found))
    assert received[0] <= 4 and received[1] >= 36


def test_a_modem_that_is_not_installed_is_named():
    with pytest.raises(CastError, match="gr-ieee802-11 cannot be loaded.*--modem 802.11a"):
        modem.open_modem("gr-ieee802-11", "qpsk1/2")
    assert "gr-fec" in modem.open_modem("auto", "qpsk1/2").name


@pytest.mark.parametrize("kind, mode", [("auto", "64qam"), ("liquid", "qpsk1/2")])
def test_an_unknown_modem_or_mode_is_refused(kind, mode):
    with pytest.raises(CastError, match="needs one of"):
        modem.open_modem(kind, mode)
