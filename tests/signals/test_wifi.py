# SPDX-License-Identifier: GPL-3.0-or-later
"""The frame's parts against the worked example of IEEE Std 802.11 (annex I.1 in 2016, G in 1999)."""

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.signals import wifi

# SIGNAL of the example: 36 Mbit/s, 100 bytes.
SIGNAL = [1, 0, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1] + [0] * 12
CODED = "110100011010000100000010001111100111000000000000"
INTERLEAVED = "100101001101000000010100100000110010010010010100"
SCRAMBLER = "0110110000011001101010011100111101101000010101011111010010100011"
# First samples of the short and the long training field, to three places; the example halves the very first one by its window.
SHORT = [0.046 + 0.046j, -0.132 + 0.002j, -0.013 - 0.079j, 0.143 - 0.013j, 0.092]
LONG = [-0.156, 0.012 - 0.098j, 0.092 - 0.106j, -0.092 - 0.115j, -0.003 - 0.054j, 0.075 + 0.074j]


def text(bits):
    return "".join(map(str, bits))


def test_coded_signal_is_the_standards():
    assert text(wifi.encoded(np.array(SIGNAL, np.uint8))) == CODED


def test_interleaved_signal_is_the_standards():
    placed = np.empty(48, int)
    placed[wifi.interleaving(wifi.MODES["bpsk1/2"])] = [int(bit) for bit in CODED]
    assert text(placed) == INTERLEAVED


def test_scrambler_is_the_standards_and_repeats_after_127_bits():
    bits = wifi.scrambling(0b1011101, 254)
    assert text(bits[:64]) == SCRAMBLER
    assert (bits[:127] == bits[127:]).all() and bits[:127].sum() == 64


def test_training_is_the_standards():
    scaled = wifi.PREAMBLE * np.sqrt(52) / 64
    np.testing.assert_allclose(scaled[:5], SHORT, atol=7.1e-4)
    np.testing.assert_allclose(scaled[160:166], LONG, atol=7.1e-4)
    assert len(wifi.PREAMBLE) == 320


@pytest.mark.parametrize("mode", wifi.MODES.values(), ids=str)
def test_interleaving_places_every_bit_once_and_neighbours_apart(mode):
    place = wifi.interleaving(mode)
    assert sorted(place) == list(range(mode.coded_bits))
    carrier = place // mode.bits_per_carrier
    assert np.min(np.abs(np.diff(carrier))) >= 3


@pytest.mark.parametrize("mode", wifi.MODES.values(), ids=str)
@pytest.mark.parametrize("size", [1, 100, 1500])
def test_a_frame_has_the_standards_length_and_power_one(mode, size):
    frame = wifi.modulated(bytes(np.random.default_rng(1).integers(0, 256, size, np.uint8)), mode)
    symbols = -(-(16 + 8 * (size + 4) + 6) // (mode.coded_bits // 2))
    assert len(frame) == 320 + 80 * (1 + symbols)
    assert np.mean(np.abs(frame) ** 2) == pytest.approx(1, abs=0.1)


def test_rates_are_the_standards():
    assert {mode.name: mode.bit_rate_hz for mode in wifi.MODES.values()} == {"bpsk1/2": 6e6, "qpsk1/2": 12e6, "16qam1/2": 24e6}


@pytest.mark.parametrize("size", [0, 4092])
def test_a_payload_that_the_header_cannot_tell_is_refused(size):
    with pytest.raises(CastError, match=f"got {size} bytes, limit 1 to 4091"):
        wifi.modulated(bytes(size), wifi.MODES["qpsk1/2"])
