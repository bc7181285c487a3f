# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases made here from closed formulas, without any of the package's forward models."""

import numpy as np
import pytest
import yaml
from gr_cast.diagnose import read_case
from gr_cast.signals import codes, recording
from gr_cast.twin.document import Case

RATE_HZ, COUNT = 1e6, 20_000


class World:
    """One recording of a GLFSR of 255 chips at 2 samples per chip through two integer-delay paths, and the
    twin that says so."""

    def __init__(self, seed: int = 1):
        self.rng = np.random.default_rng(seed)
        self.code = {"code": "glfsr", "degree": 8, "mask": 0, "seed": 1, "samples_per_chip": 2}
        self.x = codes.from_spec(self.code).astype(complex)
        self.n = np.arange(COUNT)
        self.noise_rms = 0.01
        self.taps = [(0, 1.0), (9, 0.5 * np.exp(0.7j))]

    def path(self, delay: int) -> np.ndarray:
        return self.x[(self.n - delay - 37) % len(self.x)]

    def clean(self) -> np.ndarray:
        return 0.3 * np.exp(0.4j) * sum(a * self.path(d) for d, a in self.taps)

    def noisy(self, y: np.ndarray) -> np.ndarray:
        return y + self.noise_rms / np.sqrt(2) * (self.rng.normal(size=COUNT) + 1j * self.rng.normal(size=COUNT))

    def twin(self) -> dict:
        taps = [
            {"delay_s": d / RATE_HZ, "gain_db": float(20 * np.log10(abs(a))), "phase_rad": float(np.angle(a))}
            for d, a in self.taps
        ]
        return {
            "cast_twin": 1,
            "sample_rate_hz": RATE_HZ,
            "center_frequency_hz": 1e9,
            "waveforms": {"w1": self.code},
            "nodes": {"tx1": {"transmit": "w1"}, "rx1": {}},
            "links": [{"tx": "tx1", "rx": "rx1", "taps": taps}],
            "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}],
            "unknown": ["delay", "phase", "gain"],
            "noise": {"rx1": {"power_db": float(20 * np.log10(self.noise_rms))}},
        }

    def write(self, folder, y, datatype="cf32_le"):
        folder.mkdir(parents=True)
        recording.write(folder / "recording", y, sample_rate_hz=RATE_HZ, datatype=datatype, center_frequency_hz=1e9)
        (folder / "twin.yaml").write_text(yaml.safe_dump(self.twin()))
        return folder


def noise(rng, n, rms=1.0) -> np.ndarray:
    return rms / np.sqrt(2) * (rng.normal(size=n) + 1j * rng.normal(size=n))


def sent_once(folder, recorded, sent) -> Case:
    """The case of a waveform, NaN where it is not known, that is sent once over one path."""
    for stem, samples in (("recording", recorded), ("sent", sent)):
        recording.write(folder / stem, samples, sample_rate_hz=RATE_HZ)
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": RATE_HZ,
        "center_frequency_hz": 1e9,
        "waveforms": {"w1": {"file": "sent", "repeat": False}},
        "nodes": {"tx1": {"transmit": "w1"}, "rx1": {}},
        "links": [{"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0}]}],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}],
        "unknown": ["delay", "phase", "gain"],
    }
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    return read_case(folder)


@pytest.fixture
def world() -> World:
    return World()
