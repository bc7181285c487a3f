# SPDX-License-Identifier: GPL-3.0-or-later
"""The eight steps from a place to an installed scenario, each with its result on disk, its time, memory and error.

A step is done anew when its own part of the SPEC or anything before it has changed; otherwise its result is taken up,
and within sampling, parsing and approximation every finished task.
"""

import csv
import hashlib
import json
import pickle
import resource
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ... import __version__
from ...core import tasks
from ...core.documents import Reader, json_file
from ...core.errors import CastError, Faults
from ...core.files import locked, sweep, write_json, write_text, written_aside
from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_amplitude, power_from_db
from .. import catalogue, zarr_file
from ..band import path_gain_matrix_db, taps_over_band_db
from ..model import GRID_STEP_S, MAX_DELAY_S, LinkTaps, Scenario, link_name
from . import effects, geometry, materials, mirrors, model, nodes, paths, reduce, scene_file, trace
from .spec import SWITCHES, Spec

STEPS = ("environment", "model", "materials", "nodes", "sampling", "parsing", "approximation", "install")
_SECTIONS = {
    "environment": ("environment",), "model": ("model",), "materials": ("materials",),
    "nodes": ("nodes", "node_grids", "sampling"),
    "sampling": ("sampling",), "parsing": (), "approximation": ("approximation",), "install": ("id", "name", "description"),
}  # fmt: skip
_RECORD = ("fingerprint", "result", "seconds", "peak_mib", "summary")  # of a step that is done
_CHUNK_TRANSMITTERS = 7  # static transmitters per task: bounds the tracer's memory
_LINKS_PER_TASK = 8


@dataclass(frozen=True, kw_only=True)
class Run:
    """Where and how to run: the work folder, who to tell of progress, and the Dask scheduler, if any."""

    folder: Path
    tell: Callable[[str], None] = print
    progress: Callable[[str, int, int], None] = lambda step, done, total: None
    dask: str | None = None


def create(spec: Spec, run: Run, only: str | None = None) -> dict:
    """Do every step that is not done yet, or up to `only`; returns the record of all steps (also in steps.json)."""
    spec = effects.world(spec)
    run.folder.mkdir(parents=True, exist_ok=True)
    with locked(run.folder):
        sweep(run.folder)
        record = _read_record(run.folder)
        fingerprint = hashlib.sha256(f"{__version__}".encode()).hexdigest()
        for step in STEPS:
            fingerprint = _fingerprint(fingerprint, spec, step)
            done = record.get(step, {})
            # The catalogue is another place, and may have changed: installing is always looked at again.
            if step != "install" and done.get("fingerprint") == fingerprint and (run.folder / done["result"]).exists():
                run.tell(f"{step}: done before, taken up")
            else:
                record[step] = _do(spec, run, step, fingerprint)
                write_json(run.folder / "steps.json", record)
            if step == only:
                break
    return record


def _do(spec: Spec, run: Run, step: str, fingerprint: str) -> dict:
    """Do one step, on top of what a run with the same fingerprint left of it; returns its record."""
    folder = run.folder / step
    mark = folder / "fingerprint"
    if folder.exists() and not (mark.is_file() and mark.read_text() == fingerprint):
        shutil.rmtree(folder)
    folder.mkdir(exist_ok=True)
    sweep(folder)
    if not mark.exists():
        write_text(mark, fingerprint)
    start = time.monotonic()
    _forget_peak()
    result, summary = globals()[f"_{step}"](spec, run, folder)
    seconds = time.monotonic() - start
    peak_mib = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024
    about = ", ".join(f"{key} {value}" for key, value in summary.items())
    run.tell(f"{step}: {seconds:.1f} s, peak {peak_mib:.0f} MiB: {about}")
    return {
        "fingerprint": fingerprint, "result": str(result.relative_to(run.folder)), "seconds": round(seconds, 3),
        "peak_mib": round(peak_mib), "summary": summary,
    }  # fmt: skip


def _forget_peak() -> None:
    """Peak memory counts from here on, so that a step is not told the peak of one before it (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _read_record(folder: Path) -> dict:
    path = folder / "steps.json"
    if not path.exists():
        return {}
    get = json_file(path)
    for step, entry in get.document.items():
        entry = get.keys(entry, step, _RECORD, _RECORD)
        get.path_inside(entry.get("result"), f"{step}.result")
    if get.faults:
        get.faults.add("", "delete the folder to start anew")
    get.faults.raise_if_any()
    return get.document


def _fingerprint(before: str, spec: Spec, step: str) -> str:
    own = {name: spec.sections.get(name) for name in _SECTIONS[step]}
    own |= {"effects": [entry for entry in spec.effects if effects.step_of(entry) == step]}
    own |= {"tracer": _tracer()} if step == "sampling" else {}
    # What a material's name stands for is no part of the file.
    content = {"model": spec.model_path.read_bytes, "materials": lambda: repr(spec.materials).encode()}.get(step, bytes)()
    return hashlib.sha256(json.dumps([before, step, own], sort_keys=True, default=str).encode() + content).hexdigest()


def _save(path: Path, value) -> Path:
    with written_aside(path) as aside:
        aside.write_bytes(pickle.dumps(value))
    return path


def _load(run: Run, name: str):
    """A result that this program wrote itself in its work folder."""
    return pickle.loads((run.folder / name).read_bytes())


def _every_task(run: Run, folder: Path, function: Callable, common, inputs: dict, processes: int | None = None) -> Iterator:
    """Yield function(common, input) of every named input, in their order, when all are done. Each is kept in a file of its
    name: what a run that was killed has finished is not done again."""
    files = {name: folder / f"{name}.pickle" for name in inputs}
    todo = [name for name, file in files.items() if not file.exists()]
    done = len(files) - len(todo)
    left = [inputs[name] for name in todo]
    for index, result in tasks.run(function, common, left, dask=run.dask, processes=processes):
        _save(files[todo[index]], result)
        done += 1
        run.progress(folder.name, done, len(files))
    for file in files.values():
        yield pickle.loads(file.read_bytes())


def _environment(spec: Spec, run: Run, folder: Path):
    summary = {
        "place": spec.place or spec.name, "carrier_hz": spec.carrier_hz, "bandwidth_hz": spec.bandwidth_hz,
        "area_m": list(spec.area_m) if spec.area_m else "all of the model",
    }  # fmt: skip
    path = folder / "environment.json"
    write_json(path, summary)
    return path, summary | effects.summary(spec.effects)


def _model(spec: Spec, run: Run, folder: Path):
    solids, summary = model.read(spec)
    low, high = geometry.bounds_m(solids)
    summary = {"objects": len(solids), "faces": sum(len(solid.faces) for solid in solids), **summary}
    summary["flat sheets"] = sum(geometry.is_flat(solid) for solid in solids)
    hulls = [solid for solid in solids if not geometry.is_flat(solid) and not geometry.is_closed(solid)]
    summary["open hulls"] = "; ".join(map(_where_open, hulls[:20])) + (" …" if len(hulls) > 20 else "") or "none"
    summary["size_m"] = np.round(high - low, 3).tolist()
    if spec.area_m is not None:
        west, south, east, north = spec.area_m
        if low[0] > east or high[0] < west or low[1] > north or high[1] < south:
            raise CastError(f"environment.area_m: is empty: the model lies from {low[:2]} to {high[:2]} m")
    return _save(folder / "solids.pickle", solids), summary


def _where_open(solid: geometry.Solid) -> str:
    edges_m = geometry.open_edges_m(solid)
    return f"{solid.name} ({len(edges_m)} open edges, one at {np.round(edges_m[0], 3).tolist()} m)"


def _materials(spec: Spec, run: Run, folder: Path):
    before = _load(run, "model/solids.pickle")
    solids = effects.with_ground(spec.effects, materials.assign(before, spec.materials, spec.carrier_hz))
    used = Counter(solid.medium.material or "of its own numbers" for solid in solids)
    summary = {"objects in": len(before), "objects out": len(solids), **dict(sorted(used.items()))}
    scene_file.write(folder, solids, spec.carrier_hz)  # for other tools; the tracer makes its own
    return _save(folder / "solids.pickle", solids), summary


def _nodes(spec: Spec, run: Run, folder: Path):
    times_s = nodes.sampling_times_s(list(spec.nodes), spec.duration_s, spec.step_s)
    rooms = nodes.check(list(spec.nodes), _load(run, "materials/solids.pickle"), times_s, spec.step_s)
    tracks = {node.name: nodes.position_m(node, times_s) for node in spec.nodes}
    moving = [node for node in spec.nodes if node.is_moving]
    farthest_m = max((node.speed_m_per_s * spec.step_s for node in moving), default=0.0)
    path = _save(folder / "tracks.pickle", (times_s, tracks))
    summary = {"nodes": len(tracks), "moving": len(moving), "instants": len(times_s), "step_m": round(farthest_m, 4)}
    return path, summary | ({"all inside": ", ".join(rooms)} if rooms else {})


_TRACERS = {"Sionna RT": trace, mirrors.NAME: mirrors}


def _tracer() -> str:
    """The ray tracer where it is installed, else mirror images; they agree, but not to the last bit."""
    return next(name for name, module in _TRACERS.items() if module.is_installed())


def _trace_task(scene, task: trace.Task) -> trace.Traced:
    tracer, *place = scene
    return _TRACERS[tracer].run(*place, task)


def _task(spec: Spec, name: str, pairs, time_s: float) -> trace.Task:
    when = np.array([time_s])
    return trace.Task(
        name=name,
        pairs=tuple(pairs),
        antennas=tuple(node.antenna for node in spec.nodes),
        orientation_rad=np.array([node.orientation_rad for node in spec.nodes]),
        position_m=np.concatenate([nodes.position_m(node, when) for node in spec.nodes]),
        velocity_before=np.concatenate([nodes.velocity_m_per_s(node, when, "left") for node in spec.nodes]),
        velocity_after=np.concatenate([nodes.velocity_m_per_s(node, when, "right") for node in spec.nodes]),
    )


def _check_times_s(times_s: np.ndarray, count: int) -> np.ndarray:
    """Instants in the middle of traced ones, spread over the whole time: what the interpolation is checked at."""
    middles = (times_s[1:] + times_s[:-1]) / 2
    return (
        middles[np.unique(np.linspace(0, len(middles) - 1, count).round().astype(int))] if len(middles) and count else middles[:0]
    )


def _sampling(spec: Spec, run: Run, folder: Path):
    """Every pair once: static ones at one instant, those with a moving node at every instant; the way back is the same."""
    times_s, _ = _load(run, "nodes/tracks.pickle")
    solids, tracer = _load(run, "materials/solids.pickle"), _tracer()
    switches = {key: getattr(spec, key) for key in SWITCHES}
    settings = trace.Settings(carrier_hz=spec.carrier_hz, max_depth=spec.max_depth, rays=spec.rays, **switches)
    moving = [index for index, node in enumerate(spec.nodes) if node.is_moving]
    static = [index for index, node in enumerate(spec.nodes) if not node.is_moving]
    jobs = []
    for start in range(0, len(static) - 1, _CHUNK_TRANSMITTERS):
        chunk = static[start : start + _CHUNK_TRANSMITTERS]
        pairs = [(a, b) for a in chunk for b in static if b > a]
        jobs.append(_task(spec, f"static_{start:05d}", pairs, 0.0))
    pairs = [(a, b) for a in moving for b in range(len(spec.nodes)) if b != a and (b not in moving or b > a)]
    checks_s = _check_times_s(times_s, spec.check_instants) if moving else []
    if moving:
        jobs += [_task(spec, f"step_{index:05d}", pairs, time_s) for index, time_s in enumerate(times_s)]
        jobs += [_task(spec, f"check_{index:05d}", pairs, time_s) for index, time_s in enumerate(checks_s)]
    inputs = {job.name: job for job in jobs}
    tables = list(_every_task(run, folder, _trace_task, (tracer, solids, settings), inputs, processes=_TRACERS[tracer].PROCESSES))
    summary = {"by": tracer, "tasks": len(jobs), "pairs": len(static) * (len(static) - 1) // 2 + len(pairs)}
    if lost := _TRACERS[tracer].left_out(settings):
        summary["left out"] = f"{lost}: {trace.not_installed()}"
    summary["paths"] = int(sum(len(table.tx) for table in tables))
    return _save(folder / "all.pickle", (times_s, checks_s)), summary


def _parse_tables(about: dict, job: tuple) -> tuple[dict, list[float]]:
    (time_s, tables), (checks_s, checks) = job
    links = paths.by_link(tables, time_s)
    return links, paths.interpolation_error_db(links, checks, checks_s, **about)


def _parsing(spec: Spec, run: Run, folder: Path):
    times_s, checks_s = _load(run, "sampling/all.pickle")
    source = run.folder / "sampling"
    static, steps, checks = (
        [pickle.loads(path.read_bytes()) for path in sorted(source.glob(f"{kind}_*.pickle"))]
        for kind in ("static", "step", "check")
    )
    inputs = {f"static_{index:05d}": ((np.zeros(1), [table]), ([], [])) for index, table in enumerate(static)}
    for index, batch in enumerate(paths.batches(steps + checks, _LINKS_PER_TASK)):
        inputs[f"moving_{index:05d}"] = (times_s, batch[: len(steps)]), (checks_s, batch[len(steps) :])
    about = dict(carrier_hz=spec.carrier_hz, bandwidth_hz=spec.bandwidth_hz)
    links, errors_db = {}, []
    for own, own_db in _every_task(run, folder, _parse_tables, about, inputs):
        for (tx, rx), link in own.items():
            links[tx, rx] = effects.on_link(spec.effects, spec.nodes[tx].name, spec.nodes[rx].name, link, spec.carrier_hz)
        errors_db += own_db
    moving = [link for link in links.values() if len(link.time_s) > 1]
    late = _beyond_reach(spec, links)
    changes = sum(paths.births_and_deaths(link) for link in moving)
    summary = {"links": len(links), "moving links": len(moving), "paths that appear or vanish": changes}
    if late:
        summary["paths beyond the last tap, lost"] = late
    if errors_db:
        summary |= {
            "interpolation median dB": round(float(np.median(errors_db)), 2),
            "interpolation 90 % dB": round(float(np.percentile(errors_db, 90)), 2),
        }
    paths.write(folder / "links.npz", links)
    return folder / "links.npz", summary


def _beyond_reach(spec: Spec, links: dict) -> int:
    """How many paths come later than the last tap. Raises CastError for links of which nothing is left, and without links."""
    if not links:
        raise CastError(
            "sampling: no pair of nodes has a path: set sampling.refraction to let walls through, or raise sampling.max_depth"
        )
    late, faults = 0, Faults("parsing")
    for (tx, rx), link in links.items():
        delay_s = np.where(link.gain != 0, link.delay_s, np.inf)
        late += int((np.isfinite(delay_s) & (delay_s > MAX_DELAY_S)).sum())
        first_s = delay_s.min(axis=1)
        worst = int(np.argmax(np.where(np.isfinite(first_s), first_s, 0.0)))
        if MAX_DELAY_S < first_s[worst] < np.inf:
            faults.add(
                link_name((spec.nodes[tx].name, spec.nodes[rx].name)),
                f"at {link.time_s[worst]:g} s its first path takes {1e6 * first_s[worst]:.2f} us "
                f"({first_s[worst] * SPEED_OF_LIGHT_M_PER_S:.0f} m), the last tap is at {1e6 * MAX_DELAY_S:.2f} us",
            )
    faults.raise_if_any()
    return late


def _band_hz(spec: Spec) -> float:
    """What taps on the grid can stand for of the SPEC's band: they repeat beyond one over its step."""
    return min(spec.bandwidth_hz, 1 / GRID_STEP_S)


def _reduce_links(about: dict, links: dict[tuple[int, int], paths.LinkPaths]) -> dict[tuple[int, int], reduce.Reduced]:
    return {pair: reduce.reduce(reduce.Job(link=link, **about)) for pair, link in links.items()}


def _approximation(spec: Spec, run: Run, folder: Path):
    links = paths.read(run.folder / "parsing/links.npz")
    clock_s = np.arange(int(spec.duration_s / spec.update_s + 1e-6) + 1) * spec.update_s
    pairs = sorted(links)
    groups = [pairs[start : start + _LINKS_PER_TASK] for start in range(0, len(pairs), _LINKS_PER_TASK)]
    about = dict(
        carrier_hz=spec.carrier_hz,
        bandwidth_hz=_band_hz(spec),
        method=spec.method,
        clock_s=clock_s,
        hold_s=spec.hold_s,
    )
    inputs = {f"links_{index:05d}": {pair: links[pair] for pair in group} for index, group in enumerate(groups)}
    every: dict = {}
    for reduced in _every_task(run, folder, _reduce_links, about, inputs):
        every |= reduced
    strongest = max(np.abs(item.gain).max() for item in every.values())
    floor = strongest * 10 ** (-spec.dynamic_range_db / 20)
    weak = sum(int(((np.abs(item.gain) < floor) & (item.gain != 0)).sum()) for item in every.values())
    names = [node.name for node in spec.nodes]
    _write_losses(folder / "losses.csv", names, every)
    nmse_db = np.concatenate([item.loss.nmse_db for item in every.values()])
    power_db = np.concatenate([item.loss.power_error_db for item in every.values()])
    spread_s = np.concatenate([item.loss.delay_spread_error_s for item in every.values()])
    steps_db = np.abs(np.concatenate([item.power_step_db for item in every.values()]))
    summary = {
        "NMSE median dB": round(float(np.median(nmse_db)), 2), "NMSE 90 % dB": round(float(np.percentile(nmse_db, 90)), 2),
        "power error median dB": round(float(np.median(power_db)), 3) + 0.0,  # never -0.0
        "delay spread error median ns": round(1e9 * float(np.median(spread_s)), 3),
        **({"power step between holds, largest dB": round(float(steps_db.max()), 3)} if steps_db.size else {}),
        "base loss dB": round(-float(db_from_amplitude(strongest)), 3),
        "taps below the dynamic range": weak,
    }  # fmt: skip
    if _band_hz(spec) < spec.bandwidth_hz:
        summary["over MHz"] = _band_hz(spec) / 1e6
    return _save(folder / "all.pickle", (clock_s, every, float(strongest), float(floor))), summary


def _write_losses(path: Path, names: list[str], every: dict) -> None:
    with written_aside(path) as aside, open(aside, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["link", "nmse_db", "power_error_db", "delay_spread_error_s", "largest_shift_s", "largest_power_step_db"])
        for (tx, rx), item in every.items():
            medians = [
                float(np.median(v))
                for v in (item.loss.nmse_db, item.loss.power_error_db, item.loss.delay_spread_error_s)
                if v.size
            ]
            largest = [float(np.abs(values).max(initial=0.0)) for values in (item.shift_s, item.power_step_db)]
            table.writerow([link_name((names[tx], names[rx])), *medians, *largest])


def scenario(spec: Spec, run: Run) -> Scenario:
    """The scenario that the approximation made: strongest tap 0 dB, the rest of the loss as base loss."""
    clock_s, every, strongest, floor = _load(run, "approximation/all.pickle")
    names = [node.name for node in spec.nodes]
    links = {}
    for (tx, rx), item in every.items():
        gain = np.where(np.abs(item.gain) < floor, 0.0, item.gain / strongest)
        if (gain != 0).any():
            links[names[tx], names[rx]] = links[names[rx], names[tx]] = LinkTaps(delay_s=item.delay_s, gain=gain)
    moving = any(not taps.is_static for taps in links.values())
    clock_s = clock_s if moving else np.zeros(1)
    where = {node.name: nodes.position_m(node, clock_s if node.is_moving and moving else np.zeros(1)) for node in spec.nodes}
    return Scenario(
        name=spec.name,
        description=spec.description,
        nodes=tuple(names),
        links=links,
        time_s=clock_s,
        center_frequency_hz=spec.carrier_hz,
        bandwidth_hz=_band_hz(spec),
        base_loss_db=-float(db_from_amplitude(strongest)),
        position_m=where,
    )


def delays_moved_s(spec: Spec, run: Run) -> list:
    """[tx, rx, [seconds of each hold]]: how far the delays of each link were moved to fit the grid."""
    every = _load(run, "approximation/all.pickle")[1]
    names = [node.name for node in spec.nodes]
    return [[names[tx], names[rx], item.shift_s.tolist()] for (tx, rx), item in every.items()]


def lost(spec: Spec, run: Run) -> dict[tuple[str, str], float]:
    """Energy that each link's taps lose over the band, over its own: the mean of all instants."""
    every = _load(run, "approximation/all.pickle")[1]
    names = [node.name for node in spec.nodes]
    return {
        (names[tx], names[rx]): float(np.mean(power_from_db(item.loss.nmse_db)))
        for (tx, rx), item in every.items()
        if item.loss.nmse_db.size
    }


def content_hash(made: Scenario) -> str:
    """A name for what a scenario plays: equal for equal taps, nodes and clock."""
    digest = hashlib.sha256(json.dumps([made.nodes, made.base_loss_db, made.interpolation]).encode())
    digest.update(made.time_s.tobytes())
    for key, taps in sorted(made.links.items()):
        digest.update("|".join(key).encode() + taps.delay_s.tobytes() + taps.gain.astype(np.complex64).tobytes())
    return digest.hexdigest()


def _install(spec: Spec, run: Run, folder: Path):
    target = catalogue.installed_folder() / f"{spec.id}.zarr"
    target.parent.mkdir(parents=True, exist_ok=True)
    with locked(target.parent):
        sweep(target.parent)
        made = scenario(spec, run)
        content = content_hash(made)
        version = _write(spec, run, made, content, target)
    matrix = path_gain_matrix_db(made)
    finite = matrix[np.isfinite(matrix)]
    size_mb = sum(file.stat().st_size for file in target.rglob("*") if file.is_file()) / 1e6
    summary = {
        "id": spec.id, "version": version, "sha256": content[:12], "megabytes": round(size_mb, 2),
        f"path loss dB in {_band_hz(spec) / 1e6:g} MHz": f"{-finite.max():.1f} to {-finite.min():.1f}",
    }  # fmt: skip
    least_db, most_db = taps_over_band_db(made)
    if max(most_db, -least_db) >= 0.05:
        summary["sum of |tap|² over that, dB"] = f"{least_db:+.1f} to {most_db:+.1f}"
    write_json(folder / "installed.json", summary | {"path": str(target)})
    return folder / "installed.json", summary


def _write(spec: Spec, run: Run, made: Scenario, content: str, target: Path) -> int:
    """Write the scenario to the catalogue; the same content keeps its version, which is returned."""
    version = 1
    if target.exists():
        about = zarr_file.attributes(target)
        get = Reader(f"{target}: .zattrs", about)
        version = get.whole(about.get("version", 0), "version", "versions", 0, 10**9) + (about.get("content_sha256") != content)
        get.faults.raise_if_any()
    radios = {
        node.name: {"antenna": node.antenna, "power_dbm": node.power_dbm, "noise_figure_db": node.noise_figure_db}
        for node in spec.nodes
    }
    record = _read_record(run.folder)
    steps = {step: {key: entry[key] for key in ("seconds", "peak_mib", "summary")} for step, entry in record.items()}
    zarr_file.write(
        target, made, id=spec.id, version=version, content_sha256=content, radios=radios, steps=steps,
        paths_file=str((run.folder / "parsing/links.npz").resolve()),
        delays_moved_s=delays_moved_s(spec, run), hold_s=spec.hold_s,
        outlines=geometry.outlines(_load(run, "materials/solids.pickle")),
    )  # fmt: skip
    return version
