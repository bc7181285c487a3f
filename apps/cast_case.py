#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""From recordings and a scenario or a sounding to a case, from a corrected twin back to a scenario, and a place case played."""

import argparse
import sys
from pathlib import Path

import _program
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.core.files import check_writable, passing_folder
from gr_cast.core.programs import called
from gr_cast.scenario.create import pipeline, spec
from gr_cast.signals.waveform import entry_from_text
from gr_cast.sounding.result import read_taps
from gr_cast.twin import make, to_scenario
from gr_cast.twin.document import read_twin
from gr_cast.twin.places import document, play

_RANGES = {"noise": (-400, 400, "dB"), "seed": (0, 2**63 - 1, "")}
WELL_DB = -20.0  # of what is lost where a moving link becomes taps that turn


def make_case(args) -> None:
    """Recordings with what a scenario, or a sounding, believes of their links: a case for cast_diagnose.py."""
    link = tuple(args.link.split(">", 1)) if args.link else None
    if link and len(link) != 2:
        raise CastError(f"--link: got {args.link!r}, needs TX>RX, such as --link 'a>b'")
    waveform = entry_from_text(args.code) if args.code else None
    recordings = [make.heard(path, link=link, waveform=waveform) for path in args.recordings]
    for one in recordings:
        for line in one.doubts:
            print(f"warning: {one.stem.name}: {line}", file=sys.stderr)
    keys = dict.fromkeys(key for one in recordings for key in one.links)
    if args.sounding:
        taps, floor_db = read_taps(args.sounding)
        if len(keys) > 1:
            raise CastError(f"--sounding: is of one link, the recordings have {', '.join(map(sc.link_name, keys))}")
        taps, noise_db = dict.fromkeys(keys, taps), {recordings[0].receiver: floor_db}
    else:
        taps, noise_db = _believed(args, recordings, keys), {}
    make.write(args.output, recordings, make.document(recordings, taps, noise_db))
    names = ", ".join(f"{sc.link_name(key)} ({len(taps[key])} taps)" for key in keys)
    what = "recording" if len(recordings) == 1 else "recordings"
    print(f"{args.output}: {len(recordings)} {what}, {names}")
    print(f"next: {called('cast_diagnose')} {args.output} --output diagnosis")


def _believed(args, recordings, keys) -> dict:
    name = args.scenario or next((one.scenario for one in recordings if one.scenario), None)
    if name is None:
        raise CastError("what does the twin believe? add --scenario ID or FILE, or --sounding FOLDER")
    for one in recordings:
        if one.scenario not in (None, name):
            print(f"{one.stem.name}: was made by scenario {one.scenario}, the twin believes {name}", file=sys.stderr)
    scenario, taps = sc.load(name), {}
    for key in keys:
        one = next(one for one in recordings if key in one.links)
        at_s = one.at_s if args.at is None else args.at
        taps[key], lost_db = make.believed_of(scenario, key, at_s, one.duration_s)
        if lost_db > WELL_DB:
            lost = f"warning: {one.stem.name}: {sc.link_name(key)}: taps of one Doppler each lose {lost_db:.0f} dB of what moves"
            print(f"{lost} during the recording: cut a shorter one", file=sys.stderr)
    return taps


def to_a_scenario(args) -> None:
    """The links of a corrected twin as a scenario: what of a diagnosis is the channel's."""
    twin = read_twin(args.twin)
    check_writable(Path(args.output).parent)
    made = to_scenario.corrected(twin, sc.load(args.onto) if args.onto else None, args.at)
    sc.save(args.output, made.scenario)
    changed = ", ".join(map(sc.link_name, made.changed)) or "no link"
    print(f"{args.output}: {len(made.scenario.nodes)} nodes, {len(made.scenario.links)} links, changed: {changed}")
    for effect in made.left_out:
        print(f"not in the scenario: {effect}; {called('cast_emulator')} play --twin {args.twin} --output FOLDER plays it")


def play_place(args) -> None:
    """A place case whose soundings are made anew in a world: SPEC, scenario, emulator, sounder, campaigns."""
    if args.output.exists():
        raise CastError(f"{args.output}: is there already: choose another folder")
    check_writable(args.output.parent)
    place = document.read(args.case)
    world_spec = spec.read(args.world) if args.world else place.spec
    with passing_folder() as folder:
        run = pipeline.Run(folder=folder, tell=lambda line: print(line, flush=True), progress=_program.progress)
        world = play.world(world_spec, run)
    told = lambda done, total: _program.progress("soundings", done, total)  # noqa: E731
    arrays = play.campaigns(place, world, noise_power_db=args.noise, seed=args.seed, progress=told)
    play.write(args.output, place, arrays)
    print(f"{args.output}: {', '.join(arrays)}")
    for line in play.lost_in_words(place, world):
        print(line)
    print(f"next: {called('cast_diagnose')} {args.output} --output diagnosis")


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser("make", help=make_case.__doc__, description=make_case.__doc__)
    command.add_argument("recordings", nargs="+", metavar="RECORDING", help="SigMF, as the sounder and the emulator write them")
    command.add_argument("--output", required=True, metavar="CASE", help="folder of the case")
    what = command.add_mutually_exclusive_group()
    what.add_argument("--scenario", metavar="ID|FILE", help="what the twin believes (default: the recording's own cast:scenario)")
    what.add_argument("--sounding", metavar="DIR", help="the same from a sounding, its folder or result.json")
    command.add_argument("--at", type=float, metavar="S", help="of the scenario (default: the recording's own, else 0)")
    command.add_argument("--link", metavar="TX>RX", help="of recordings that do not say it")
    command.add_argument("--code", help="of recordings that do not say it: glfsr:8, …, or file:STEM")
    command.set_defaults(call=make_case)
    command = commands.add_parser("scenario", help=to_a_scenario.__doc__, description=to_a_scenario.__doc__)
    command.add_argument("twin", help="twin_corrected.yaml of a diagnosis")
    command.add_argument(
        "--onto", metavar="ID|FILE", help="the scenario that the twin came from (default: the twin's links alone)"
    )
    command.add_argument("--at", type=float, default=0.0, metavar="S", help="of that scenario, as for make (default 0)")
    command.add_argument("--output", required=True, help="scenario file (.yaml, .mat, .zarr)")
    command.set_defaults(call=to_a_scenario)
    command = commands.add_parser("place", help=play_place.__doc__, description=play_place.__doc__)
    command.add_argument("case", type=Path, help="folder with a place.yaml")
    command.add_argument("--world", type=Path, metavar="SPEC", help="what is sounded (default: the case's own twin)")
    command.add_argument("--noise", type=float, default=-110.0, metavar="DB", help="per sample, re what is sent (default -110)")
    command.add_argument("--seed", type=int, default=1, help="of the noise (default 1)")
    command.add_argument("--output", type=Path, required=True, metavar="CASE", help="folder of the new case")
    command.set_defaults(call=play_place)
    args = _program.parse(parser, argv)
    _program.check_ranges(args, _RANGES)
    args.call(args)
    return 0


if __name__ == "__main__":
    _program.run(main)
