# SPDX-License-Identifier: GPL-3.0-or-later
"""USRP X310s by gr-uhd: one place that sets a radio up, for transmitting and receiving alike."""

import re
import sys
import time
from dataclasses import dataclass
from datetime import datetime

from ..core.errors import CastError
from ..core.programs import called

CLOCK_SOURCES = ("internal", "external", "gpsdo")
FREQUENCY_TOLERANCE_HZ = 1.0  # the DDC's own step is 0.05 Hz
GAIN_TOLERANCE_DB = 0.5  # a daughterboard's step
LEAST_LEFT_S = 0.2  # to a timed start: the command has to reach the device


@dataclass(frozen=True, kw_only=True)
class RadioSettings:
    """How one channel of a radio is set, in Hz, dB and seconds; empty strings leave UHD's default."""

    sample_rate_hz: float
    center_frequency_hz: float
    gain_db: float = 0.0
    antenna: str = ""
    subdevice: str = ""
    device_args: str = ""
    clock_source: str = "internal"
    time_source: str = "internal"
    start_at_s: int | None = None  # timed start at this second of UTC, counted from 1970; the device's clock is set at a PPS
    lead_s: float = 0.0  # a timed start so much after that second: samples have come by then that a transmitter can queue

    def __post_init__(self):
        faults = []
        if not 0 < self.sample_rate_hz <= 200e6:
            faults.append(f"rate: got {self.sample_rate_hz} Hz, needs more than 0 and at most 200e6 Hz")
        if not 10e6 <= self.center_frequency_hz <= 6e9:
            faults.append(f"frequency: got {self.center_frequency_hz} Hz, needs 10e6 to 6e9 Hz (X310 with UBX)")
        if not 0 <= self.gain_db <= 90:
            faults.append(f"gain: got {self.gain_db} dB, needs 0 to 90 dB")
        if self.clock_source not in CLOCK_SOURCES:
            faults.append(f"clock source: got {self.clock_source!r}, needs one of {', '.join(CLOCK_SOURCES)}")
        if self.time_source not in CLOCK_SOURCES:
            faults.append(f"time source: got {self.time_source!r}, needs one of {', '.join(CLOCK_SOURCES)}")
        if self.start_at_s is not None and not 0 < self.start_at_s - time.time() <= 86400:
            ahead_s = self.start_at_s - time.time()
            faults.append(f"start at: got {self.start_at_s}, {ahead_s:.0f} s from now, needs a second of the coming 24 hours")
        if not 0 <= self.lead_s <= 1:
            faults.append(f"lead: got {self.lead_s} s, needs 0 to 1 s")
        if self.start_at_s is not None and self.time_source == "internal":
            faults.append("start at: got time source 'internal', needs external or gpsdo: a pulse that every radio shares")
        if faults:
            raise CastError(*faults)


def second_of(text: str) -> int:
    """The second of UTC that a text names: Unix seconds, or ISO 8601 with a zone. Raises CastError."""
    try:
        if text.isdigit():
            return int(text)
        moment = datetime.fromisoformat(text.replace("Z", "+00:00"))
        if moment.tzinfo and not moment.microsecond:
            return int(moment.timestamp())
    except ValueError:
        pass
    raise CastError(f"got {text!r}, needs Unix seconds, or whole seconds with a zone: 2026-05-01T12:00:00Z")


def now_s(radio) -> float:
    """The time of the radio's clock."""
    return radio.get_time_now(0).get_real_secs()


def usrp_sink(settings: RadioSettings):
    """A configured `uhd.usrp_sink` that takes complex floats."""
    from gnuradio import uhd

    return _configured(uhd.usrp_sink, settings, "fc32", uhd)


def usrp_source(settings: RadioSettings, cpu_format: str = "fc32"):
    """A configured `uhd.usrp_source`; `cpu_format` is fc32 or sc16."""
    from gnuradio import uhd

    return _configured(uhd.usrp_source, settings, cpu_format, uhd)


def for_flowgraph(make, *, start_at: str = "", **settings):
    """`make(RadioSettings(…))` of a generated flowgraph, which ends with what is refused, a line each, and status 2."""
    try:
        return make(RadioSettings(start_at_s=second_of(start_at) if start_at else None, **settings))
    except CastError as error:
        print(*(f"error: {fault}" for fault in error.faults), sep="\n", file=sys.stderr)
        sys.exit(2)


def _configured(block, settings: RadioSettings, cpu_format: str, uhd):
    stream = uhd.stream_args(cpu_format=cpu_format, otw_format="sc16", channels=[0])
    try:
        radio = block(settings.device_args, stream)
        _set_up(radio, settings, uhd)
    except (LookupError, RuntimeError, ValueError) as error:  # UHD's own, as gr-uhd passes them on
        raise CastError(
            f"device: got arguments {settings.device_args!r}: {_reason(error)}{_next_step(settings, error)}"
        ) from None
    return radio


def _reason(error: Exception) -> str:
    """What UHD says, without the names of its exceptions."""
    said = re.sub(r"^(?:\w+Error: )+", "", " ".join(str(error).split()))
    return re.sub(r" for ----->.*", "", said) or type(error).__name__


def _next_step(settings: RadioSettings, error: Exception) -> str:
    """What to type where no device was found."""
    if "No devices found" not in str(error):
        return ""
    given = settings.device_args.strip()
    if not given:
        return f"; name the radio: --args addr=192.168.40.2; {called('cast_sounder')} devices lists those that answer"
    if "=" not in given:
        return f"; an address needs its key: --args addr={given}"
    return f"; is it on, and in this network? {called('cast_sounder')} devices lists those that answer"


def _set_up(radio, settings: RadioSettings, uhd) -> None:
    radio.set_clock_source(settings.clock_source, 0)
    radio.set_time_source(settings.time_source, 0)
    if settings.subdevice:
        radio.set_subdev_spec(settings.subdevice, 0)
    radio.set_samp_rate(settings.sample_rate_hz)
    radio.set_center_freq(settings.center_frequency_hz, 0)
    radio.set_gain(settings.gain_db, 0)
    if settings.antenna:
        radio.set_antenna(settings.antenna, 0)
    _check(radio, settings)
    if settings.start_at_s is None:
        radio.set_time_now(uhd.time_spec(0.0))
        return
    _set_utc_at_pulse(radio, settings, uhd)
    left_s = settings.start_at_s - now_s(radio)
    if left_s < LEAST_LEFT_S:
        raise CastError(
            f"start at: {left_s:.1f} s are left when the radio is set up, needs {LEAST_LEFT_S} s: name a later second"
        )
    radio.set_start_time(uhd.time_spec(settings.start_at_s, settings.lead_s))


def _set_utc_at_pulse(radio, settings: RadioSettings, uhd) -> None:
    """Set the device's clock to UTC at a pulse per second: a time is then one moment for all radios with that pulse, wherever
    they are. The second is the host's, or that of the device's GPS."""

    def second() -> int:
        return radio.get_mboard_sensor("gps_time", 0).to_int() if settings.time_source == "gpsdo" else int(time.time())

    while not 0.2 < time.time() % 1 < 0.5:  # well between two pulses it is known which one comes next
        time.sleep(0.05)
    coming = second() + 1
    radio.set_time_next_pps(uhd.time_spec(float(coming)))
    time.sleep(1.0)
    pulse = round(radio.get_time_last_pps(0).get_real_secs())
    if pulse != coming or second() != coming:
        raise CastError(
            f"time source: got {settings.time_source!r}, the device counts {pulse} at its last pulse, the clock says {second()}: "
            "no pulse comes, or the host's clock is off by more than a few tenths of a second"
        )


def _check(radio, settings: RadioSettings) -> None:
    """Refuse what the device has silently set otherwise: every later number would be wrong."""
    faults = []
    rate, frequency, gain = radio.get_samp_rate(), radio.get_center_freq(0), radio.get_gain(0)
    if abs(rate / settings.sample_rate_hz - 1) > 1e-9:
        faults.append(
            f"rate: got {settings.sample_rate_hz:g} Hz, the device can do {rate:g} Hz: whole fractions of its master clock"
        )
    if abs(frequency - settings.center_frequency_hz) > FREQUENCY_TOLERANCE_HZ:
        wanted = settings.center_frequency_hz
        faults.append(f"frequency: got {wanted:.12g} Hz, the device can do {frequency:.12g} Hz")
    if abs(gain - settings.gain_db) > GAIN_TOLERANCE_DB:
        faults.append(f"gain: got {settings.gain_db:g} dB, the device can do {gain:g} dB")
    if settings.clock_source != "internal" and not radio.get_mboard_sensor("ref_locked", 0).to_bool():
        faults.append(f"clock source: got {settings.clock_source!r}, the device does not lock to it")
    if faults:
        raise CastError(*faults)
