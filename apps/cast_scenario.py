#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenarios: list the catalogue, show one, convert between YAML, Colosseum's .mat and Zarr, create one from a place."""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import _program
import numpy as np
from gr_cast import scenario as sc
from gr_cast.errors import CastError
from gr_cast.scenario.create import pipeline
from gr_cast.scenario.create.spec import read as read_spec
from gr_cast.units import db_from_amplitude

MAX_ROWS = 40  # of a table on screen; --all shows the rest


def list_catalogue(args) -> None:
    """One line per scenario; a scenario that is refused says why."""
    for name, path in sc.catalogue_entries().items():
        try:
            scenario = sc.read(path)
        except CastError as error:
            print(f"{name:12s} refused: {error.faults[0]}")
            continue
        print(
            f"{name:12s} {len(scenario.nodes):3d} nodes {len(scenario.links):5d} links {_seconds(scenario)}  {scenario.name}"
        )


def _seconds(scenario: sc.Scenario) -> str:
    return "  static" if scenario.is_static else f"{scenario.time_s[-1]:6.1f} s"


def show(args) -> None:
    scenario = sc.load(args.scenario)
    print(f"{scenario.name}: {len(scenario.nodes)} nodes, {len(scenario.links)} links, {_seconds(scenario).strip()}")
    if scenario.description:
        print(scenario.description)
    if scenario.center_frequency_hz:
        print(f"carrier {scenario.center_frequency_hz / 1e6:.3f} MHz")
    if not scenario.is_static:
        print(f"{scenario.time_s.size} instants, between them: {scenario.interpolation}")
    keys = sorted(scenario.links, key=lambda key: [scenario.nodes.index(node) for node in key])
    print(f"\n{'link':>12s} {'base loss dB':>13s} {'power dB':>9s}  taps at 0 s: delay us / gain dB / phase rad")
    for key in keys if args.all else keys[:MAX_ROWS]:
        delay_s, gain = (value[0] for value in sc.taps_at(scenario, key, np.zeros(1)))
        power_db = sc.power_db(scenario, key)
        taps = ", ".join(
            f"{1e6 * delay:.3f} / {db_from_amplitude(value):.2f} / {np.angle(value):.2f}"
            for delay, value in zip(delay_s, gain, strict=True)
            if value != 0
        )
        print(
            f"{sc.link_name(key):>12s} {sc.base_loss_db(scenario, key):13.2f} {power_db[0]:9.2f}  {taps or 'none at 0 s'}"
        )
    if not args.all and len(keys) > MAX_ROWS:
        print(f"… and {len(keys) - MAX_ROWS} more links: --all shows them")


def convert(args) -> None:
    scenario = sc.load(args.source)
    options = {"form": "static"} if args.static else {}
    if args.static and Path(args.target).suffix != ".mat":
        raise CastError(f"{args.target}: --static is a form of .mat files")
    sc.save(args.target, scenario, **options)
    if Path(args.target).suffix == ".mat" and (scenario.base_loss_db or scenario.link_base_loss_db):
        print("base losses belong to the set-up and are not in the .mat file")
    print(f"{args.target}: {len(scenario.nodes)} nodes, {len(scenario.links)} links")


def create(args) -> int:
    python = Path(os.environ.get("CAST_RAYTRACER") or sc.data_folder() / "raytracer/bin/python")
    if python.exists() and Path(sys.prefix) != python.parent.parent:
        # On in the Python that has the ray tracer and Dask: GNU Radio's own stays as it is.
        return subprocess.call([str(python), "-W", "ignore", __file__, *args.argv])
    path = Path(args.spec)
    if not path.exists() and (sc.examples_folder() / f"{args.spec}.yaml").exists():
        path = sc.examples_folder() / f"{args.spec}.yaml"
    spec = read_spec(path)
    folder = Path(args.work or f"{spec.id}.create")
    run = pipeline.Run(folder=folder, tell=lambda line: print(line, flush=True), progress=_progress, dask=args.dask)
    pipeline.create(spec, run, only=args.until)
    return 0


def _progress(step: str, done: int, total: int) -> None:
    print(f"\r{step}: {done} of {total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser("list", help="the scenarios of the catalogue")
    command.set_defaults(call=list_catalogue)
    command = commands.add_parser("show", help="links, taps, and power over time")
    command.add_argument("scenario", help="catalogue id or file (.yaml, .mat, .zarr)")
    command.add_argument("--all", action="store_true", help="every link of the table")
    command.set_defaults(call=show)
    command = commands.add_parser("convert", help="write a scenario in another format")
    command.add_argument("source", help="catalogue id or file (.yaml, .mat, .zarr)")
    command.add_argument("target", help="file (.yaml, .mat, .zarr)")
    command.add_argument("--static", action="store_true", help=".mat as N x N path gains in dB")
    command.set_defaults(call=convert)
    command = commands.add_parser("create", help="from a place to an installed scenario, in eight steps that resume")
    command.add_argument("spec", help="SPEC.yaml, or the name of an example: arena, street")
    command.add_argument("--work", metavar="FOLDER", help="results of the steps (default: ID.create in this folder)")
    command.add_argument("--until", choices=pipeline.STEPS, help="stop after this step")
    command.add_argument("--dask", metavar="tcp://…", help="scheduler to run sampling and approximation on")
    command.set_defaults(call=create)
    argv = sys.argv[1:] if argv is None else argv
    args = parser.parse_args(argv, argparse.Namespace(argv=argv))
    return args.call(args) or 0


if __name__ == "__main__":
    _program.run(main)
