#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Flows of packets by MGEN, as Colosseum's traffic generator sends them: over a wire, or over modems and the emulator."""

import argparse
import contextlib
import sys
from pathlib import Path

import _program
import numpy as np
from gr_cast import scenario as sc
from gr_cast.comparing.series import write_csv
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.files import write_json
from gr_cast.experiments.traffic import flows, log, namespaces
from gr_cast.experiments.traffic import run as generators
from gr_cast.sounding.result import output_folder

STEP_S = 1.0  # of the series
LOWERED_DB = [0, 10, 12, 14, 20]
IP_AND_UDP = 28  # bytes


def _progress(seconds: float) -> None:
    _program.show(f"{max(seconds, 0.0):6.1f} s")


def _read(args) -> flows.Traffic:
    traffic = flows.read(args.flows)
    return flows.stretched(traffic, args.duration) if args.duration else traffic


@contextlib.contextmanager
def _nodes(traffic: flows.Traffic):
    with contextlib.ExitStack() as stack:
        nodes = []
        for node, address in flows.addresses(traffic.nodes).items():
            nodes.append(namespaces.Namespace(node, address))
            stack.callback(nodes[-1].close)
        yield nodes


def _generate(traffic, nodes, folder: Path, is_quiet=lambda: True) -> tuple[list[log.FlowResult], str | None]:
    """What the logs say, and what went wrong, if anything: figures come out either way."""
    failure = None
    try:
        generators.generate(traffic, nodes, folder, is_quiet=is_quiet, progress=_progress)
    except CastError as error:
        failure = error.faults[0]
    except KeyboardInterrupt:
        interrupts.settled()
        failure = "interrupted"
    finally:
        print(file=sys.stderr)
    return log.evaluate(traffic, generators.logs_in(traffic, folder)), failure


def _report(output: Path, traffic, runs: list[dict], about: dict, failure: str | None) -> int:
    rows = []
    print(f"{'run':>10s} {'flow':>20s} {'sent':>6s} {'received':>8s} {'loss %':>7s} {'kbit/s':>8s}"
          f" {'latency ms':>10s} {'99 %':>8s}")  # fmt: skip
    for run in runs:
        for result in run["results"]:
            row = log.row(result) | {key: value for key, value in run.items() if key != "results"}
            rows.append(row)
            loss, median, worst = (
                "–" if row[key] is None else f"{scale * row[key]:.2f}"
                for key, scale in (("loss", 100), ("latency_s_median", 1e3), ("latency_s_99", 1e3))
            )
            print(f"{run['run']:>10s} {row['flow'][:20]:>20s} {row['sent']:6d} {row['received']:8d} {loss:>7s}"
                  f" {row['throughput_bps'] / 1e3:8.2f} {median:>10s} {worst:>8s}")  # fmt: skip
            for name, (time_s, value) in log.series(result, traffic.duration_s, STEP_S).items():
                if len(time_s) > 1:
                    path = output / run["run"] / f"{name}_flow{result.flow.number}.csv"
                    write_csv(path, {"time_s": time_s, "value": value})
    document = {"cast_traffic": 1, **about, "complete": failure is None, "failure": failure, "flows": rows}
    write_json(output / "traffic.json", document)
    from gr_cast.report import plot  # here: what was found is written before anything is drawn

    plot.save(plot.traffic_figure(runs, traffic.duration_s, STEP_S), output / "traffic.png")
    print(f"picture: {output / 'traffic.png'}, figures: {output / 'traffic.json'}")
    if failure:
        raise CastError(failure)
    return 0


def wire(args) -> int:
    """Between two network namespaces of this machine, joined by a wire."""
    traffic = _read(args)
    if len(traffic.nodes) != 2:
        raise CastError(f"{args.flows}: a wire has two ends, the flows join {', '.join(traffic.nodes)}")
    generators.check_mgen()
    namespaces.run_with_rights(sys.argv)
    output = output_folder(args.output)
    with _nodes(traffic) as nodes:
        nodes[0].join(nodes[1])
        results, failure = _generate(traffic, nodes, output / "wire")
    return _report(output, traffic, [{"run": "wire", "results": results}], {"over": "a wire"}, failure)


def radio(args) -> int:
    """Between network namespaces whose packets a modem at each node carries over the emulated channel, in real time."""
    from gr_cast.blocks.modem import open_modem
    from gr_cast.blocks.radio_link import LATENCIES_S, RadioLink

    traffic, scenario = _read(args), sc.load(args.scenario)
    if not 1e4 <= args.rate <= 2e6:
        raise CastError(f"--rate: got {args.rate} samples/s, needs 1e4 to 2e6 samples/s (real time)")
    if not np.isfinite([args.snr_db, *args.lower]).all():
        raise CastError(f"--snr-db, --lower: got {args.snr_db} and {args.lower} dB, need finite numbers")
    least_s, most_s = LATENCIES_S
    if not least_s <= args.latency <= most_s:
        raise CastError(f"--latency: got {args.latency:g} s, needs {least_s:g} to {most_s:g} s")
    modem = open_modem("802.11a", args.mode)
    generators.check_mgen()
    namespaces.run_with_rights(sys.argv)
    output = output_folder(args.output)
    mtu = max(flow.size_bytes for flow in traffic.flows) + IP_AND_UDP
    runs, failure, status = [], None, {}
    for lower_db in args.lower:
        name = f"{0 - lower_db:g} dB"
        print(f"{name}: taps of {scenario.name} lowered by {lower_db:g} dB", file=sys.stderr)
        with _nodes(traffic) as nodes, contextlib.ExitStack() as stack:
            tuns = {node.name: node.open_tun() for node in nodes}
            for file in tuns.values():
                stack.callback(namespaces.os.close, file)
            lowered = sc.with_base_loss(scenario, lower_db)
            noise_power = 10 ** (-args.snr_db / 10)
            link = RadioLink(
                lowered, tuns, modem, args.rate, noise_power=noise_power, mtu=mtu, seed=args.seed, latency_s=args.latency
            )
            with link:
                results, failure = _generate(traffic, nodes, output / name, lambda link=link: link.is_quiet)
                status = link.status()
        runs.append({"run": name, "lowered_db": lower_db, "real_time_factor": status["real_time_factor"],
                     "frames": status["frames"], "results": results})  # fmt: skip
        if failure:
            break
    about = {"over": modem.name, "scenario": scenario.name, "sample_rate_hz": args.rate, "snr_at_0_db_db": args.snr_db,
             "held_back_s": args.latency, "longest_frame_s": link.frame_s}  # fmt: skip
    print(f"modem: {modem.name} at {args.rate:g} samples/s")
    print(f"latency: at most {1e3 * args.latency:g} ms held back (--latency), at most {1e3 * link.frame_s:.1f} ms the frame"
          " itself; the rest is this machine's")  # fmt: skip
    return _report(output, traffic, runs, about, failure)


def scripts(args) -> int:
    """Only write the MGEN script of every node, to be run elsewhere."""
    traffic = _read(args)
    for node, path in generators.write_scripts(traffic, output_folder(args.output)).items():
        print(f"{path}: at {node}, {flows.addresses(traffic.nodes)[node]}: mgen input {path.name} output {node}.log txlog")
    return 0


def evaluate(args) -> int:
    """Read the logs of a run made elsewhere."""
    traffic = _read(args)
    results = log.evaluate(traffic, generators.logs_in(traffic, Path(args.logs)))
    return _report(output_folder(args.output), traffic, [{"run": "logs", "results": results}], {"over": "unknown"}, None)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for function in (wire, radio, scripts, evaluate):
        command = commands.add_parser(function.__name__, help=function.__doc__, description=function.__doc__)
        command.add_argument("flows", nargs="?", default="tgen", help="YAML file, or an example that ships (default: tgen)")
        command.add_argument("--output", required=True, metavar="DIR")
        command.add_argument("--duration", type=float, metavar="S", help="stretch the flows to this length")
        command.set_defaults(function=function)
        if function is radio:
            command.add_argument("--scenario", default="four_tap", metavar="ID", help="its nodes are those of the flows")
            command.add_argument("--lower", type=float, nargs="+", default=LOWERED_DB, metavar="DB", help="taps, a run each")
            command.add_argument("--snr-db", type=float, default=20.0, help="of a link of 0 dB (default 20)")
            command.add_argument("--mode", default="qpsk1/2", help="of the modem: bpsk1/2, qpsk1/2 (default), 16qam1/2")
            command.add_argument(
                "--rate", type=_program.rate, default=500e3, help="samples/s (default 500e3): one core does a million"
            )
            command.add_argument(
                "--latency", type=float, default=35e-3, metavar="S",
                help="that samples are held back at most, 2e-3 to 1 (default 35e-3): the less, the more work for the machine",
            )  # fmt: skip
            command.add_argument("--seed", type=int, default=0, help="of the noise")
        if function is evaluate:
            command.add_argument("--logs", required=True, metavar="DIR", help="NODE.log of every node")
    args = _program.parse(parser, argv)
    return args.function(args)


if __name__ == "__main__":
    _program.run(main)
