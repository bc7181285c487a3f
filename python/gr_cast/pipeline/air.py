# SPDX-License-Identifier: GPL-3.0-or-later
"""What carries samples at a site: the embedded emulator, or a program that plays and records over radios.

A program is called in the folder of the experiment: `tx_NODE.cf32` hold what nodes send, it writes `rx_NODE.cf32`, complex64,
little endian. CAST_TRANSMITTERS, CAST_RECEIVERS, CAST_SAMPLE_RATE_HZ, CAST_SCENARIO and CAST_INVENTORY (JSON) tell the rest.
"""

import json
import os
import shlex
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..core.documents import json_text
from ..core.errors import CastError
from ..emulation.network import emulate_network
from ..scenario import Scenario
from ..signals.recording import Recording
from ..twin import make
from ..twin.document import Case, Link, Observation, Tap, Waveform
from ..twin.playback import Conditions, Playback
from .patience import Stopped
from .site import Site

TOLD = ("CAST_TRANSMITTERS", "CAST_RECEIVERS", "CAST_SAMPLE_RATE_HZ", "CAST_CENTER_FREQUENCY_HZ", "CAST_INVENTORY")


def carried(
    site: Site,
    scenario: Scenario,
    sent: dict[str, np.ndarray],
    receivers: list[str],
    rate_hz: float,
    seed: int,
    folder: Path,
    longest_s: float,
) -> dict[str, np.ndarray]:
    """Receiver → what it hears, (n,) complex64, of what is sent, transmitter → (n,) complex64 with full scale 1.
    `longest_s`: that a site's program may take."""
    if site.program:
        return _by_program(site, scenario, sent, receivers, rate_hz, folder, longest_s)
    if site.effects:
        return {rx: _with_effects(site, scenario, sent, rx, rate_hz, seed) for rx in receivers}
    given = {tx: Recording(samples=samples, sample_rate_hz=rate_hz) for tx, samples in sent.items()}
    heard = emulate_network(scenario, given, noise_power_db=site.noise_power_db, seed=seed)
    return {rx: heard[rx].samples for rx in receivers}


def _with_effects(site: Site, scenario: Scenario, sent, rx: str, rate_hz: float, seed: int) -> np.ndarray:
    """What one receiver hears where the site's radios and channels have effects: a twin is played with them."""
    here = {tx: samples for tx, samples in sent.items() if (tx, rx) in scenario.links}
    count = max(len(samples) for samples in here.values())
    taps = {tx: make.believed_of(scenario, (tx, rx), 0.0, count / rate_hz)[0] for tx in here}
    heard = Observation(
        name=rx, receiver=rx, on_air={tx: (tx, 1.0) for tx in here}, samples=np.zeros(0), datatype="cf32_le",
        center_frequency_hz=scenario.center_frequency_hz, vault=False,
    )  # fmt: skip
    twin = Case(
        name=site.name,
        folder=site.folder,
        document={},
        sample_rate_hz=rate_hz,
        waveforms={tx: Waveform(name=tx, samples=samples, repeat=False, built_in=False) for tx, samples in here.items()},
        links={(tx, rx): Link(tx=tx, rx=rx, taps=tuple(Tap(**tap) for tap in found)) for tx, found in taps.items()},
        observations=(heard,),
        noise_db={rx: site.noise_power_db},
        effects=site.effects,
    )
    return Playback(twin, heard, count, Conditions(seed=seed)).samples()


def _by_program(
    site: Site, scenario: Scenario, sent, receivers: list[str], rate_hz: float, folder: Path, longest_s: float
) -> dict:
    for tx, samples in sent.items():
        samples.astype("<c8").tofile(folder / f"tx_{tx}.cf32")
    told = {
        "CAST_TRANSMITTERS": " ".join(sent),
        "CAST_RECEIVERS": " ".join(receivers),
        "CAST_SAMPLE_RATE_HZ": f"{rate_hz:.17g}",
        "CAST_CENTER_FREQUENCY_HZ": f"{scenario.center_frequency_hz or 0:.17g}",
        "CAST_SCENARIO": scenario.name,
        "CAST_INVENTORY": json.dumps({name: asdict(place) for name, place in site.nodes.items()}),
    }
    words = [word.replace("{site}", str(site.folder)) for word in shlex.split(site.program)]
    try:
        done = subprocess.run(
            ["setpriv", "--pdeathsig", "KILL", *words], cwd=folder, env=os.environ | told, capture_output=True, text=True,
            timeout=longest_s, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise Stopped(f"site {site.name}: program: stopped after {longest_s:g} s", "program_s") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["failed without a word"])[-1]
        raise CastError(f"site {site.name}: program: status {done.returncode}: {last}")
    return {rx: samples_of(folder / f"rx_{rx}.cf32", f"site {site.name}: program: node {rx}") for rx in receivers}


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a site's program is told by its environment."""

    transmitters: list[str]
    receivers: list[str]
    sample_rate_hz: float
    center_frequency_hz: float | None  # None where the scenario has none
    devices: dict[str, str]  # node → device arguments


def told_of(environment) -> Told:
    """Read what `_by_program` tells. Raises CastError where this is no site's program."""
    if missing := [name for name in TOLD if name not in environment]:
        raise CastError(f"{', '.join(missing)}: not set: an inventory's program is called by cast_pipeline run, not by hand")
    nodes = json_text(environment["CAST_INVENTORY"], "CAST_INVENTORY").document
    return Told(
        transmitters=environment["CAST_TRANSMITTERS"].split(),
        receivers=environment["CAST_RECEIVERS"].split(),
        sample_rate_hz=float(environment["CAST_SAMPLE_RATE_HZ"]),
        center_frequency_hz=float(environment["CAST_CENTER_FREQUENCY_HZ"]) or None,
        devices={node: place["device"] for node, place in nodes.items()},
    )


def given(told: Told, folder: Path) -> dict[str, np.ndarray]:
    """Transmitter → what it sends, (n,) complex64, as a site's program finds it."""
    return {node: samples_of(folder / f"tx_{node}.cf32", f"node {node}") for node in told.transmitters}


def samples_of(path: Path, who: str) -> np.ndarray:
    """complex64 of a file that a stack or a site wrote. Raises CastError, naming who, where it is none."""
    try:
        size = path.stat().st_size
    except FileNotFoundError:
        raise CastError(f"{who}: has not written {path.name}") from None
    if size == 0 or size % 8:
        raise CastError(f"{who}: {path.name}: got {size} bytes, needs whole complex64 samples, one or more")
    samples = np.fromfile(path, "<c8")
    if not np.isfinite(samples.view(np.float32)).all():
        raise CastError(f"{who}: {path.name}: holds NaN or infinite samples")
    return samples
