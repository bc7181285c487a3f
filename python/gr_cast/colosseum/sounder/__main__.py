# SPDX-License-Identifier: GPL-3.0-or-later
"""Begun when the container boots, READY once it is loaded. After start.sh it sounds all pairs, gathers what others found (over
col0) and leaves the map in /logs; after stop.sh it ends what it has begun."""

import configparser
import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from ...core.documents import json_file
from ...core.errors import CastError
from ...core.files import write_json, write_text
from ...core.units import db_from_amplitude
from ...signals.recording import Recording
from ...signals.waveform import entry_from_text, waveform_from_entry
from ...sounding import path_loss
from ...sounding.sound import LinkBudget, SoundingOptions, sound
from .gather import gathered
from .radio import Slots, arguments, exchange

API = Path(os.environ.get("CAST_RADIO_API", "/root/radio_api"))
LOGS = Path(os.environ.get("CAST_LOGS", "/logs"))
STATE = Path(os.environ.get("CAST_STATE", "/root/cast/state"))
USRP = "addr=192.168.40.2"  # of an SRN's X310, where nothing else is said
START, STOP = STATE.with_name("start"), STATE.with_name("stop")  # made by the scripts of those names
MISSING = ": a batch job brings it (ModemConfig), an interactive box by up --config FILE, or put it there before start.sh"
_FRAMES = 10
_LOOK_S = 0.05
_DRAW_S = 15.0


def tell(state: str, info: str = "") -> None:
    """What status.sh prints from now on."""
    write_text(STATE, json.dumps({"STATUS": state, "INFO": info}) + "\n")


def settings() -> dict:
    """radio.conf, read strictly: how many nodes, which this is, the code and how often it is repeated in a slot."""
    get = json_file(API / "radio.conf", missing=MISSING)
    conf = get.keys(
        get.document, "", ("cast_sounder", "nodes", "node", "code", "periods", "amplitude"), ("cast_sounder", "nodes")
    )
    get.version("cast_sounder", 1)
    nodes = get.whole(conf.get("nodes"), "nodes", "nodes", 2, 128)
    named = re.search(r"srn([0-9]+)", socket.gethostname())
    found = {
        "nodes": nodes,
        "node": get.whole(conf.get("node", int(named[1]) if named else None), "node", "nodes", 1, nodes),
        "code": get.text(conf.get("code", "glfsr:10"), "code"),
        "periods": get.whole(conf.get("periods", 500), "periods", "periods of the code", _FRAMES, 100_000),
        "amplitude": get.number(conf.get("amplitude", 1.0), "amplitude", "full scale", 1e-3, 1.0),
    }
    get.faults.raise_if_any()
    return found


def column(conf: dict, heard: dict[int, np.ndarray], rate_hz: float, waveform, is_one_clock: bool) -> dict[str, float | None]:
    """Path loss in dB from every other node to this one; None where nothing was heard."""
    budget = LinkBudget(tx_power_dbm=float(db_from_amplitude(conf["amplitude"])))
    options = SoundingOptions(
        average=conf["periods"] // _FRAMES, carrier_offset_hz=0.0 if is_one_clock else None, budget=budget
    )  # fmt: skip
    losses = {}
    for slot, samples in sorted(heard.items()):
        taken = Recording(samples=samples, sample_rate_hz=rate_hz)
        try:
            found = sound(taken, waveform, options).path_loss_db
        except CastError as error:
            print(f"{slot + 1}>{conf['node']}: {error}", flush=True)
            found = None
        losses[str(slot + 1)] = None if found is None or not np.isfinite(found) else float(found)
    return losses


def leave_map(columns: dict[int, dict], rate_hz: float) -> subprocess.Popen:
    """heatmap.json and .csv; the process that draws .png, where there is matplotlib."""
    losses = {(tx, str(rx)): [loss] for rx, column in columns.items() for tx, loss in column.items()}
    nodes, matrix = path_loss.loss_matrix(losses)
    rows = [[float(value) if np.isfinite(value) else None for value in row] for row in matrix]
    write_json(LOGS / "heatmap.json", {"nodes": nodes, "path_loss_db": rows, "sample_rate_hz": rate_hz})
    write_text(LOGS / "heatmap.csv", path_loss.matrix_csv(nodes, matrix))
    # A process of its own: pictures are drawn by a later room, and nothing else needs matplotlib.
    return subprocess.Popen([sys.executable, "-m", "gr_cast.report.colosseum_map", str(LOGS)])


def told(path: Path) -> threading.Event:
    """Set once the file is there."""
    event = threading.Event()

    def look() -> None:
        while not path.exists():
            time.sleep(_LOOK_S)
        event.set()

    threading.Thread(target=look, daemon=True).start()
    return event


def main() -> None:
    started, stopped = told(START), told(STOP)
    tell("READY", "loaded")
    while not started.wait(_LOOK_S):
        if stopped.is_set():
            tell("FINISHED", "was never started")
            return
    tell("ACTIVE", "sounding")
    conf = settings()
    config = configparser.ConfigParser()
    config.read(API / "colosseum_config.ini")
    device_args = config.get("RADIO", "device_args", fallback=USRP)
    is_box = arguments(device_args).get("driver") == "zmq"
    rate_hz = float(arguments(device_args).get("base_srate") or config.get("RF", "rf_bandwidth"))
    waveform = waveform_from_entry(entry_from_text(conf["code"], samples_per_chip=1, repeat=True))
    period = (conf["amplitude"] * waveform.samples).astype(np.complex64)
    slots = Slots(
        own=conf["node"] - 1, total=conf["nodes"], count=conf["periods"] * len(period), guard=8 * len(period), rate_hz=rate_hz,
        carrier_hz=config.getfloat("RF", "center_frequency", fallback=1e9),
    )  # fmt: skip
    began = time.monotonic()
    heard = exchange(device_args, slots, period, stopped)
    print(f"{len(heard)} slots of {slots.count} samples heard in {time.monotonic() - began:.1f} s", flush=True)
    tell("ACTIVE", "post-processing")
    own = column(conf, heard, rate_hz, waveform, is_box)
    write_json(LOGS / "column.json", {"receiver": conf["node"], "path_loss_db": own})
    tell("ACTIVE", "gathering")
    port = config.getint("COLLABORATION", "collab_peer_port", fallback=5558)
    columns = gathered(conf["node"], own, conf["nodes"], port, stopped)
    drawing = leave_map(columns, rate_hz)
    tell("ACTIVE", f"map of {len(columns)} of {conf['nodes']} receivers in /logs")
    stopped.wait()
    with contextlib.suppress(subprocess.TimeoutExpired):
        drawing.wait(_DRAW_S)  # the figures are there: nobody waits long for their picture
    tell("FINISHED", f"map of {len(columns)} of {conf['nodes']} receivers in /logs")
    threading.Event().wait()  # others may still need what this node answers and tells


if __name__ == "__main__":
    try:
        main()
    except CastError as error:  # what its user can mend is a line, not a traceback
        tell("ERROR", str(error)[:500])
        sys.exit(str(error))
    except Exception as error:
        tell("ERROR", str(error)[:500])
        raise
