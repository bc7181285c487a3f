# SPDX-License-Identifier: GPL-3.0-or-later
import cast_scenario
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.emulation.reference import emulate, scenario_updates
from gr_cast.scenario.band import in_band_power

LINK = ("a", "b")


def one_link(delay_s, gain, **about):
    taps = sc.LinkTaps(delay_s=[delay_s], gain=[gain])
    return sc.Scenario(name="alley", nodes=LINK, links={LINK: taps}, **about)


ALLEY = one_link([0, 1e-8, 2e-8, 9e-8], [1.0, -0.8, 0.7j, 0.1], bandwidth_hz=20e6, base_loss_db=50.0)


def test_in_band_power_is_what_noise_of_that_band_gets_through_the_emulator():
    rng = np.random.default_rng(1)
    spectrum = np.zeros(1 << 17, complex)  # at 100 MS/s: every tap on a whole sample
    inside = np.abs(np.fft.fftfreq(spectrum.size, 1e-8)) < 10e6
    spectrum[inside] = rng.normal(size=inside.sum()) + 1j * rng.normal(size=inside.sum())
    sent = np.fft.ifft(spectrum)
    heard = emulate(np.stack([sent, np.zeros_like(sent)]), scenario_updates(ALLEY, 100e6), 2)[1]
    passed_db = 10 * np.log10(np.mean(np.abs(heard) ** 2) / np.mean(np.abs(sent) ** 2))
    assert sc.band_power_db(ALLEY, LINK, 20e6)[0] == pytest.approx(passed_db, abs=0.1)
    assert sc.tap_power_db(ALLEY, LINK)[0] > passed_db + 1.5
    np.testing.assert_allclose(sc.path_gain_matrix_db(ALLEY)[0], [-np.inf, sc.band_power_db(ALLEY, LINK, 20e6)[0]])


@pytest.mark.parametrize("instants, paths", [(1, 2), (70, 300)])
def test_in_band_power_is_the_mean_over_a_comb_of_frequencies(instants, paths):
    rng = np.random.default_rng(2)
    delay_s, gain = 5e-6 * rng.random((instants, paths)), rng.normal(size=(instants, paths)) + 1j
    comb_hz = ((np.arange(2000) + 0.5) / 2000 - 0.5) * 8e6
    response = np.einsum("ftp,tp->ft", np.exp(-2j * np.pi * comb_hz[:, None, None] * delay_s), gain, optimize=True)
    np.testing.assert_allclose(in_band_power(delay_s, gain, 8e6), np.mean(np.abs(response) ** 2, axis=0), rtol=1e-3)


def test_taps_whole_steps_of_the_band_apart_have_the_sum_of_their_powers():
    steps = one_link([0, 2.5e-8, 1e-7], [1, 0.5j, -0.3], bandwidth_hz=40e6)
    assert sc.taps_over_band_db(steps) == pytest.approx((0, 0), abs=1e-9)
    least_db, most_db = sc.taps_over_band_db(ALLEY)
    assert least_db == most_db == pytest.approx(sc.tap_power_db(ALLEY, LINK)[0] - sc.band_power_db(ALLEY, LINK, 20e6)[0])


def test_the_band_of_a_scenario_that_names_none_is_the_widest_that_colosseum_plays():
    assert sc.band_hz(ALLEY) == 20e6 and sc.band_hz(sc.load("four_tap")) == 80e6


def test_show_states_both_powers_where_they_differ(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sc.save("alley.yaml", ALLEY)

    def row(*options):
        assert cast_scenario.main(["show", "alley.yaml", *options]) == 0
        text = capsys.readouterr().out
        return text, next(line for line in text.splitlines() if line.strip().startswith("a>b")).split()[1:4]

    text, (_, in_band, by_sum) = row()
    assert "power in 20 MHz" in text
    assert float(in_band) == pytest.approx(sc.band_power_db(ALLEY, LINK, 20e6)[0], abs=0.006)
    assert float(by_sum) == pytest.approx(sc.tap_power_db(ALLEY, LINK)[0], abs=0.006)
    assert float(row("--band", "10e6")[1][1]) == pytest.approx(sc.band_power_db(ALLEY, LINK, 10e6)[0], abs=0.006)
    assert row("--band", "100e6")[1][2] == "0.000"  # 10 ns apart there: no second figure, but the first tap
