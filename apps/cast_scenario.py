#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Scenarios: list the catalogue, show one, convert between YAML, Colosseum's .mat and Zarr, plan where to sound a place, create
one from it, validate."""

import argparse
import os
import sys
from pathlib import Path

import _program
import numpy as np
from gr_cast import scenario as sc
from gr_cast.comparing import validation
from gr_cast.core.errors import CastError
from gr_cast.core.figures import fixed
from gr_cast.core.files import check_target, write_json, write_text
from gr_cast.core.units import db_from_amplitude
from gr_cast.scenario import colosseum, zarr_file
from gr_cast.scenario.create import area, materials, model, p2m, pipeline
from gr_cast.scenario.create.spec import read as read_spec
from gr_cast.scenario.reduced import reduced
from gr_cast.twin.places import planning

MAX_ROWS = 40  # of a table on screen; --all shows the rest


def list_catalogue(args) -> None:
    """One line per scenario; a scenario that is refused says why."""
    for name, path in sc.catalogue_entries().items():
        try:
            scenario = sc.read(path)
        except CastError as error:
            print(f"{name:12s} refused: {error.faults[0]}")
            continue
        print(f"{name:12s} {len(scenario.nodes):3d} nodes {len(scenario.links):5d} links {_seconds(scenario)}  {scenario.name}")


def _seconds(scenario: sc.Scenario) -> str:
    return "  static" if scenario.is_static else f"{scenario.time_s[-1]:6.1f} s"


def show(args) -> None:
    from gr_cast.report import plot

    scenario = sc.load(args.scenario)
    print(f"{scenario.name}: {len(scenario.nodes)} nodes, {len(scenario.links)} links, {_seconds(scenario).strip()}")
    if scenario.description:
        print(scenario.description)
    if scenario.center_frequency_hz:
        print(f"carrier {scenario.center_frequency_hz / 1e6:.3f} MHz")
    if not scenario.is_static:
        print(f"{scenario.time_s.size} instants, between them: {scenario.interpolation}")
    keys = sorted(scenario.links, key=lambda key: [scenario.nodes.index(node) for node in key])
    width_hz = _band_hz(args, scenario)
    print(f"path gains: power in {width_hz / 1e6:g} MHz at 0 s; sum of |tap|² beside it where it differs")
    print(
        f"\n{'link':>12s} {'base loss dB':>13s} {'in band dB':>11s} {'sum dB':>7s}  taps at 0 s: delay us / gain dB / phase rad"
    )
    for key in keys if args.all else keys[:MAX_ROWS]:
        delay_s, gain = (value[0] for value in sc.taps_at(scenario, key, np.zeros(1)))
        in_band_db, sum_db = (
            f"{value[0]:.2f}" for value in (sc.band_power_db(scenario, key, width_hz), sc.tap_power_db(scenario, key))
        )
        taps = ", ".join(
            f"{1e6 * delay:.3f} / {db_from_amplitude(value):.2f} / {np.angle(value):.2f}"
            for delay, value in zip(delay_s, gain, strict=True)
            if value != 0
        )
        print(
            f"{sc.link_name(key):>12s} {sc.base_loss_db(scenario, key):13.2f} {in_band_db:>11s}"
            f" {'' if sum_db == in_band_db else sum_db:>7s}  {taps or 'none at 0 s'}"
        )
    if not args.all and len(keys) > MAX_ROWS:
        print(f"… and {len(keys) - MAX_ROWS} more links: --all shows them")
    if args.plot:
        plot.save(plot.scenario_figure(scenario, width_hz), args.plot)
        print(f"picture: {args.plot}")
    if args.plan:
        _write_plan(args.scenario, args.plan, scenario, width_hz)


def _write_plan(name: str, target, scenario: sc.Scenario | None = None, bandwidth_hz: float | None = None) -> None:
    """The place as a page: objects, nodes, tracks, and the path loss over a band from a node that is clicked on."""
    from gr_cast.report import plan

    path = sc.catalogue_entries().get(name, Path(name))
    write_text(target, plan.page(scenario or sc.read(path), zarr_file.outlines(path), bandwidth_hz))
    print(f"plan: {target}")


def _band_hz(args, scenario: sc.Scenario) -> float:
    """The band of --band, or the scenario's own."""
    if args.band is not None and not 1e4 <= args.band <= 1e8:
        raise CastError(f"--band: got {args.band:g} Hz, limit 1e4 to 1e8 Hz")
    return args.band or sc.band_hz(scenario)


def convert(args) -> None:
    scenario = sc.load(args.source)
    if args.every_ms is not None:
        scenario = sc.resampled(scenario, args.every_ms / 1e3)
    if args.reduce is not None:
        scenario, nmse_db = reduced(scenario, args.reduce)
        for key, lost_db in nmse_db.items():
            print(f"{sc.link_name(key)}: four taps in the place of more: NMSE {lost_db:.1f} dB over {args.reduce / 1e6:g} MHz")
    srn_of = _srns(args.srn, scenario)
    weak = colosseum.weak_taps(scenario) if ".mat" in (Path(args.target).suffix, Path(args.source).suffix) else []
    if weak and args.strict:
        raise CastError(*(f"{args.target}: {line}" for line in weak))
    for line in weak:
        print(f"warning: {line}", file=sys.stderr)
    options = {"form": "static"} if args.static else {}
    if args.static and Path(args.target).suffix != ".mat":
        raise CastError(f"{args.target}: --static is a form of .mat files")
    sc.save(args.target, scenario, **options)
    if args.radio_map:
        radios = {n: srn and {"SRN": srn, "RadioA": 1, "RadioB": 2} for n, srn in srn_of.items()}
        colosseum.write_radio_map(args.radio_map, radios)
    if args.node_map:
        colosseum.write_node_map(args.node_map, {n: srn for n, srn in srn_of.items() if srn})
    if Path(args.target).suffix == ".mat" and (scenario.base_loss_db or scenario.link_base_loss_db):
        print(f"base losses ({scenario.base_loss_db:.2f} dB) belong to the set-up and are not in the .mat file")
    print(f"{args.target}: {len(scenario.nodes)} nodes, {len(scenario.links)} links")


def _srns(pairs: list[str], scenario: sc.Scenario) -> dict[str, int | None]:
    """Number of every node, as Colosseum counts, to its SRN: its own number, or what `pairs` say; None is unused."""
    srn_of, faults = {str(n): n for n in range(1, len(scenario.nodes) + 1)}, []
    number = {node: str(n) for n, node in enumerate(scenario.nodes, 1)}
    for text in pairs:
        node, _, srn = text.partition("=")
        if node not in number or not (srn == "none" or (srn.isdecimal() and 1 <= int(srn) <= colosseum.MAX_SRN)):
            faults.append(
                f"--srn: got {text!r}, needs NODE=SRN or NODE=none, SRN 1 to {colosseum.MAX_SRN}, of {', '.join(number)}"
            )
            continue
        srn_of[number[node]] = None if srn == "none" else int(srn)
    used = [srn for srn in srn_of.values() if srn]
    faults += [f"--srn: SRN {srn} serves two nodes, each has one of its own" for srn in {s for s in used if used.count(s) > 1}]
    if faults:
        raise CastError(*faults)
    return srn_of


def import_paths(args) -> None:
    target = Path(args.output)
    power = args.tx_power_dbm
    if not 1e4 <= args.band <= 1e8:
        raise CastError(f"--band: got {args.band:g} Hz, limit 1e4 to 1e8 Hz")
    if not -200 <= power <= 200:
        raise CastError(f"--tx-power-dbm: got {power:g} dBm, limit -200 to 200 dBm")
    made, nmse_db = p2m.scenario(args.files, name=target.stem, tx_power_dbm=power, bandwidth_hz=args.band)
    sc.save(target, made)
    worst = max(nmse_db, key=nmse_db.get)
    print(f"{target}: {len(nmse_db)} links; NMSE over {args.band / 1e6:g} MHz: median {np.median(list(nmse_db.values())):.1f} dB,"
          f" worst {nmse_db[worst]:.1f} dB ({sc.link_name(worst)})")  # fmt: skip


def create(args) -> int:
    python = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")
    if python.exists() and Path(sys.prefix) != python.parent.parent:
        # On in the Python that has the ray tracer and Dask: GNU Radio's own stays as it is.
        os.execv(python, [str(python), "-W", "ignore", __file__, *args.argv])
    spec = _spec(args.spec)
    folder = Path(args.work or f"{spec.id}.create")
    run = pipeline.Run(folder=folder, tell=lambda line: print(line, flush=True), progress=_program.progress, dask=args.dask)
    record = pipeline.create(spec, run, only=args.until)
    if "install" in record:
        _write_plan(spec.id, folder / "plan.html")
    return 0


def _spec(name: str):
    """The SPEC of a file, or of an example."""
    path = Path(name)
    if not path.exists() and (sc.examples_folder() / f"{name}.yaml").exists():
        path = sc.examples_folder() / f"{name}.yaml"
    if not path.exists():
        examples = ", ".join(sorted(example.stem for example in sc.examples_folder().glob("*.yaml")))
        raise CastError(f"{name}: no such file, and none of the examples: {examples}")
    return read_spec(path)


def plan_soundings(args) -> None:
    """Before anyone measures: which positions make a place known, and what a campaign cannot see."""
    from gr_cast.report import plot
    from gr_cast.report.place import planning as place_planning

    for path in filter(None, (args.json, args.plot)):
        check_target(path)
    spec = _spec(args.spec)
    solids = materials.assign(model.read(spec)[0], spec.materials, spec.carrier_hz)
    wanted = planning.Wanted(
        links=tuple(args.link), anchors=tuple(args.anchor), region_m=args.region, height_m=args.height, step_m=args.step,
        count=args.positions, max_depth=args.depth, snr_db=args.snr, unknown=tuple(dict.fromkeys(args.unknown)),
    )  # fmt: skip
    told = lambda done, total: _program.progress("plan", done, total)  # noqa: E731
    world, links, anchors, plan_ = planning.of_spec(spec, solids, wanted, told)
    print(f"{spec.id}: {len(plan_.grid_m)} positions at {args.height:g} m, each sounding with {', '.join(anchors)}")
    print(f"up to {world.max_depth} reflections, {spec.bandwidth_hz / 1e6:g} MHz, noise {args.snr:g} dB below the median link")
    print(*place_planning.table(plan_, bool(links)), sep="\n")
    if args.json:
        write_json(args.json, place_planning.document(plan_, links, anchors))
        print(f"plan: {args.json}")
    if args.plot:
        title = f"{spec.id}: where to sound, {args.height:g} m above the ground"
        plot.save(place_planning.figure(plan_, world, links, anchors, title), args.plot)
        print(f"picture: {args.plot}")


def heat(args) -> None:
    """Path loss from one node to every point of an area, from a SPEC alone."""
    from gr_cast.report import plot
    from gr_cast.report.place import area as place_area

    check_target(args.plot)
    spec = _spec(args.spec)
    wanted = area.Wanted(
        sender=args.sender, time_s=args.at, region_m=args.region, height_m=args.height, step_m=args.step, max_depth=args.depth
    )
    wanted.grid(spec)  # its faults before anything is read
    solids = materials.assign(model.read(spec)[0], spec.materials, spec.carrier_hz)
    told = lambda done, total: _program.progress("heat", done, total)  # noqa: E731
    found = area.losses(spec, solids, wanted, args.band or spec.bandwidth_hz, told)
    heard = found.loss_db[np.isfinite(found.loss_db)]
    span = f"{heard.min():.1f} to {heard.max():.1f} dB, median {np.median(heard):.1f} dB" if heard.size else "nothing is heard"
    print(f"{spec.id}: {found.loss_db.size} points at {args.height:g} m, {heard.size} hear {args.sender}: {span}")
    title = f"{spec.id}: path loss from {args.sender} at {args.height:g} m, up to {min(args.depth, spec.max_depth)} reflections"
    plot.save(place_area.figure(found, solids, title), args.plot)
    print(f"picture: {args.plot}")


def check(args) -> int:
    """Exit status 1 where a link does not agree with its taps within the sounder's own uncertainty."""
    from gr_cast.report import plot

    if not args.links >= 1:
        raise CastError(f"--links: got {args.links}, needs 1 or more")
    scenario = sc.load(args.scenario)
    path = sc.catalogue_entries().get(args.scenario, Path(args.scenario))
    rays = validation.traced_rays(path, scenario)
    band_hz = _band_hz(args, scenario)
    if args.link:
        keys = [tuple(link.split(">", 1)) for link in args.link]
        faults = [f"--link: got {link!r}: {scenario.name} has no such link, needs TX>RX, such as {_example(scenario)}"
                  for link, key in zip(args.link, keys, strict=True) if key not in scenario.links]  # fmt: skip
        if faults:
            raise CastError(*faults)
    else:
        keys = validation.chosen_links(scenario, args.links)
    checks = []
    print(f"losses and errors: dB over {band_hz / 1e6:g} MHz; sum: loss by the sum of |tap|², where it differs")
    print(f"{'':44s}path loss of{'':22s}error")
    print(
        _cells(
            "link", "s", "taps", "found", "sigma", "rays", "taps", "sum", "sounded", "sounded-taps", "taps-rays", "sounded-rays"
        )
    )
    for index, key in enumerate(keys):
        for item in validation.check(scenario, [key], rays=rays, bandwidth_hz=band_hz, play=_emulator()):
            checks.append(item)
            print(_row(item), flush=True)
        _program.progress("validate", index + 1, len(keys))
    if rays is None:
        print("the ray-traced channel is not here: only taps and sounding are compared")
    loss_db = -sc.path_gain_matrix_db(scenario, band_hz)
    picture = args.plot or f"{Path(args.scenario).stem}-path-loss.png"
    title = f"{scenario.name}: path loss in {band_hz / 1e6:g} MHz"
    least_db, most_db = sc.taps_over_band_db(scenario, band_hz)
    if max(most_db, -least_db) >= 0.05:
        title += f"\n(power by the sum of |tap|²: {least_db:+.1f} to {most_db:+.1f} dB on that)"
    plot.save(plot.heatmap_figure(np.where(np.isfinite(loss_db), loss_db, np.nan), list(scenario.nodes), title), picture)
    failed = [item for item in checks if not item.holds]
    print(f"heat map: {picture}")
    print(f"{len(checks) - len(failed)} of {len(checks)} soundings agree with their taps within {validation.MAX_SIGMA:g} sigma")
    return 1 if failed else 0


def _row(item: validation.LinkCheck) -> str:
    taps, by_sum = _db(item.path_loss_db), _db(item.tap_sum_loss_db)
    losses = _db(item.ray_path_loss_db), taps, "" if by_sum == taps else by_sum, _db(item.sounded_path_loss_db)
    errors = (_db(value, 1) for value in (item.sounded_from_taps_db, item.taps_from_rays_db, item.sounded_from_rays_db))
    row = _cells(item.link, f"{item.time_s:.2f}", item.taps, item.found, f"{item.worst_sigma:.2f}", *losses, *errors)
    return row if item.holds else row + "  DOES NOT HOLD"


def _cells(*values) -> str:
    widths = (10, 6, 4, 5, 6, 8, 8, 8, 8, 13, 9, 12)
    return " ".join(f"{value:>{width}}" for value, width in zip(values, widths, strict=True))


def _db(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else fixed(value, digits)


def _example(scenario: sc.Scenario) -> str:
    return next((f"'{sc.link_name(key)}'" for key in scenario.links), "'a>b'")


def _emulator():
    """Plays through the emulator block where GNU Radio is, else through its NumPy reference."""
    try:
        from gnuradio import blocks, gr
        from gr_cast.blocks.network import emulated_network
    except ImportError:
        return validation.play_reference

    def play(scenario, samples, sample_rate_hz):
        flowgraph, sink = gr.top_block(), blocks.vector_sink_c()
        network = emulated_network(scenario, ["tx"], ["rx"], sample_rate_hz)
        flowgraph.connect(blocks.vector_source_c(samples.tolist()), network, sink)
        flowgraph.run()
        return np.array(sink.data())

    return play


def _over_a_region(command: argparse.ArgumentParser, what: str) -> None:
    command.add_argument(
        "--region", type=float, nargs=4, metavar=("X0", "Y0", "X1", "Y1"), help="in m (default: the box of all nodes)"
    )
    command.add_argument("--height", type=float, default=1.5, metavar="M", help=f"of the {what}, z (default 1.5)")
    command.add_argument(
        "--depth", type=int, default=2, metavar="N", help="reflections at most (default 2, or the SPEC's if less)"
    )


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser("list", help="the scenarios of the catalogue")
    command.set_defaults(call=list_catalogue)
    command = commands.add_parser("show", help="links, taps, and power over time")
    command.add_argument("scenario", help="catalogue id or file (.yaml, .mat, .zarr)")
    command.add_argument("--all", action="store_true", help="every link of the table")
    command.add_argument(
        "--band", type=_program.rate, metavar="HZ", help="band of path gains (default: the scenario's own, else 80e6)"
    )
    command.add_argument("--plot", metavar="PNG", help="also a picture of them")
    command.add_argument("--plan", metavar="HTML", help="also the place from above, to be clicked on in a browser")
    command.set_defaults(call=show)
    command = commands.add_parser("convert", help="write a scenario in another format")
    command.add_argument("source", help="catalogue id or file (.yaml, .mat, .zarr)")
    command.add_argument("target", help="file (.yaml, .mat, .zarr)")
    command.add_argument("--every-ms", type=float, metavar="N", help="an instant every N ms (a .mat holds every cell in full)")
    command.add_argument(
        "--reduce", type=_program.rate, metavar="HZ", help="four taps where a link has more, fitted over this band"
    )
    command.add_argument("--strict", action="store_true", help="refuse taps below Colosseum's documented -43 dB, not only warn")
    command.add_argument("--radio-map", metavar="JSON", help="also write a radio map: node n on SRN n, or as --srn says")
    command.add_argument("--node-map", metavar="JSON", help="also write a node map: node n on SRN n, or as --srn says")
    command.add_argument(
        "--srn", action="append", default=[], metavar="NODE=SRN", help="of the maps; NODE=none for one that is unused; repeat"
    )
    command.add_argument("--static", action="store_true", help=".mat as N x N path gains in dB")
    command.set_defaults(call=convert)
    command = commands.add_parser("import", help="four taps from Wireless InSite impulse responses (.cir.….p2m)")
    command.add_argument("files", nargs="+", metavar="P2M", help="one file per transmitter")
    command.add_argument("--output", required=True, help="scenario file (.yaml, .mat, .zarr)")
    command.add_argument("--tx-power-dbm", type=float, default=0.0, help="power that the files were made with (default 0)")
    command.add_argument("--band", type=_program.rate, default=80e6, metavar="HZ", help="band to fit (default 80e6)")
    command.set_defaults(call=import_paths)
    command = commands.add_parser("plan", help="where to sound a place before anyone measures, and what a campaign cannot see")
    command.add_argument("spec", help="SPEC.yaml, or the name of an example: arena, street")
    command.add_argument("--positions", type=int, default=4, metavar="K", help="how many to choose (default 4)")
    command.add_argument("--link", action="append", default=[], metavar="TX>RX", help="of a campaign that is made anyway; repeat")
    command.add_argument(
        "--anchor",
        action="append",
        default=[],
        metavar="NODE",
        help="that a position sounds with; repeat (default: all still nodes)",
    )
    _over_a_region(command, "positions")
    command.add_argument("--step", type=float, metavar="M", help="of the grid of positions (default: 150 of them)")
    command.add_argument("--snr", type=float, default=25.0, metavar="DB", help="of the median link, a tone of 32 (default 25)")
    command.add_argument(
        "--unknown", nargs="*", default=["phase", "delay"], choices=planning.UNKNOWN,
        help="what a response does not know of its link (default: phase delay)",
    )  # fmt: skip
    command.add_argument("--json", metavar="FILE", help="also the plan as JSON")
    command.add_argument("--plot", metavar="PNG", help="also the place from above")
    command.set_defaults(call=plan_soundings)
    command = commands.add_parser("heat", help="path loss from one node over an area, as a picture, from a SPEC alone")
    command.add_argument("spec", help="SPEC.yaml, or the name of an example: arena, street")
    command.add_argument("--from", required=True, metavar="NODE", dest="sender", help="that sends")
    command.add_argument("--plot", required=True, metavar="PNG", help="the picture")
    command.add_argument("--at", type=float, default=0.0, metavar="S", help="where a node that moves is (default 0)")
    _over_a_region(command, "points")
    command.add_argument("--step", type=float, metavar="M", help="between points (default: 2000 of them)")
    command.add_argument("--band", type=_program.rate, metavar="HZ", help="band of the losses (default: the SPEC's)")
    command.set_defaults(call=heat)
    command = commands.add_parser("create", help="from a place to an installed scenario, in eight steps that resume")
    command.add_argument("spec", help="SPEC.yaml, or the name of an example: arena, street")
    command.add_argument("--work", metavar="FOLDER", help="results of the steps (default: ID.create in this folder)")
    command.add_argument("--until", choices=pipeline.STEPS, help="stop after this step")
    command.add_argument("--dask", metavar="tcp://…", help="scheduler to run sampling, parsing and approximation on")
    command.set_defaults(call=create)
    command = commands.add_parser("validate", help="sound links through the emulator and compare with taps and rays")
    command.add_argument("scenario", help="catalogue id or file")
    command.add_argument("--links", type=int, default=12, help="how many links, spread over all (default 12)")
    command.add_argument("--link", action="append", metavar="TX>RX", help="this link (may be given more than once)")
    command.add_argument(
        "--band", type=_program.rate, metavar="HZ", help="band of losses and errors (default: the scenario's own, else 80e6)"
    )
    command.add_argument("--plot", metavar="PNG", help="the heat map (default: SCENARIO-path-loss.png in this folder)")
    command.set_defaults(call=check)
    argv = sys.argv[1:] if argv is None else argv
    args = _program.parse(parser, argv, argparse.Namespace(argv=argv))
    return args.call(args) or 0


if __name__ == "__main__":
    _program.run(main)
