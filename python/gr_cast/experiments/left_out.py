# SPDX-License-Identifier: GPL-3.0-or-later
"""Two twins that differ in one thing: a case folder in which the diagnosis must find what was left out.

The world's receiver is recorded; the twin that goes with it says what was sent and through which taps, and nothing else.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import signal

from .. import __version__
from ..core.documents import yaml_text
from ..core.errors import CastError
from ..core.files import write_text
from ..core.units import db_from_amplitude, db_from_power
from ..scenario import played_gain
from ..signals import recording
from . import hall
from .hall import WALLS
from .jamming import BANDWIDTH_HZ, Jammer, Setting

SNR_DB, SINR_DB = 25.0, 5.0
LEVEL = 0.1  # rms of a recording, full scale 1
RECORDINGS = 2
FRAME_BYTES = 500
OVERSAMPLING = 2  # over the modem's rate: the emulator's taps between samples are exact over four fifths of a band
QUIET = 64  # samples of silence around a frame, at the modem's rate
UNHEARD = 64  # first samples of the jammer's waveform that are marked unknown: what came before them is in the air too
HARMONIC = (5e6, -15.0)  # Hz from the carrier, dB re the jammer


def parse(text: str) -> tuple[str, str]:
    """("wall", its name) or ("harmonic", "") from what a user writes."""
    kind, _, name = text.partition(":")
    if kind == "wall" and name in WALLS or text == "harmonic":
        return kind, name
    raise CastError(f"--leave-out: got {text!r}, needs harmonic or wall:NAME with {', '.join(WALLS)}")


def settings(kind: str, wall: str, duration_s: float, seed: int) -> tuple[Setting, Setting]:
    """The world and its twin: a narrowband jammer in the hall, on in the middle third; other noise in each."""
    jammer = Jammer(
        bandwidth_hz=BANDWIDTH_HZ["narrowband"],
        on_s=(duration_s / 3, 2 * duration_s / 3),
        harmonic=HARMONIC if kind == "harmonic" else None,
    )
    world = Setting(scenario=hall.scenario("static"), jammer=jammer, snr_db=SNR_DB, sinr_db=SINR_DB, seed=seed)
    less = hall.scenario("static", without=[wall] if kind == "wall" else [])
    # The twin's radios are as loud as the world's: what it leaves out is all that makes it differ.
    return world, replace(world, scenario=less, levels_of=world.scenario, jammer=replace(jammer, harmonic=None), seed=seed + 1)


def recorded(kind: str, world: Setting) -> Setting:
    """The world while it is recorded: the jammer is on all the time where its harmonic is looked for, else off."""
    if kind == "wall":
        return replace(world, jammer=None, sinr_db=None)
    return replace(world, jammer=replace(world.jammer, on_s=(0.0, np.inf)))


def document(about: dict) -> dict:
    """The content of left_out.json."""
    return {"cast_left_out": 1, "software": f"gr-cast {__version__}", **about}


def what_was_left_out(kind: str, world: Setting, twin: Setting) -> str:
    """The truth in the words of a diagnosis, for the screen."""
    if kind == "harmonic":
        offset_hz, level_db = world.jammer.harmonic
        return f"narrowband interference at {offset_hz / 1e6:g} MHz from the carrier, {level_db:g} dB re the jammer"
    whole, less = (s.scenario.links[(s.tx, s.rx)] for s in (world, twin))
    gone = int(np.argmin(np.isin(whole.gain[0], less.gain[0])))
    delay_s, gain_db = whole.delay_s[0, gone], db_from_amplitude(whole.gain[0, gone])
    return f"a path {1e9 * delay_s:.1f} ns after the transmission, {gain_db:.1f} dB"


def write_case(folder: Path, world: Setting, twin: Setting, modem, emulator, *, jammed: bool) -> None:
    """Record frames of the world and write the case of the twin: twin.yaml, waveforms, recordings.

    `emulator` plays the world. With `jammed`, the jammer as the twin knows it (without a harmonic) is a transmitter too.
    """
    rate = OVERSAMPLING * modem.sample_rate_hz
    document = {
        "cast_twin": 1,
        "sample_rate_hz": rate,
        "center_frequency_hz": twin.scenario.center_frequency_hz,
        "waveforms": {},
        "nodes": {twin.rx: {}, twin.tx: {}},
        "links": [],
        "recordings": [],
        "unknown": ["delay", "phase", "gain"],
    }
    on_air = [twin.tx, twin.jammer_node] if jammed else [twin.tx]
    if jammed:
        document["nodes"][twin.jammer_node] = {"amplitude": float(twin.jammer_amplitude)}
    document["links"] = [{"tx": tx, "rx": twin.rx, "taps": _taps(twin, tx)} for tx in on_air]
    folder.mkdir(parents=True, exist_ok=True)
    scale = None
    for number in range(RECORDINGS):
        rng = np.random.default_rng([world.seed, number])
        frame = np.pad(modem.modulate(rng.bytes(FRAME_BYTES)), QUIET)
        sent = signal.resample(frame, OVERSAMPLING * len(frame))
        begin = round((1 + number) * rate)
        inputs = np.zeros((len(world.transmitters), emulator.past + len(sent)), complex)
        inputs[0, emulator.past :] = sent
        heard = {twin.tx: sent}
        if jammed:
            place = (inputs.shape[1], (begin - emulator.past) / rate, rate)
            state = rng.bit_generator.state
            inputs[1] = world.jammer_amplitude * world.jammer.samples(rng, *place)
            rng.bit_generator.state = state  # the twin's jammer is the same noise
            known = replace(world.jammer, harmonic=None).samples(rng, *place)
            heard[twin.jammer_node] = known[emulator.past :]
            heard[twin.jammer_node][:UNHEARD] = np.nan
        received, _ = emulator.receive(begin, inputs)
        scale = scale or LEVEL / np.sqrt(np.mean(np.abs(received) ** 2))
        about = {"sample_rate_hz": rate, "center_frequency_hz": twin.scenario.center_frequency_hz}
        recording.write(folder / f"recording_{number}", scale * received, **about)
        for node, samples in heard.items():
            name = f"{node}_{number}"
            recording.write(folder / name, samples, **about)
            document["waveforms"][name] = {"file": name, "repeat": False}
        document["recordings"].append(
            {
                "file": f"recording_{number}",
                "receiver": twin.rx,
                "transmitters": on_air,
                "transmit": {node: f"{node}_{number}" for node in on_air},
            }
        )
    document["noise"] = {twin.rx: {"power_db": float(db_from_power(OVERSAMPLING * twin.noise_power * scale**2))}}
    write_text(folder / "twin.yaml", yaml_text(document))


def _taps(twin: Setting, tx: str) -> list[dict]:
    delay_s, gain = (twin.scenario.links[(tx, twin.rx)].delay_s[0], played_gain(twin.scenario, (tx, twin.rx))[0])
    return [
        {"delay_s": float(d), "gain_db": float(db_from_amplitude(g)), "phase_rad": float(np.angle(g))}
        for d, g in zip(delay_s, gain, strict=True)
    ]
