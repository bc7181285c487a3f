# SPDX-License-Identifier: GPL-3.0-or-later
"""The families of physics that a twin may leave out, in true signal order, one file each."""

from .ac_coupling import AcCoupling
from .adc_clipping import AdcClipping
from .base import CHANNEL_AFTER, Effect, Family, Multiplicity, Role
from .carrier_frequency_offset import CarrierFrequencyOffset
from .carrier_settling import CarrierSettling
from .clock_wander import ClockWander
from .dc_offset import DcOffset
from .diffuse_tail import DiffuseTail
from .extra_path import ExtraPath
from .front_end_filter import FrontEndFilter
from .gain_drift import GainDrift
from .gain_step import GainStep
from .impulsive_noise import ImpulsiveNoise
from .iq_imbalance import IqImbalance
from .lo_leakage import LoLeakage
from .missing_path import MissingPath
from .narrowband_interference import NarrowbandInterference
from .noise_course import NoiseCourse
from .noise_floor import NoiseFloor
from .pa_nonlinearity import PaNonlinearity
from .phase_noise import PhaseNoise
from .phase_ramp import PhaseRamp
from .power_supply_hum import PowerSupplyHum
from .pulsed_carrier import PulsedCarrier
from .pulsed_interference import PulsedInterference
from .quantization import Quantization
from .recursive_filter import RecursiveFilter
from .sample_clock_offset import SampleClockOffset
from .sample_loss import SampleLoss
from .second_order import SecondOrder
from .second_transmitter import SecondTransmitter
from .signal_dependent_noise import SignalDependentNoise
from .spectral_inversion import SpectralInversion
from .tap_delay_error import TapDelayError
from .tap_doppler import TapDoppler
from .tap_fading import TapFading
from .tap_gain_error import TapGainError
from .tone_interference import ToneInterference
from .values import Value

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        IqImbalance(),
        LoLeakage(),
        PaNonlinearity(),
        SampleLoss(),
        MissingPath(),
        TapGainError(),
        TapDelayError(),
        TapDoppler(),
        TapFading(),
        ExtraPath(),
        DiffuseTail(),
        SampleClockOffset(),
        SecondTransmitter(),
        CarrierFrequencyOffset(),
        PhaseNoise(),
        PhaseRamp(),
        CarrierSettling(),
        FrontEndFilter(),
        AcCoupling(),
        RecursiveFilter(),
        GainStep(),
        GainDrift(),
        PowerSupplyHum(),
        SecondOrder(),
        DcOffset(),
        ToneInterference(),
        ClockWander(),
        SpectralInversion(),
        AdcClipping(),
        Quantization(),
        PulsedCarrier(),
        PulsedInterference(),
        NarrowbandInterference(),
        ImpulsiveNoise(),
        SignalDependentNoise(),
        NoiseCourse(),
        NoiseFloor(),
    )
}


NAMED = tuple(
    name for name, family in FAMILIES.items() if not family.beyond and family.told == name
)  # that a twin or a diagnosis may list


def stage_of(effect: Effect) -> int:
    """Where in the signal order an effect stands."""
    return FAMILIES[effect.family].at(effect)


def with_role(role: Role) -> Family:
    """The family that plays a part."""
    return next(family for family in FAMILIES.values() if family.role is role)


def is_coarse(effect: Effect) -> bool:
    """Whether an effect is a quantiser whose error is bound to the prediction."""
    return FAMILIES[effect.family].coarse(effect)


def plays(effect: Effect, *roles: Role) -> bool:
    """Whether an effect plays one of some parts."""
    return FAMILIES[effect.family].role in roles


__all__ = [
    "CHANNEL_AFTER",
    "FAMILIES",
    "NAMED",
    "Effect",
    "Family",
    "Multiplicity",
    "Role",
    "Value",
    "is_coarse",
    "plays",
    "stage_of",
    "with_role",
]
