#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Compare two runs: similarity ρ of two series and what ρ does not see, or two impulse responses tap by tap."""

import argparse
from pathlib import Path

import _program
import numpy as np
from gr_cast import scenario as sc
from gr_cast.comparing import responses, series, similarity
from gr_cast.core.errors import CastError
from gr_cast.core.files import write_json
from gr_cast.core.units import db_from_amplitude
from gr_cast.sounding.result import output_folder


def _response(name: str, link: str | None, time_s: float) -> responses.Response | None:
    """The taps of a sounding, or of a scenario's link; None where `name` is a series."""
    sounding = responses.from_sounding(Path(name))
    if sounding is not None or (link is None and not sc.is_scenario(name)):
        return sounding
    scenario, key = sc.load(name), tuple((link or "").split(">", 1))
    if key not in scenario.links:
        shown = ", ".join(map(sc.link_name, list(scenario.links)[:8])) + (", …" if len(scenario.links) > 8 else "")
        said = "is a scenario: add" if link is None else f"--link: got {link!r}, needs"
        raise CastError(f"{name}: {said} --link 'TX>RX' of {shown}")
    delay_s, gain = (value[0] for value in sc.taps_at(scenario, key, np.array([time_s])))
    played_db = db_from_amplitude(gain[gain != 0]) - sc.base_loss_db(scenario, key)
    return responses.Response(name=f"{name} {link}", delay_s=delay_s[gain != 0], gain_db=played_db)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("a", metavar="A", help="series (.csv, .json, .parquet), sounding (folder or result.json) or scenario")
    parser.add_argument("b", metavar="B", help="the same kind")
    parser.add_argument("--output", required=True, metavar="DIR", help="comparison.json and comparison.png go here")
    parser.add_argument("--column", default="value", help="of both series, beside time_s (default: value)")
    parser.add_argument("--unit", default="", help="of the series, for the picture")
    parser.add_argument("--max-lag", type=int, default=similarity.MAX_LAG, metavar="SAMPLES", help="for ρ (default 10)")
    parser.add_argument("--step", type=float, metavar="SECONDS", help="average both series over steps of this length first")
    parser.add_argument("--seed", type=int, default=0, help="of the bootstrap")
    parser.add_argument("--link", metavar="TX>RX", help="A or B is a scenario: compare this link's taps")
    parser.add_argument("--time", type=float, default=0.0, metavar="SECONDS", help="of the scenario's taps (default 0)")
    parser.add_argument("--tolerance", type=float, default=20e-9, metavar="SECONDS", help="between paired taps (default 20e-9)")
    args = _program.parse(parser, argv)
    from gr_cast.report import plot

    both = [_response(name, args.link, args.time) for name in (args.a, args.b)]
    if any(both):
        if not all(both):
            raise CastError(f"{args.a}, {args.b}: got an impulse response and a series, needs two of a kind")
        found = responses.compare_responses(*both, args.tolerance)
        document, table = responses.as_document(found), responses.as_table
        figure = plot.response_comparison_figure(found)
    else:
        pair = [series.read(name, args.column) for name in (args.a, args.b)]
        found = similarity.compare(*pair, max_lag=args.max_lag, step_s=args.step, seed=args.seed)
        document, table = similarity.as_document(found), similarity.as_table
        figure = plot.series_comparison_figure(found, f"{args.column} {args.unit}".strip())
    folder = output_folder(args.output)
    plot.save(figure, folder / "comparison.png")
    write_json(folder / "comparison.json", document)
    print(table(document))
    return 0


if __name__ == "__main__":
    _program.run(main)
