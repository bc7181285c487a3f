# SPDX-License-Identifier: GPL-3.0-or-later
"""One repeat of an experiment at a site: nodes send, the air carries, nodes receive and tell their figures."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path

from ..core.documents import json_file, short
from ..core.errors import CastError
from ..scenario import Scenario
from ..signals import on_air, recording
from .air import carried, samples_of
from .clean import Room
from .document import GAIN, RESIDUAL, Experiment, Pipeline, scenario_of
from .image import STACK
from .patience import Stopped
from .residual import explained
from .site import Site

RUN = "run"  # the folder of a room that commands write to
LONGEST_SERIES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What one repeat told: figures and series by "NODE NAME", why it failed, and the stems of its recordings by receiver.
    Of one that `is_stopped` by a limit nothing is known: it is not kept."""

    metrics: dict[str, float] = field(default_factory=dict)
    series: dict[str, dict] = field(default_factory=dict)
    recordings: dict[str, Path] = field(default_factory=dict)
    fails: str | None = None
    is_stopped: bool = False


def tried(
    pipeline: Pipeline, experiment: Experiment, tree: Path, site: Site, repeat: int, seed: int, room: Room, folder: Path
) -> dict:
    """Try one repeat in a room's `folder` that holds the unpacked image; `tree` are the commit's files. Recordings and traffic
    lie in `folder`/run afterwards.

    `repeat` is what commands are seeded by, alike at all sites; `seed` is that of the emulator's noise. Raises Stopped where a
    limit was reached.
    """
    run, rate_hz, scenario = folder / RUN, pipeline.sample_rate_hz, scenario_of(experiment, tree)
    run.mkdir()
    if experiment.traffic:
        shutil.copyfile(tree / experiment.traffic, run / "traffic.yaml")
    sent, longest = {}, round(experiment.duration_s * rate_hz)
    try:
        for name, node in experiment.nodes.items():
            if node.transmit:
                _command(pipeline, experiment, site, name, node.transmit, repeat, room, folder)
                sent[name] = samples_of(run / f"tx_{name}.cf32", f"node {name}: transmit")
                if len(sent[name]) > longest:
                    raise CastError(f"node {name}: transmit: sends {len(sent[name])} samples, the experiment has {longest}")
        receivers = [name for name, node in experiment.nodes.items() if node.receive]
        heard = carried(site, scenario, sent, receivers, rate_hz, seed, run, pipeline.limits.program_s)
        metrics, series = {}, {}
        for name in receivers:
            heard[name].astype("<c8").tofile(run / f"rx_{name}.cf32")
            _command(pipeline, experiment, site, name, experiment.nodes[name].receive, repeat, room, folder)
            told = _told(run / f"result_{name}.json", name)
            metrics |= {f"{name} {key}": value for key, value in told["metrics"].items()}
            left_db, gain_db = explained(scenario, sent, name, heard[name], rate_hz)
            metrics |= {f"{name} {RESIDUAL}": left_db, f"{name} {GAIN}": gain_db}
            series |= {f"{name} {key}": value for key, value in told["series"].items()}
    except Stopped:
        raise
    except CastError as error:
        return {"fails": " ".join(error.faults), "metrics": {}, "series": {}, "receivers": []}
    _record(run, scenario, sent, heard, rate_hz)
    return {"fails": None, "metrics": metrics, "series": series, "receivers": receivers}


def _command(pipeline, experiment, site, name, command, repeat, room: Room, folder: Path) -> None:
    at, place = f"{room.place(folder)}/{RUN}", site.place(name)
    environment = {
        "CAST_NODE": name,
        "CAST_DEVICE": place.device,
        "CAST_INTERFACE": place.interface,
        "CAST_SEED": str(experiment.seed + repeat),
        "CAST_DURATION_S": f"{experiment.duration_s:.17g}",
        "CAST_SAMPLE_RATE_HZ": f"{pipeline.sample_rate_hz:.17g}",
        "CAST_TRAFFIC": f"{at}/traffic.yaml" if experiment.traffic else "",
        "CAST_TX": f"{at}/tx_{name}.cf32",
        "CAST_RX": f"{at}/rx_{name}.cf32",
        "CAST_RESULT": f"{at}/result_{name}.json",
    }
    timeout_s = pipeline.limits.command_s + experiment.duration_s
    done = room.run(folder, command, within=STACK, environment=environment, timeout_s=timeout_s)
    if done.status is None:
        raise Stopped(f"node {name}: {command}: {done.stopped_after(timeout_s)}", "command_s")
    if done.status != 0:
        raise CastError(f"node {name}: {command}: status {done.status}: {done.last_line}")


def _told(path: Path, name: str) -> dict:
    """What a node says of itself: {"metrics": {NAME: number}, "series": {NAME: {"time_s": […], "value": […]}}}."""
    get = json_file(path, missing=f": node {name} has to write its figures to $CAST_RESULT")
    document = get.keys(get.document, "", {"metrics", "series"}, ("metrics",))
    metrics = get.mapping(document.get("metrics", {}), "metrics")
    for key, value in metrics.items():
        get.name(key, "metrics")
        get.number(value, f"metrics.{key}")
    series = get.mapping(document.get("series", {}), "series")
    for key, entry in series.items():
        get.name(key, "series")
        entry = get.keys(entry, f"series.{key}", {"time_s", "value"}, ("time_s", "value"))
        lengths = {len(get.sequence(entry.get(part, []), f"series.{key}.{part}")) for part in ("time_s", "value")}
        if len(lengths) > 1 or max(lengths) > LONGEST_SERIES:
            get.faults.add(f"series.{key}", f"got {short(sorted(lengths))} values, needs as many times, at most {LONGEST_SERIES}")
    get.faults.raise_if_any()
    return {"metrics": metrics, "series": series}


def _record(run: Path, scenario: Scenario, sent: dict, heard: dict, rate_hz: float) -> None:
    """SigMF recordings of what was sent and heard, which say who was on the air; the bare samples go."""
    about = dict(sample_rate_hz=rate_hz, center_frequency_hz=scenario.center_frequency_hz)
    for name, samples in sent.items():
        recording.write(run / f"tx_{name}", samples, **about)
    for name, samples in heard.items():
        here = {tx: {"file": f"tx_{tx}", "repeat": False} for tx in sent if (tx, name) in scenario.links}
        fields = on_air.fields(here) | {"cast:receiver": name, "cast:scenario": scenario.name}
        recording.write(run / f"rx_{name}", samples, **about, fields=fields)
    for path in run.glob("*.cf32"):
        path.unlink()


def read_trial(result: dict, folder: Path) -> Trial:
    """A kept result with its recordings."""
    return Trial(
        metrics=result["metrics"],
        series=result["series"],
        recordings={name: folder / RUN / f"rx_{name}" for name in result["receivers"]},
        fails=result["fails"],
    )
