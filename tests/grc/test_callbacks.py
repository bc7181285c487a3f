# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks change while a flowgraph of GNU Radio Companion runs: by the setters it generates, and by its sliders."""

import os
import subprocess
from pathlib import Path

import cast_grc
import numpy as np
import pytest
from gr_cast.core.documents import yaml_text
from gr_cast.scenario import load

ROOT = Path(__file__).resolve().parents[2]
PATIENT = """
import time

def until(holds, seconds=20):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "never"
        time.sleep(0.01)
"""


def environment(home):
    return cast_grc.environment(os.environ) | {"HOME": str(home), "GR_DONT_LOAD_PREFS": "1", "QT_QPA_PLATFORM": "offscreen"}


def run(home, *command):
    done = subprocess.run(command, env=environment(home), cwd=home, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def compiled(home, flowgraph):
    run(home, "grcc", "-o", str(home), str(flowgraph))


def graph(home, name, variables: dict, blocks: dict, connections: list) -> None:
    """A flowgraph without a window from {name: value} and {name: (id, parameters)}, compiled."""
    entries = [{"name": key, "id": "variable", "parameters": {"value": value}} for key, value in variables.items()]
    entries += [{"name": key, "id": kind, "parameters": parameters} for key, (kind, parameters) in blocks.items()]
    document = {
        "options": {"parameters": {"id": name, "generate_options": "no_gui", "run_options": "run"}, "states": {"state": True}},
        "blocks": [entry | {"states": {"state": True}} for entry in entries],
        "connections": [[source, "0", sink, "0"] for source, sink in connections],
        "metadata": {"file_format": 1},
    }
    (home / f"{name}.grc").write_text(yaml_text(document))
    compiled(home, f"{name}.grc")


def test_links_noise_and_rate_of_the_channel_emulator_follow_their_variables(tmp_path):
    """A constant of 1 over one tap comes out as the tap; noise of power p has a mean square of p."""
    ones = ("analog_sig_source_x", {"type": "complex", "waveform": "analog.GR_CONST_WAVE", "amp": "1"})
    channel = {"links": "{(0, 0): [0, gain]}", "noise_power": "noise", "sample_rate_hz": "samp_rate"}
    graph(
        tmp_path, "network", {"samp_rate": "1e6", "gain": "0.25", "noise": "0"},
        {"ones": ones, "channel": ("cast_channel_emulator", channel), "out": ("blocks_probe_signal_x", {"type": "complex"})},
        [("ones", "channel"), ("channel", "out")],
    )  # fmt: skip
    program = (
        PATIENT
        + """
import pmt, network
top = network.network()
top.start()
until(lambda: top.out.level() == 0.25)
top.set_gain(-0.5)
until(lambda: top.out.level() == -0.5)
top.set_gain(0)
top.set_noise(0.04)
until(lambda: top.out.level() != 0 and abs(top.out.level() + 0.5) > 1e-9)
heard = []
while len(heard) < 400:
    heard.append(top.out.level())
    time.sleep(0.002)
print("POWER", sum(abs(x) ** 2 for x in set(heard)) / len(set(heard)), len(set(heard)))
top.set_noise(0)
until(lambda: top.out.level() == 0)
before = pmt.to_python(top.channel.status())["real_time_factor"]
top.set_samp_rate(1e3)
until(lambda: pmt.to_python(top.channel.status())["real_time_factor"] > 100 * max(before, 1e-3))
try:
    top.set_samp_rate(-1)
except ValueError as error:
    print("REFUSED", error)
top.stop()
top.wait()
"""
    )
    told = run(tmp_path, "/usr/bin/python3", "-c", program)
    power, n = told.split("POWER ")[1].split()[:2]
    assert int(n) > 30 and abs(float(power) / 0.04 - 1) < 5 / np.sqrt(int(n))  # exponentially distributed: SD is the mean
    assert "REFUSED channel_emulator: sample_rate_hz: got -1" in told


def peaks(scenario: str, rate_hz: float) -> list[int]:
    taps = load(scenario).links[("1", "2")]
    return sorted(int(d) for d in np.rint(taps.delay_s[0] * rate_hz))


def test_sliders_change_scenario_rate_noise_and_average_while_it_runs(tmp_path):
    """Peaks stand at the delays of whatever scenario and rate are chosen; frames come as seldom as periods are averaged;
    the floor of the response rises with the noise."""
    compiled(tmp_path, ROOT / "apps" / "flowgraphs" / "live_scenario.grc")
    program = (
        PATIENT
        + """
import sys
import numpy as np
from gnuradio import blocks
from PyQt5 import Qt, QtWidgets
import live_scenario

app = Qt.QApplication(sys.argv)
top = live_scenario.live_scenario()
sink = blocks.probe_signal_vf(511)
top.connect((top.correlator, 1), sink)
top.start()
top.show()

def shows(holds):
    until(lambda: (app.processEvents(), holds(np.array(sink.level())))[1])

def at(*delays):
    return lambda h: set(np.flatnonzero(h > 0.05)) == set(delays)

combos = {box.itemText(0): box for box in top.findChildren(QtWidgets.QComboBox)}
scenario, rate = combos["four taps"], combos["50 MS/s"]
noise, average = [window.findChild(QtWidgets.QAbstractSpinBox) for window in (top._noise_db_win, top._average_win)]
shows(at(*{four}))
rate.setCurrentIndex(1)
shows(at(*{half}))
rate.setCurrentIndex(0)
shows(at(*{four}))
scenario.setCurrentIndex(1)
shows(at(0))
quiet = np.median(sink.level())
noise.setValue(0)
shows(lambda h: np.median(h) > 3 * quiet)
noisy = top.noise_db
average.setValue(4)

def frames_per_period():
    reads, made = top.correlator.nitems_read(0), top.correlator.nitems_written(0)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        app.processEvents()
    return (top.correlator.nitems_written(0) - made) / ((top.correlator.nitems_read(0) - reads) / 511)

frames_per_period()
print("SET", noisy, top.average, frames_per_period())

top.stop()
top.wait()
"""
    )
    program = program.replace("{four}", repr(peaks("four_tap", 50e6))).replace("{half}", repr(peaks("four_tap", 25e6)))
    told = run(tmp_path, "/usr/bin/python3", "-c", program)
    noise_db, average, share = map(float, told.split("SET ")[1].split())
    assert (noise_db, average) == (0, 4)
    assert abs(share - 1 / 4) < 0.05


def test_a_scenario_of_other_nodes_or_a_rate_beyond_the_filters_is_refused_and_the_old_one_plays_on(tmp_path):
    program = (
        PATIENT
        + """
import numpy as np
from gnuradio import analog, blocks, gr
from gr_cast.blocks.scenario_emulator import ScenarioEmulator
from gr_cast.core.errors import CastError

top = gr.top_block()
ones, out = analog.sig_source_c(1, analog.GR_CONST_WAVE, 0, 1), blocks.probe_signal_c()
emulator = ScenarioEmulator("1009", ["1"], ["10"], 50e6)
top.connect(ones, emulator, out)
top.start()
until(lambda: out.level() == 1)
for setter, value in (("scenario", "four_tap"), ("sample_rate", 100e6), ("scenario", "x")):
    try:
        getattr(emulator, f"set_{setter}")(value)
    except CastError as error:
        print("REFUSED", error)
time.sleep(0.2)
print("STILL", out.level())
top.stop()
top.wait()
"""
    )
    told = run(tmp_path, "/usr/bin/python3", "-c", program)
    assert "REFUSED Four taps: nodes: got 10, the scenario has 1, 2" in told
    assert "REFUSED sample rate: got 1e+08 Hz, which needs" in told and told.count("REFUSED") == 3
    assert "STILL (1+0j)" in told


TWIN = """
cast_twin: 1
sample_rate_hz: 1.0e6
center_frequency_hz: 1.0e9
waveforms: {code: {code: glfsr, degree: 8}}
nodes: {tx: {transmit: code}, rx: {}}
links: [{tx: tx, rx: rx, taps: [{delay_s: 0.0}, {delay_s: 5.0e-6, gain_db: -6.0}]}]
recordings: [{file: heard, receiver: rx, transmitters: [tx]}]
effects:
  - family: dc_offset
    owner: {level: rx, name: rx}
    parameters: {level_dbc: {value: -20.0, std: 0.0}}
"""


def test_the_twin_block_of_the_palette_plays_the_twin_with_its_effects(tmp_path):
    """An impulse comes out as the two taps of the twin over its receiver's constant of -20 dBc."""
    (tmp_path / "twin.yaml").write_text(TWIN)
    sent = ("blocks_vector_source_x", {"type": "complex", "vector": "[0] * 3000 + [1] + [0] * 40000", "repeat": "False"})
    twin = ("cast_twin_receiver", {"twin": "twin.yaml", "transmitters": "['tx']", "noise": "False"})
    out = ("blocks_file_sink", {"type": "complex", "file": "heard.cf32", "unbuffered": "True"})
    graph(tmp_path, "played", {}, {"sent": sent, "twin": twin, "out": out}, [("sent", "twin"), ("twin", "out")])
    run(tmp_path, "/usr/bin/python3", "played.py")
    heard = np.fromfile(tmp_path / "heard.cf32", np.complex64)
    constant = np.median(heard.real)
    assert constant == pytest.approx(0.1 * np.sqrt(1 + 10 ** (-6 / 10)), rel=1e-3)  # re the power of both taps together
    above = heard - constant
    assert np.flatnonzero(np.abs(above) > 0.1).tolist() == [3000, 3005]
    assert np.abs(above[[3000, 3005]]) == pytest.approx([1, 10 ** (-6 / 20)], rel=1e-3)
