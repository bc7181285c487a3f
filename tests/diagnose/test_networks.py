# SPDX-License-Identifier: GPL-3.0-or-later
"""What several recordings of a network decide that one alone leaves open."""

import numpy as np
import pytest
import yaml
from conftest_world import COUNT, RATE_HZ, noise
from gr_cast.diagnose import diagnose, read_case
from gr_cast.signals import recording

SEEDS = {"tx1": 1, "tx2": 3}  # of what each sends
LEVEL = 0.03  # of the amplitude that arrives


def _sent(tx):
    return np.random.default_rng(SEEDS[tx]).choice([1, -1, 1j, -1j], 510)


@pytest.fixture
def two_by_two(world, tmp_path):
    """`added(tx, rx)`: what a recording has beside its noise → (verdict, [(family, owner)])."""

    def found(added):
        rng, folder = np.random.default_rng(5), tmp_path / "case"
        folder.mkdir()
        sent = {tx: _sent(tx) for tx in SEEDS}
        twin = world.twin() | {"nodes": {"rx1": {}, "rx2": {}}, "links": [], "recordings": [], "waveforms": {}, "noise": {}}
        for tx, x in sent.items():
            recording.write(folder / f"sent_{tx}", x, sample_rate_hz=RATE_HZ)
            twin["waveforms"][f"of_{tx}"] = {"file": f"sent_{tx}", "repeat": True}
            twin["nodes"][tx] = {"transmit": f"of_{tx}"}
            for rx in ("rx1", "rx2"):
                y = np.resize(np.roll(x, 37), COUNT) * np.exp(0.4j) + added(tx, rx) + noise(rng, COUNT, 0.1)
                recording.write(folder / f"{tx}_{rx}", 0.3 * y, sample_rate_hz=RATE_HZ)
                twin["links"].append({"tx": tx, "rx": rx, "taps": [{"delay_s": 0.0}]})
                twin["recordings"].append({"file": f"{tx}_{rx}", "receiver": rx, "transmitters": [tx]})
        (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
        document = diagnose(read_case(folder), budget_s=3000).document
        return document["verdict"], [(e["family"], e["owner"]["name"]) for e in document["effects"]]

    return found


def test_a_line_at_the_carrier_in_all_recordings_of_a_receiver_is_its_dc(two_by_two):
    assert two_by_two(lambda tx, rx: LEVEL * (rx == "rx1")) == ("identified", [("dc_offset", "rx1")])


def test_a_line_at_the_carrier_in_all_recordings_of_a_transmitter_is_its_leakage(two_by_two):
    assert two_by_two(lambda tx, rx: LEVEL * (tx == "tx2")) == ("identified", [("lo_leakage", "tx2")])


def test_a_carrier_that_is_off_in_one_recording_tells_what_the_line_is_in_the_other(two_by_two):
    """Beside tx1's carrier the DC of rx2 is no leakage of tx1, so it is none of tx2 where that cannot be seen."""
    turned = np.exp(2j * np.pi * 150 / RATE_HZ * np.arange(COUNT)) - 1
    sent = np.exp(0.4j) * np.resize(np.roll(_sent("tx1"), 37), COUNT)
    found = two_by_two(lambda tx, rx: sent * turned * (tx == "tx1") + 2 * LEVEL * (rx == "rx2"))
    assert found == ("identified", [("carrier_frequency_offset", "tx1"), ("dc_offset", "rx2")])
