# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversions between units. Nothing else in gr_cast converts."""

import numpy as np

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0


def db_from_power(power):
    """10·log10(power); zero power is −inf dB, without a warning. Any array shape."""
    with np.errstate(divide="ignore"):
        return 10.0 * np.log10(power)


def db_from_amplitude(amplitude):
    """20·log10(|amplitude|) of a real or complex amplitude; zero is −inf dB."""
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(np.abs(amplitude))


def power_from_db(db):
    """10^(db/10)."""
    return 10.0 ** (np.asarray(db) / 10.0)


def amplitude_from_db(db):
    """10^(db/20)."""
    return 10.0 ** (np.asarray(db) / 20.0)
