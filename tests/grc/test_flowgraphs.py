# SPDX-License-Identifier: GPL-3.0-or-later
"""Every shipped flowgraph loads, validates, compiles and, where it needs no radio, runs and obeys a law."""

import json
import os
import re
import subprocess
from pathlib import Path

import cast_grc
import numpy as np
import pytest
from gr_cast.scenario import load
from gr_cast.signals import codes

ROOT = Path(__file__).resolve().parents[2]
FLOWGRAPHS = sorted((ROOT / "apps" / "flowgraphs").glob("*.grc"))
COMPILE = """
import sys
from gnuradio import gr
from gnuradio.grc.core.platform import Platform

parts = gr.major_version(), gr.api_version(), gr.minor_version()
platform = Platform(version=gr.version(), version_parts=parts, prefs=gr.prefs())
platform.build_library()
out, paths = sys.argv[1], sys.argv[2:]
print("PALETTE", [(key, block.category) for key, block in platform.blocks.items() if key.startswith("cast_")])
for path in paths:
    graph = platform.make_flow_graph(path)
    graph.rewrite()
    graph.validate()
    dummies = [block.key for block in graph.blocks if block.is_dummy_block]
    assert not dummies, (path, "missing blocks", dummies)
    assert graph.is_valid(), (path, [str(error) for error in graph.iter_error_messages()])
    platform.Generator(graph, out).write()
"""


def run(command, home, **environment):
    env = cast_grc.environment(os.environ) | {"HOME": str(home), "GR_DONT_LOAD_PREFS": "1"} | environment
    done = subprocess.run(command, env=env, cwd=home, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A scratch HOME with every shipped flowgraph as a program."""
    home = tmp_path_factory.mktemp("home")
    done = run(["/usr/bin/python3", "-c", COMPILE, str(home), *map(str, FLOWGRAPHS)], home)
    return home, done.stdout


def test_every_shipped_flowgraph_validates_and_compiles(compiled):
    home, _ = compiled
    assert len(FLOWGRAPHS) == 6
    for path in FLOWGRAPHS:
        compile((home / f"{path.stem}.py").read_text(), path.stem, "exec")


def test_the_palette_lists_every_block_in_the_order_of_the_data_flow(compiled):
    _, output = compiled
    palette = dict(eval(re.search(r"PALETTE (.*)", output)[1]))
    ordered = sorted(palette, key=lambda key: (palette[key], key))
    assert ordered == [
        "cast_glfsr_source",
        "cast_usrp_sink",
        "cast_channel_emulator",
        "cast_scenario_emulator",
        "cast_twin_receiver",
        "cast_bpsk_correlator",
        "cast_usrp_source",
        "cast_zmq_replier",
        "cast_zmq_requester",
    ]
    assert all(category[0] == "gr-cast" for category in palette.values())


def expected_response(length, taps):
    """A periodic m-sequence correlates to 1 at its own lag and -1/length at every other."""
    response = np.full(length, -sum(taps.values()) / length, complex)
    for delay, gain in taps.items():
        response[delay % length] += gain * (1 + 1 / length)
    return response


def mean_response(path, length, n_frames):
    frames = np.fromfile(path, np.complex64).reshape(-1, length)
    assert len(frames) == n_frames
    return frames[1:].mean(axis=0)  # the first holds the start of the transmission


def test_the_headless_loopback_hears_the_four_taps_at_their_delays_and_gains(compiled):
    home, _ = compiled
    run(
        ["/usr/bin/python3", "loopback_headless.py", "-n", "40", "--noise-db", "-40", "-o", "heard.cf32"],
        home,
    )
    taps = load("four_tap").links[("1", "2")]
    at = dict(zip(np.rint(taps.delay_s[0] * 50e6).astype(int), taps.gain[0], strict=True))
    response = mean_response(home / "heard.cf32", 511, 40)
    # Noise of -40 dB averaged over 39 frames of 16 periods of 511 chips.
    spread = np.sqrt(10 ** (-40 / 10) / (39 * 16 * 511))
    assert np.abs(response - expected_response(511, at)).max() < 5 * spread + 1e-6
    assert set(np.argsort(-np.abs(response))[:4]) == set(at) == {0, 64, 100, 200}


def test_each_of_four_nodes_hears_the_three_others_and_not_itself(compiled):
    home, _ = compiled
    run(["/usr/bin/python3", "four_node_emulator.py", "-n", "20", "--noise-db", "-40", "-o", "heard"], home)
    spread = np.sqrt(10 ** (-40 / 10) / (19 * 8 * 1023))
    for rx in range(4):
        # Node tx starts its code 255 samples after the one before; 3 samples and 6 dB per step between nodes.
        at = {255 * tx + 3 * abs(tx - rx): 10 ** (-6 * abs(tx - rx) / 20) for tx in range(4) if tx != rx}
        response = mean_response(home / f"heard{rx + 1}.cf32", 1023, 20)
        assert np.abs(response - expected_response(1023, at)).max() < 5 * spread + 1e-6
        assert set(np.argsort(-np.abs(response))[:3]) == set(at)


WATCH = """
import sys
sys.path.insert(0, ".")
from gnuradio import blocks
from PyQt5 import Qt
import loopback

app = Qt.QApplication(sys.argv)
top = loopback.loopback()
sink = blocks.vector_sink_f(511)
top.connect((top.correlator, 1), sink)
top.start()
top.show()
top.set_noise_db(-60)
Qt.QTimer.singleShot(2000, app.quit)
app.exec_()
picture = top.grab()
picture.save("loopback.png")
top.stop()
top.wait()
import numpy as np
last = np.reshape(sink.data(), (-1, 511))[-1]
print("PEAKS", sorted(np.argsort(-last)[:4].tolist()), "FRAMES", top.magnitude_plot.nitems_read(0))
"""


def test_the_loopback_with_plots_shows_the_four_taps(compiled):
    home, _ = compiled
    done = run(["/usr/bin/python3", "-c", WATCH], home, QT_QPA_PLATFORM="offscreen")
    peaks, frames = re.search(r"PEAKS (.*) FRAMES (\d+)", done.stdout).groups()
    assert peaks == "[0, 64, 100, 200]"
    assert int(frames) > 50, "the plots are fed"


RADIO = """
import sys
sys.path[:0] = [".", sys.argv[1]]
import json
import fake_usrp
from gr_cast.signals import codes

import time

calls = fake_usrp.plug_in(codes.glfsr(9), air_rate=25e6, **json.loads(sys.argv[2]))
told = dict(device="addr=192.168.40.2", frequency=2.4e9, samp_rate=25e6, gain=15, antenna="RX1",
            subdevice="B:0", clock_source="external", time_source="gpsdo")
"""
TRANSMIT = """
import x310_transmitter

at = int(time.time()) + 8
top = x310_transmitter.x310_transmitter(**told, start_at=str(at), amplitude=0.25)
top.start()
while len(fake_usrp.Radio.sent.data()) < 2000:
    time.sleep(0.01)
top.stop()
top.wait()
print("CALLS", json.dumps([at, calls, [x.real for x in fake_usrp.Radio.sent.data()[:1022]]]))
"""
RECEIVE = """
from gnuradio import blocks
from PyQt5 import Qt
import x310_receiver

app = Qt.QApplication(sys.argv)
at = int(time.time()) + 8
top = x310_receiver.x310_receiver(**told, start_at=str(at))
sink, head = blocks.vector_sink_f(511), blocks.head(4 * 511, 50)
top.connect((top.correlator, 1), head, sink)
top.start()
top.show()
Qt.QTimer.singleShot(2000, app.quit)
app.exec_()
top.stop()
top.wait()
print("CALLS", json.dumps([at, calls, list(sink.data())]))
"""


def set_up(at):
    """What the radio is told, but for the second of the pulse at which its clock is set."""
    return [
        ["make", "addr=192.168.40.2", "fc32", "sc16", [0]],
        ["set_clock_source", "external", 0],
        ["set_time_source", "gpsdo", 0],
        ["set_subdev_spec", "B:0", 0],
        ["set_samp_rate", 25e6],
        ["set_center_freq", 2.4e9, 0],
        ["set_gain", 15, 0],
        ["set_antenna", "RX1", 0],
        ["set_start_time", at],
    ]


def with_fake_radio(home, program, **answers):
    command = ["/usr/bin/python3", "-c", RADIO + program, str(ROOT / "tests" / "blocks"), json.dumps(answers)]
    env = cast_grc.environment(os.environ) | {"HOME": str(home), "GR_DONT_LOAD_PREFS": "1", "QT_QPA_PLATFORM": "offscreen"}
    return subprocess.run(command, env=env, cwd=home, capture_output=True, text=True, timeout=240)


def told_by(done):
    assert done.returncode == 0, done.stdout + done.stderr
    at, calls, seen = json.loads(re.search(r"CALLS (.*)", done.stdout)[1])
    ((_, pulse),) = [call for call in calls if call[0] == "set_time_next_pps"]
    assert at - 8 <= pulse < at
    assert [call for call in calls if call[0] != "set_time_next_pps"] == set_up(at)
    return seen


def test_the_x310_transmitter_sets_the_radio_up_and_sends_the_code(compiled):
    sent = told_by(with_fake_radio(compiled[0], TRANSMIT))
    assert np.array_equal(sent, np.tile(0.25 * codes.glfsr(9), 2))


def test_the_x310_receiver_sets_the_radio_up_and_shows_the_tap(compiled):
    shown = told_by(with_fake_radio(compiled[0], RECEIVE))
    magnitude = np.reshape(shown, (-1, 511))
    # Half scale, 5 samples late: at no other delay more than a sidelobe of the m-sequence.
    assert len(magnitude) == 50 and np.allclose(magnitude[:, 5], 0.5, atol=1e-5)
    assert np.allclose(np.delete(magnitude, 5, axis=1), 0.5 / 511, atol=1e-5)


@pytest.mark.parametrize("name", ["x310_transmitter", "x310_receiver"])
def test_a_radio_flowgraph_without_a_radio_says_so(compiled, name):
    home, _ = compiled
    env = cast_grc.environment(os.environ) | {"HOME": str(home), "QT_QPA_PLATFORM": "offscreen"}
    command = ["/usr/bin/python3", f"{name}.py", "-a", "addr=192.0.2.1"]
    done = subprocess.run(command, env=env, cwd=home, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert (
        "Traceback" not in done.stderr
        and line.startswith("error: device: got arguments 'addr=192.0.2.1'")
        and "No devices found" in line
    )


@pytest.mark.parametrize(
    ("program", "answers", "words"),
    [(TRANSMIT, {"samp_rate": 25.6e6}, "master clock"), (RECEIVE, {"gain": 11.5}, "11.5 dB"),
     (TRANSMIT, {"ref_locked": False}, "does not lock")],
    ids=["rate", "gain", "lock"],
)  # fmt: skip
def test_a_radio_flowgraph_reads_back_what_the_device_does(compiled, program, answers, words):
    done = with_fake_radio(compiled[0], program, **answers)
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert words in line and "Traceback" not in done.stderr


def test_an_unknown_flowgraph_is_refused_with_the_names_of_the_shipped_ones():
    done = subprocess.run([str(ROOT / "apps" / "cast_grc.py"), "loopbak"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("error: flowgraph: got 'loopbak'") and "four_node_emulator" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_gnuradio_companion_opens_where_the_blocks_are_found(tmp_path):
    """The program hands over to gnuradio-companion, here a stand-in that prints what it was given."""
    stand_in = tmp_path / "gnuradio-companion"
    stand_in.write_text('#!/bin/sh\necho "$GRC_BLOCKS_PATH" "$PYTHONPATH" "$@"\n')
    stand_in.chmod(0o755)
    env = {"PATH": str(tmp_path), "PYTHONPATH": "", "GRC_BLOCKS_PATH": ""}
    done = subprocess.run([str(ROOT / "apps" / "cast_grc.py")], env=env, capture_output=True, text=True, timeout=60, check=True)
    blocks, python, flowgraph = done.stdout.split()
    assert (Path(blocks) / "cast_glfsr_source.block.yml").is_file()
    assert (Path(python) / "gr_cast" / "blocks").is_dir()
    assert Path(flowgraph).name == "loopback.grc"
