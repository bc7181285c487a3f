#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Base stations and terminals over a scenario: SINR and what 5 Mbit/s of UDP and TCP get through, over time."""

import argparse
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import _program
import numpy as np
from gr_cast import scenario as sc
from gr_cast.blocks.network import play
from gr_cast.comparing.series import write_csv
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.figures import fixed
from gr_cast.core.files import passing_folder, write_json
from gr_cast.core.units import db_from_power
from gr_cast.experiments import paper
from gr_cast.experiments.cellular import downlink as downlink_model
from gr_cast.experiments.cellular import experiment, stack, stack_run, stack_script
from gr_cast.experiments.cellular.downlink import Cell, Downlink, Radio
from gr_cast.experiments.cellular.stack_clock import LOOK_S, Clock
from gr_cast.experiments.traffic.namespaces import run_with_rights
from gr_cast.scenario.create import room
from gr_cast.scenario.create.spec import read as read_spec
from gr_cast.sounding.result import output_folder

CELLS = {1: ["12:34,37,41"], 2: ["10:33,34,35", "25:37,38,39"]}  # of the Arena: ceiling, standing; 41 walks
COLOSSEUM_LOSS_DB = paper.figures()["base_loss"]["mean_db"]  # of the emulator itself
TX_POWER_DBM, NOISE_FIGURE_DB = 27.0, 5.0  # the least in whole dB with which standing terminals hold 5 Mbit/s
SHORT_S, FULL_S = 15.0, 37.0
STEP_S = {1: 0.1, 2: 0.2}  # by stations: every station is sounded at every terminal
MODELLED = 64  # lines of a terminal's metrics beside which the model is set
Heard = tuple[np.ndarray, np.ndarray]  # instants of the scenario, and what a stack measured then
CHECKS = 3  # instants at which all stations are heard at once


def _scenarios(args, duration_s: float) -> tuple[list[tuple[str, sc.Scenario]], list[Cell], tuple[str, ...]]:
    """The scenarios to compare, each with its name, the cells on them, and all nodes of the place."""
    texts = args.cells or CELLS[args.stations]
    spec = read_spec(sc.examples_folder() / "arena.yaml")
    nodes = tuple(node.name for node in spec.nodes)
    if args.scenario:
        made = sc.load(args.scenario)
        if args.radios:
            made = sc.with_radios(made, args.radios, args.tx_power_dbm, args.noise_figure_db)
        if not args.cells and made.nodes != nodes:
            fitting = " ".join(experiment.suggested_cells(made, args.stations))
            raise CastError(f"{args.scenario}: which nodes are stations? They are told as in: --cells {fitting}")
        return [(made.name, made)], experiment.parse_cells(texts, made.nodes), made.nodes
    cells = experiment.parse_cells(texts, nodes)
    pairs = [(cell.station, node) for cell in cells for other in cells for node in other.terminals]
    place, twin = (room.scenario(spec, pairs, duration_s, four_taps=four_taps) for four_taps in (False, True))
    return [("place", place), ("twin", twin)], cells, nodes


def _sound(downlink: Downlink, name: str, time_s: np.ndarray) -> list[dict]:
    """The SINR at each instant; after Ctrl-C those that were measured."""
    sinrs = []
    try:
        for sinr in experiment.sinr_over_time(downlink, time_s):
            sinrs.append(sinr)
            told = f"{name}: {time_s[len(sinrs) - 1]:.2f} of {time_s[-1]:.2f} s sounded"
            _program.show(told, last=len(sinrs) == len(time_s))
    except KeyboardInterrupt:
        interrupts.settled()
        print(file=sys.stderr)
    return sinrs


def _settle_radios(args) -> None:
    """Powers, noise figures and the set-up's loss: of the options, else of the scenario's SPEC (whose radios stand in the place
    itself, without a set-up), else the defaults."""
    said = sc.radios_of(args.scenario) if args.scenario else None
    if said and args.tx_power_dbm is not None:
        said = replace(said, power_dbm={})
    if said and args.noise_figure_db is not None:
        said = replace(said, noise_figure_db={})
    args.radios = said if said and (said.power_dbm or said.noise_figure_db) else None
    defaults = {
        "tx_power_dbm": TX_POWER_DBM, "noise_figure_db": NOISE_FIGURE_DB,
        "setup_loss_db": 0.0 if args.radios else COLOSSEUM_LOSS_DB,
    }  # fmt: skip
    for name, value in defaults.items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    if args.radios:
        told = [words for words, of in (("powers", said.power_dbm), ("noise figures", said.noise_figure_db)) if of]
        print(f"{' and '.join(told)} are the SPEC's of {args.scenario}; set-up {args.setup_loss_db:g} dB", file=sys.stderr)


def _superposition(downlink: Downlink, time_s: np.ndarray) -> list[dict]:
    rows = []
    for instant in time_s[np.linspace(0, len(time_s) - 1, CHECKS).astype(int)]:
        for terminal, (measured_db, summed_db) in downlink.superposition(float(instant)).items():
            rows.append({
                "time_s": float(instant), "terminal": terminal, "interference_and_noise_db": measured_db,
                "sum_of_parts_db": summed_db,
            })  # fmt: skip
    return rows


def _radio(args) -> Radio:
    return Radio(blocks=args.blocks, tx_power_dbm=args.tx_power_dbm, noise_figure_db=args.noise_figure_db)


def model(args) -> int:
    duration_s = (FULL_S if args.full else SHORT_S) if args.duration is None else args.duration
    step_s = STEP_S[args.stations] if args.step is None else args.step
    if not (0 < step_s <= duration_s <= 3600):
        raise CastError(f"--step and --duration: got {step_s} and {duration_s} s, needs 0 < step <= duration <= 3600 s")
    if not 0 < args.offered <= 1e9:
        raise CastError(f"--offered: got {args.offered} bit/s, needs more than 0 and at most 1e9 bit/s")
    radio = _radio(args)
    scenarios, cells, nodes = _scenarios(args, duration_s)
    args.published = paper.cellular_rho(cells, nodes)
    time_s = np.arange(round(duration_s / step_s)) * step_s
    output = Path(args.output)
    output.mkdir(parents=True, exist_ok=True)
    courses, checks, files = [], [], []
    for number, (name, scenario) in enumerate(scenarios):
        # Each has noise of its own, as two measurements have.
        downlink = Downlink(sc.with_more_loss(scenario, args.setup_loss_db), cells, radio, play, seed=args.seed + number)
        sinrs = _sound(downlink, name, time_s)
        if not sinrs:
            break
        courses.append(experiment.course(name, cells, radio, time_s, sinrs, args.offered))
        files += experiment.write_series(output / (name if len(scenarios) > 1 else "series"), courses[-1])
        write_json(output / "cellular.json", _document(args, scenarios, cells, radio, courses, [], files))
        if len(sinrs) < len(time_s):
            break
        if len(cells) > 1:
            checks += [row | {"run": name} for row in _superposition(downlink, time_s)]
    if not courses:
        return 130
    complete = len(courses) == len(scenarios) and len(courses[-1].time_s) == len(time_s)
    _report(args, output, scenarios, cells, radio, courses, checks, files, complete)
    return 0 if complete else 130


def over_stack(args) -> int:
    """The same network with srsRAN 4G on ZeroMQ radios: its own metrics and iperf3's or MGEN's, over the emulated twin."""
    from gr_cast.blocks.emulation import Emulation
    from gr_cast.blocks.ports import Port

    duration_s = (FULL_S if args.full else SHORT_S) if args.duration is None else args.duration
    if not 2 <= duration_s <= 3600:
        raise CastError(f"--duration: got {duration_s} s, a stack needs 2 to 3600 s")
    scenarios, cells, _ = _scenarios(args, duration_s)
    played = experiment.restricted(scenarios[-1][1], cells)
    if not args.only_write:
        stack.check_programs("mgen" if args.protocol == "mgen" else "iperf3")
        run_with_rights(sys.argv)
    if not 1 <= args.attach_timeout <= 3600:
        raise CastError(f"--attach-timeout: got {args.attach_timeout} s, needs 1 to 3600 s")
    output = output_folder(args.output).resolve()
    with passing_folder() as passing:
        templates = Path(args.stack_config).expanduser()
        sockets = output / "stack/sockets" if args.only_write else passing
        members = stack.write_configuration(cells, args.blocks, templates, output / "stack", sockets)
        ports = [Port(node=m.node, direction="tx", kind="zmq", where=m.sends) for m in members]
        ports += [Port(node=m.node, direction="rx", kind="zmq", where=m.receives) for m in members]
        rate_hz = stack.SAMPLE_RATE_HZ[args.blocks]
        # The loss that all links share is put on the noise: receivers of a stack want samples near full scale.
        shared_db = played.base_loss_db + args.setup_loss_db
        noise_db = downlink_model.THERMAL_DBM_PER_HZ + 10 * np.log10(rate_hz) + args.noise_figure_db - args.tx_power_dbm
        noise_db += shared_db + args.stack_power_db
        leveled = sc.with_more_loss(played, -played.base_loss_db)
        scenario = output / ("stack/scenario.yaml" if leveled.is_static else "stack/scenario.zarr")
        sc.save(scenario, leveled)
        print(f"configuration: {output / 'stack'}; noise {noise_db:.2f} dB; {rate_hz:g} samples/s", file=sys.stderr)
        if args.only_write:
            program = Path(__file__).resolve().with_name("cast_emulator.py")
            emulator = stack_script.emulator_command(program, scenario, members, rate_hz, noise_db, args.seed)
            print(f"run it as root: bash {stack_script.write_script(output / 'stack', emulator, members)}")
            return 0
        plan = stack_run.Plan(
            members=members, folder=output / "stack", protocol=args.protocol, offered_bps=args.offered, duration_s=duration_s,
            attach_s=args.attach_timeout,
        )  # fmt: skip
        emulation = Emulation(leveled, ports, rate_hz, noise_power=10 ** (noise_db / 10), seed=args.seed)
        clock = Clock(plan.of("srsue"))
        failure, status = _run_stack(plan, emulation, rate_hz, clock)
    return _report_stack(args, output, plan, played, cells, failure, status, clock)


def _modelled_sinr_db(args, played, cells, heard: dict[str, Heard]) -> dict[str, np.ndarray]:
    """Each terminal's at the instants that it heard, as the model has it where no stack runs."""
    if args.blocks not in downlink_model.FFT_OF_BLOCKS:
        return {}
    downlink = Downlink(sc.with_more_loss(played, args.setup_loss_db), cells, _radio(args), play, seed=args.seed)
    return {
        node: db_from_power(np.array([sinr[node].mean() for sinr in experiment.sinr_over_time(downlink, scenario_s)]))
        for node, (scenario_s, _) in heard.items()
    }


def _heard(clock: Clock, found: dict, played) -> dict[str, Heard]:
    """Of every terminal's SINR, MODELLED lines at even distances; after the scenario's end its last instant goes on."""
    heard = {}
    for node, series in found.get("sinr_db", {}).items():
        scenario_s = np.minimum(clock.scenario_s(node, series.time_s), played.time_s[-1])
        known = np.flatnonzero(np.isfinite(scenario_s) & np.isfinite(series.value))
        if len(known):
            lines = known[np.linspace(0, len(known) - 1, min(len(known), MODELLED)).astype(int)]
            heard[node] = scenario_s[lines], series.value[lines]
    return heard


def _run_stack(plan, emulation, rate_hz: float, clock: Clock) -> tuple[CastError | None, dict]:
    """What went wrong, if anything, and the emulator's status when the stack was last seen at work: powers, and how far it
    kept up with the wall clock while there was traffic."""
    ended, failure, seen = threading.Event(), None, []

    def tell(line: str) -> None:
        seen[1:] = [(time.monotonic(), emulation.status())]
        _program.show(line)

    def watch() -> None:
        while not ended.wait(LOOK_S):
            clock.look(time.monotonic(), emulation.status()["scenario_time_s"])

    threads = [threading.Thread(target=emulation.run_until, args=(ended,), daemon=True), threading.Thread(target=watch)]
    for thread in threads:
        thread.start()
    try:
        stack_run.run(plan, tell, seen.clear)
    except CastError as error:
        failure = error
    except KeyboardInterrupt:
        interrupts.settled()
        failure = CastError("interrupted")
    finally:
        print(file=sys.stderr)
        seen = seen or [(time.monotonic(), emulation.status())]
        ended.set()
        for thread in threads:
            thread.join()
    (begin_s, first), (end_s, last) = seen[0], seen[-1]
    passed_s = end_s - begin_s
    factor = (last["samples"] - first["samples"]) / rate_hz / passed_s if passed_s else 0.0
    return failure, last | {"real_time_factor": factor}


def _report_stack(args, output: Path, plan, played, cells, failure, status: dict, clock: Clock) -> int:
    found, missing = stack_run.collect(plan)
    files, rows = [], []
    for quantity, terminals in found.items():
        for terminal, series in terminals.items():
            path = output / "series" / f"{quantity}_{terminal}.csv"
            path.parent.mkdir(exist_ok=True)
            write_csv(path, {"time_s": series.time_s, "value": series.value})
            files.append(str(path))
            known = series.value[np.isfinite(series.value)]
            rows.append({"terminal": terminal, "quantity": quantity, "mean": float(known.mean()) if known.size else None})
            mean = f"{known.mean():.6g}" if known.size else "–"
            print(f"{terminal:>10s} {quantity:>9s} mean {mean} over {known.size} samples")
    for line in missing:
        print(f"not recorded: {line}")
    for port, power in status["power"].items():
        level = "silent" if power["mean_db"] is None else f"{power['mean_db']:.1f} dB, peak {power['peak_db']:.1f} dB"
        print(f"{port}: {level}")
    print(f"real-time factor: {status['real_time_factor']:.2f}")
    document = {
        "cast_cellular": 1, "modelled": False, "stack": args.stack, "protocol": plan.protocol, "complete": False,
        "failure": None, "scenario": played.name, "offered_bps": args.offered,
        "means": rows, "series": files, "not_recorded": missing,
        "real_time_factor": status["real_time_factor"], "sinr": [], "power": status["power"],
    }  # fmt: skip
    heard, modelled = {}, {}
    try:
        write_json(output / "cellular.json", document)  # the model takes its time, and may be stopped
        if found:
            from gr_cast.report import plot

            plot.save(plot.stack_figure(found, f"{args.stack}, {plan.protocol}, over {played.name}"), output / "cellular.png")
        heard = _heard(clock, found, played)
        modelled = _modelled_sinr_db(args, played, cells, heard)
    except KeyboardInterrupt:
        interrupts.settled()
        failure = failure or CastError("interrupted before the model's SINR was there")
    document["sinr"] = _beside_the_model(output, heard, modelled)
    document |= {"complete": failure is None, "failure": str(failure) if failure else None}
    write_json(output / "cellular.json", document)
    if failure:
        raise failure
    return 0


def _beside_the_model(output: Path, heard: dict[str, Heard], modelled: dict[str, np.ndarray]) -> list[dict]:
    """A row per terminal: its own SINR beside that of the model, both mean dB, and which part of the scenario it heard; line by
    line in a file."""
    rows = []
    for terminal, model_db in modelled.items():
        scenario_s, stack_db = heard[terminal]
        path = output / "series" / f"sinr_beside_the_model_{terminal}.csv"
        write_csv(path, {"time_s": scenario_s, "value": stack_db, "model_db": model_db})
        first_s, last_s = float(scenario_s.min()), float(scenario_s.max())
        rows.append({"terminal": terminal, "stack_db": float(stack_db.mean()), "model_db": float(model_db.mean()),
                     "scenario_s": [first_s, last_s], "lines": str(path)})  # fmt: skip
        print(f"{terminal:>10s} SINR from {first_s:.2f} to {last_s:.2f} s of the scenario: stack {stack_db.mean():.2f} dB,"
              f" model {model_db.mean():.2f} dB, difference {(stack_db - model_db).mean():+.2f} dB")  # fmt: skip
    return rows


def _report(args, output: Path, scenarios, cells, radio, courses, checks, files, complete: bool) -> None:
    rows = [row for course in courses for row in experiment.summary(course, args.offered)]
    print(f"{experiment.MODEL}\n")
    print(f"{'run':>8s} {'terminal':>8s} {'SINR mean':>9s} {'min':>6s} {'max':>6s} {'CQI':>4s} {'UDP Mbit/s':>10s} {'loss %':>6s}"
          f" {'TCP Mbit/s':>10s}")  # fmt: skip
    for row in rows:
        sinr = [_figure(row[f"sinr_db_{which}"]) for which in ("mean", "min", "max")]
        print(f"{row['run'][:8]:>8s} {row['terminal']:>8s} {sinr[0]:>9s} {sinr[1]:>6s} {sinr[2]:>6s} {row['cqi_median']:4.0f}"
              f" {row['udp_bps_mean'] / 1e6:10.3f} {100 * row['udp_loss']:6.1f} {row['tcp_bps_mean'] / 1e6:10.3f}")  # fmt: skip
    for row in rows:
        if row["reason"]:
            print(f"{row['run']}: {row['terminal']}: {row['reason']}")
    worst_db = max((abs(row["interference_and_noise_db"] - row["sum_of_parts_db"]) for row in checks), default=None)
    if worst_db is not None:
        print(f"\nall stations at once: interference and noise within {worst_db:.2f} dB of the sum of their parts")
    similar = experiment.similarities(*courses) if complete and len(courses) == 2 and len(courses[0].time_s) > 1 else []
    if len(cells) == 2 and not args.cells:
        told = paper.figures()["two_cells"]
        holds = f"{told['udp_bps'] / 1e6:g} ± {told['udp_margin_bps'] / 1e6:g} Mbit/s"
        print(f"the paper's six standing terminals hold {holds}; it tells neither their numbers nor its carriers: here both"
              " stations send on one, at full load")  # fmt: skip
    if similar:
        _print_similarities(similar, [name for name, _ in scenarios], args.published)
    write_json(output / "cellular.json", _document(args, scenarios, cells, radio, courses, checks, files, similar, complete))
    title = f"{' and '.join(cell.station for cell in cells)}: modelled downlink, {args.offered / 1e6:g} Mbit/s offered"
    from gr_cast.report import plot  # here: what was found is written before anything is drawn

    plot.save(plot.cellular_figure(courses, title, args.offered), output / "cellular.png")
    print(f"picture: {output / 'cellular.png'}, figures: {output / 'cellular.json'}")


def _document(args, scenarios, cells, radio, courses, checks, files, similar=(), complete=False) -> dict:
    """The content of cellular.json, of as many courses as there are."""
    stations, terminals = [cell.station for cell in cells], [node for cell in cells for node in cell.terminals]
    return {
        "cast_cellular": 1, "modelled": True, "model": experiment.MODEL, "complete": complete,
        "scenarios": [{"run": name, "scenario": scenario.name, "about": scenario.description} for name, scenario in scenarios],
        "cells": [{"station": cell.station, "terminals": list(cell.terminals)} for cell in cells],
        "radio": {"resource_blocks": radio.blocks, "setup_loss_db": args.setup_loss_db,
                  "tx_power_dbm": _of_nodes(args.radios and args.radios.power_dbm, stations, radio.tx_power_dbm),
                  "noise_figure_db": _of_nodes(args.radios and args.radios.noise_figure_db, terminals, radio.noise_figure_db)},
        "offered_bps": args.offered, "seed": args.seed,
        "terminals": [row for course in courses for row in experiment.summary(course, args.offered)],
        "superposition": checks, "similarity": list(similar),
        "similarity_in_the_paper": args.published, "series": files,
    }  # fmt: skip


def _of_nodes(said: dict | None, nodes: list[str], shared: float) -> float | dict[str, float]:
    """One number that all share, or every node's own."""
    return {node: said.get(node, shared) for node in nodes} if said else shared


def _figure(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else fixed(value, digits)


def _print_similarities(rows: list[dict], names: list[str], published: dict) -> None:
    print(f"\nsimilarity of {names[0]} and {names[1]}; bias is {names[1]} less {names[0]}")
    print(f"{'terminal':>10s} {'of':>8s} {'rho':>6s} {'95 %':>14s} {'paper':>6s} {'bias':>8s} {'rmse':>8s}")
    for row in rows:
        scale, unit = (1, "dB") if row["quantity"] == "sinr_db" else (1e-6, "Mbit/s")
        bias, rmse = (_figure(None if row[key] is None else scale * row[key], 3) for key in ("bias", "rmse"))
        rho = "–" if row["rho"] is None else f"{row['rho']:.3f}"
        told = published.get(row["terminal"], {}).get(row["quantity"])
        told = "–" if told is None else f"{told:.3f}"
        interval = "{:.3f} … {:.3f}".format(*row["rho_interval"]) if row["rho_interval"] else ""
        print(f"{row['terminal']:>10s} {row['quantity']:>8s} {rho:>6s} {interval:>14s} {told:>6s}"
              f" {bias:>8s} {rmse:>8s}   {unit}")  # fmt: skip


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", required=True, metavar="DIR", help="picture, JSON and series")
    parser.add_argument("--stations", type=int, choices=(1, 2), default=1, help="base stations, three terminals each (default 1)")
    parser.add_argument("--cells", nargs="+", metavar="STATION:TERMINAL,…", help="instead: nodes by name, or number from 1")
    parser.add_argument("--scenario", metavar="ID", help="catalogue id or file; without it the Arena in closed form")
    parser.add_argument("--full", action="store_true", help=f"{FULL_S:g} s, as long as in the paper")
    parser.add_argument("--duration", type=float, metavar="S", help=f"seconds (default {SHORT_S:g})")
    parser.add_argument("--step", type=float, metavar="S", help="seconds between soundings (default 0.1; two stations 0.2)")
    parser.add_argument("--offered", type=float, default=5e6, metavar="BPS", help="to every terminal (default 5e6)")
    parser.add_argument("--blocks", type=int, default=50, help="LTE resource blocks: 6, 15, 25, 50 or 100 (default 50)")
    parser.add_argument("--tx-power-dbm", type=float, help="of a station (default: the SPEC's of a created scenario, else 27)")
    parser.add_argument("--noise-figure-db", type=float, help="of a terminal (default: the SPEC's, else 5)")
    parser.add_argument(
        "--setup-loss-db",
        type=float,
        help="on top of the scenario (default: Colosseum's, 57.55; 0 with the radios of a SPEC)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    parser.add_argument("--stack", choices=("srsran-4g",), help="run this stack over the emulator instead of the model")
    parser.add_argument("--stack-config", default="~/.config/srsran", metavar="DIR", help="its sib.conf, rb.conf and rr.conf")
    parser.add_argument(
        "--stack-power-db", type=float, default=stack.FULL_LOAD_DB,
        help="of a station's samples at full load, dB re 1 (default -15.2: srsRAN's, at a tx_gain of 0 dB)",
    )  # fmt: skip
    parser.add_argument(
        "--protocol", choices=("udp", "tcp", "mgen"), default="udp",
        help="with --stack: iperf3's udp (default) or tcp, or MGEN's packets, whose logs also tell loss and latency",
    )  # fmt: skip
    parser.add_argument(
        "--attach-timeout", type=float, default=120.0, metavar="S", help="with --stack: for all terminals (default 120)"
    )
    parser.add_argument(
        "--only-write", action="store_true", help="with --stack: write its configuration and a script that runs it"
    )
    args = _program.parse(parser, argv)
    _settle_radios(args)
    return over_stack(args) if args.stack else model(args)


if __name__ == "__main__":
    _program.run(main)
