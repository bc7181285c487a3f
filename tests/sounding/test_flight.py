# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.signals.recording import Recording
from gr_cast.sounding import flight

PERIOD_S = 255e-6


def told(axis, delays_s, repeats=True, base_delay_s=None):
    taps = [{"delay_s": delay_s, "gain_db": -k} for k, delay_s in enumerate(delays_s)]
    about = {} if axis is None else {"cast:time_axis": axis}
    heard = Recording(samples=np.zeros(1, np.complex64), sample_rate_hz=1e6, metadata=about)
    return flight.told({"period_samples": 255, "sample_rate_hz": 1e6, "taps": taps}, heard, repeats, base_delay_s)


def flights_s(document):
    return [tap["time_of_flight_s"] for tap in document["taps"]]


@pytest.mark.parametrize("axis", [None, "device"])
def test_delays_that_are_only_differences_are_no_flights(axis):
    document = told(axis, [1e-6, 2e-6], base_delay_s=1e-6)
    assert flights_s(document) == [None, None]
    assert (document["time_axis"], document["base_delay_s"]) == (axis, None)
    assert [(tap["delay_s"], tap["gain_db"]) for tap in document["taps"]] == [(1e-6, 0), (2e-6, -1)]


def test_a_flight_is_the_delay_less_what_the_set_up_adds():
    document = told("utc", [20e-6, 30e-6], base_delay_s=17e-6)
    assert (document["time_axis"], document["base_delay_s"]) == ("utc", 17e-6)
    assert flights_s(document) == pytest.approx([3e-6, 13e-6], abs=1e-15)
    assert flights_s(told("utc", [20e-6])) == pytest.approx([20e-6], abs=1e-15)


@pytest.mark.parametrize("share", [-0.12, 0.0, 0.3, 0.87])
def test_a_code_that_repeats_tells_a_flight_from_an_eighth_of_a_period_before_to_seven_behind(share):
    for periods in (-1, 0, 2):
        assert flights_s(told("utc", [(share + periods) * PERIOD_S])) == pytest.approx([share * PERIOD_S], abs=1e-15)
    once = told("utc", [(share + 2) * PERIOD_S], repeats=False)
    assert flights_s(once) == pytest.approx([(share + 2) * PERIOD_S], abs=1e-15)


def test_a_set_up_adds_the_mean_flight_of_the_strongest_taps():
    known = [told("utc", [delay_s, 90e-6]) for delay_s in (16e-6, 18e-6)]
    assert flight.base_delay_s(known) == pytest.approx(17e-6, abs=1e-15)
    assert flight.base_delay_s([*known, told("device", [17e-6])]) is None
    assert flight.base_delay_s([*known, told("utc", [])]) is None
    assert flight.base_delay_s([]) is None
