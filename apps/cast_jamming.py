#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Wi-Fi under a jammer, through the emulator: throughput and SINR over time, and how alike a twin's are."""

import argparse
import sys
import time

import _program
from gr_cast import scenario as sc
from gr_cast.comparing import series, similarity
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.files import write_json
from gr_cast.experiments import hall, jamming, left_out, loss, paper
from gr_cast.experiments import jamming_result as result
from gr_cast.signals.wifi import MODES
from gr_cast.sounding.result import output_folder

SNR_DB = 26.0  # of which the paper's 20 dB are 77 %
SINR_DB = {"narrowband": 6.0, "wideband": 1.0}  # 20 and 25 dB below, as in the paper
CENTRE_HZ = {"narrowband": 2.5e6, "wideband": 0.0}  # on a carrier: in the middle of the band 802.11 has none
DEFAULT_CASES = tuple(paper.figures()["jamming"]["cases"])


def _times_s(args, modem):
    """When the computed frames begin, and how far apart those of the saturated link are."""
    period_s = jamming.frame_period_s(modem, args.payload)
    return jamming.frame_times_s(args.duration, args.frames_per_second, period_s - jamming.WAIT_S), period_s


def _emulate(args, modem, setting: jamming.Setting, label: str, case: str) -> result.Run:
    """Compute the frames of one run; what is there when the user interrupts is kept."""
    from gr_cast.blocks.frames import FrameEmulator

    emulator = FrameEmulator(
        setting.scenario, setting.transmitters, setting.rx, modem.sample_rate_hz, setting.noise_power, setting.seed
    )
    times_s, period_s = _times_s(args, modem)
    began, found = time.monotonic(), []
    try:
        for frame in jamming.frames(setting, modem, emulator, times_s, args.payload):
            found.append(frame)
            if len(found) % 20 == 0 or len(found) == len(times_s):
                speed = frame.time_s / (time.monotonic() - began)
                told = f"{case}, {label}: {frame.time_s:.1f} of {args.duration:g} s radio time, {speed:.1f} times real time"
                _program.show(told, last=len(found) == len(times_s))
    except KeyboardInterrupt:
        interrupts.settled()
        args.interrupted = True
    return result.Run(
        label=label, setting=setting, frames=found, offered_mbit_per_s=8e-6 * args.payload / period_s, step_s=args.step,
        wall_s=time.monotonic() - began,
    )  # fmt: skip


def _jammer(kind: str, args, on_s: tuple[float, float]) -> jamming.Jammer | None:
    if kind == "none":
        return None
    centre_hz = CENTRE_HZ[kind] if args.centre is None else args.centre
    return jamming.Jammer(bandwidth_hz=jamming.BANDWIDTH_HZ[kind], centre_hz=centre_hz, on_s=on_s)


def _settings(case: str, args) -> list[jamming.Setting]:
    """The run over the scenario, and the one over its twin, of case MOBILITY-JAMMER."""
    place, _, kind = case.rpartition("-")
    if kind not in ("none", *jamming.BANDWIDTH_HZ) or place not in (*hall.JAMMERS, "scenario"):
        raise CastError(f"--case: got {case!r}, needs static|mobile|scenario-none|narrowband|wideband")
    if place == "scenario":
        if not args.scenario:
            raise CastError(f"--case {case}: needs --scenario")
        scenarios = [sc.load(name) for name in (args.scenario, args.twin) if name]
    else:
        scenarios = [hall.scenario(place, duration_s=args.duration, taps=taps) for taps in (None, 4)]
    third = args.duration / 3
    jammer = _jammer(kind, args, (0.0, args.duration) if place == "mobile" else (third, 2 * third))
    sinr_db = None if jammer is None else SINR_DB[kind] if args.sinr is None else args.sinr
    nodes = dict(zip(("tx", "rx", "jammer_node"), args.nodes, strict=True))
    return [
        jamming.Setting(scenario=scenario, jammer=jammer, snr_db=args.snr, sinr_db=sinr_db, seed=args.seed + k, **nodes)
        for k, scenario in enumerate(scenarios)
    ]


def run(args) -> int:
    """Frames over a scenario and over its twin, for every case; the hall's twin has four taps on the 10 ns grid."""
    from gr_cast.blocks.modem import open_modem
    from gr_cast.report import plot

    modem = open_modem(args.modem, args.mode)
    cases = args.case or (["scenario-narrowband", "scenario-wideband"] if args.scenario else DEFAULT_CASES)
    _times_s(args, modem)  # refusals come before the folder is made
    settings = {case: _settings(case, args) for case in cases}
    for setting in (setting for pair in settings.values() for setting in pair):
        jamming.mean_gain(setting.scenario, (setting.tx, setting.rx), jamming.LINK_BAND_HZ)
    folder = output_folder(args.output)
    print(f"modem: {modem.name}", file=sys.stderr)
    documents, pictures = [], []
    for case, pair in settings.items():
        runs = []
        for setting, label, side in zip(pair, ("scenario", "twin"), ("a", "b"), strict=False):
            done = _emulate(args, modem, setting, label, case)
            if len(done.frames) > 1:
                runs.append(done)
                result.write_run(folder / case, side, done)
            if args.interrupted:
                break
        if runs:
            documents.append(result.case_document(case, runs[0], runs[1] if len(runs) > 1 else None))
            pictures.append((case, runs))
        if args.interrupted:
            break
    if pictures:
        plot.save(plot.jamming_figure(pictures), folder / "jamming.png")
        plot.save(plot.jamming_spectrogram(pictures, modem.sample_rate_hz), folder / "spectrogram.png")
    document = result.document(modem.name, documents, not args.interrupted, modem.restarts)
    write_json(folder / "jamming.json", document)
    print(result.as_table(document))
    return 130 if args.interrupted else 0


def sweep(args) -> int:
    """Packet loss over SINR: white noise, the jammers, and the modem alone; the SINR that is measured beside the one set."""
    from gr_cast.blocks.frames import FrameEmulator
    from gr_cast.blocks.modem import open_modem
    from gr_cast.report import plot

    modem = open_modem(args.modem, args.mode)
    folder = output_folder(args.output)
    points = []
    try:
        for curve in loss.CURVES:
            for sinr_db in loss.SINR_DB:
                seed = args.seed + 1000 * len(points)  # a noise of its own for every point
                points.append(loss.point(curve, sinr_db, modem, FrameEmulator, args.frames, args.payload, seed))
                _program.show(f"{curve.name}, {sinr_db:g} dB: loss {points[-1].loss:.3f}")
    except KeyboardInterrupt:
        interrupts.settled()
        args.interrupted = True
    print(file=sys.stderr)
    document = loss.document(modem.name, points, not args.interrupted)
    if points:
        plot.save(plot.loss_figure(points, modem.name), folder / "sweep.png")
    write_json(folder / "sweep.json", document)
    print(loss.as_table(document))
    return 130 if args.interrupted else 0


def leave_out(args) -> int:
    """Leave a wall or a jammer's harmonic out of the twin: what ρ says of the two runs, and what the diagnosis finds."""
    from gr_cast.blocks.frames import FrameEmulator
    from gr_cast.blocks.modem import open_modem
    from gr_cast.diagnose import diagnose, read_case, write
    from gr_cast.report import plot
    from gr_cast.report.link.page import render

    kind, wall = left_out.parse(args.what)
    modem = open_modem(args.modem, args.mode)
    args.step, args.frames_per_second = 1.0, 4.0
    _times_s(args, modem)
    folder = output_folder(args.output)
    world, twin = left_out.settings(kind, wall, args.duration, args.seed)
    runs = [_emulate(args, modem, setting, label, args.what) for setting, label in ((world, "world"), (twin, "twin"))]
    if args.interrupted and min(len(run.frames) for run in runs) < 2:
        return 130
    for run_, side in zip(runs, ("a", "b"), strict=True):
        result.write_run(folder, side, run_)
    print(f"left out: {left_out.what_was_left_out(kind, world, twin)}")
    alike = {}
    for column in result.COLUMNS:
        pair = [series.read(folder / f"{side}.csv", column) for side in ("a", "b")]
        found = similarity.compare(*pair)
        alike[column] = similarity.as_document(found)
        plot.save(plot.series_comparison_figure(found, column), folder / f"comparison-{column}.png")
        print(f"\n{column}\n{similarity.as_table(alike[column])}")
    recorded = left_out.recorded(kind, world)
    emulator = FrameEmulator(
        recorded.scenario, recorded.transmitters, recorded.rx, left_out.OVERSAMPLING * modem.sample_rate_hz,
        left_out.OVERSAMPLING * recorded.noise_power, args.seed,
    )  # fmt: skip
    left_out.write_case(folder / "case", recorded, twin, modem, emulator, jammed=recorded.jammer is not None)
    print(f"\ncase: {folder / 'case'}; diagnosing …", flush=True)
    diagnosis = diagnose(read_case(folder / "case"))
    write(diagnosis, folder / "diagnosis", render(diagnosis))
    found = diagnosis.document
    print(f"diagnosis: {found['verdict']}")
    for effect in found["effects"]:
        print(f"  {effect['owner']['name']}: {effect['family']}: {effect['sentence']}")
    about = {"what": args.what, "similarity": alike, "verdict": found["verdict"], "effects": found["effects"]}
    write_json(folder / "left_out.json", left_out.document(about))
    return 0


def _add_common(command) -> None:
    command.add_argument("--output", required=True, metavar="DIR", help="table, pictures and JSON go here")
    command.add_argument("--modem", default="auto", help="auto, gr-ieee802-11 or 802.11a (default auto)")
    command.add_argument("--mode", default="qpsk1/2", help=f"{', '.join(MODES)} (default qpsk1/2)")
    command.add_argument("--payload", type=int, default=1000, metavar="BYTES", help="of a frame (default 1000)")
    command.add_argument("--seed", type=int, default=0)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.set_defaults(interrupted=False)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser("run", help=run.__doc__, description=run.__doc__)
    _add_common(command)
    command.add_argument(
        "--case", action="append", metavar="PLACE-JAMMER",
        help=f"static, mobile (in the hall) or scenario, with none, narrowband or wideband (default {', '.join(DEFAULT_CASES)})",
    )  # fmt: skip
    command.add_argument("--scenario", metavar="FILE", help="in the place of the hall: catalogue name or file")
    command.add_argument("--twin", metavar="FILE", help="the scenario's twin, for the similarity")
    command.add_argument("--nodes", nargs=3, default=("tx", "rx", "jammer"), metavar=("TX", "RX", "JAMMER"))
    command.add_argument("--duration", type=float, default=60.0, metavar="SECONDS", help="of radio time (default 60)")
    command.add_argument("--snr", type=float, default=SNR_DB, metavar="DB", help=f"without the jammer (default {SNR_DB:g})")
    command.add_argument("--sinr", type=float, metavar="DB", help="with it, mean (default 6 narrowband, 1 wideband)")
    command.add_argument(
        "--centre", type=float, metavar="HZ", help="of the jammer, from the carrier (default 2.5e6 narrowband, 0 wideband)"
    )
    command.add_argument("--frames-per-second", type=float, default=10.0, help="that are computed (default 10)")
    command.add_argument("--full", action="store_const", const=100.0, dest="frames_per_second", help="100 of them")
    command.add_argument("--step", type=float, default=1.0, metavar="SECONDS", help="of the series (default 1)")
    command.set_defaults(call=run)
    command = commands.add_parser("sweep", help=sweep.__doc__, description=sweep.__doc__)
    _add_common(command)
    command.add_argument("--frames", type=int, default=40, help="of each point (default 40)")
    command.add_argument("--full", action="store_const", const=400, dest="frames", help="400 of them")
    command.set_defaults(call=sweep)
    command = commands.add_parser("leave-out", help=leave_out.__doc__, description=leave_out.__doc__)
    _add_common(command)
    command.add_argument("what", help="wall:north, wall:south, wall:east, wall:west or harmonic")
    command.add_argument("--duration", type=float, default=60.0, metavar="SECONDS", help="of radio time (default 60)")
    command.set_defaults(call=leave_out)
    args = _program.parse(parser, argv)
    if not 5 <= args.payload:
        raise CastError(f"--payload: got {args.payload} bytes, needs 5 or more: four number the frame")
    return args.call(args)


if __name__ == "__main__":
    _program.run(main)
