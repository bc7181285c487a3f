#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Twin a protocol stack: build a commit once, try it on twin and testbed, and say where and why it differs."""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small products: one thread each is faster
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import _program
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.files import check_writable, write_text
from gr_cast.core.processes import Processes
from gr_cast.pipeline import air, clean, document, server, site
from gr_cast.pipeline.bisect import bisect as find
from gr_cast.pipeline.jenkins import job as make_job
from gr_cast.pipeline.run import Bench
from gr_cast.pipeline.source import Source
from gr_cast.pipeline.stages import Storage, histories
from gr_cast.pipeline.verdict import SAME


def check(args) -> int:
    """Every fault of a pipeline, and of its sites' inventories where a folder of them is given."""
    pipeline, faults = document.read(args.path), []
    folder = args.path if args.path.is_dir() else args.path.parent
    if args.sites:
        faults = site.read_all(args.sites, pipeline, folder)[1]
    if faults:
        raise CastError(*faults)
    repeats = sum(one.repeats for one in pipeline.experiments)
    print(f"{pipeline.name}: {len(pipeline.experiments)} experiments, {repeats} repeats at each of {', '.join(pipeline.sites)}")
    return 0


def _bench(args) -> Bench:
    from gr_cast.report.link.page import render

    check_writable(args.storage)
    if not args.budget > 0:
        raise CastError(f"--budget: got {args.budget}, needs more than 0 seconds")
    _program.check_ranges(args, {"patience": (0.01, 1000, "")})
    storage = Storage(args.storage)
    source = Source(args.repository, storage.folder)
    source.update()
    return Bench(
        storage=storage,
        source=source,
        inventories=args.sites,
        room=clean.chosen(args.room, args.root_filesystem),
        budget_s=args.budget,
        patience=args.patience,
        render=render,
        progress=lambda line: print(line, flush=True),
    )


def run(args) -> int:
    """Judge commits, one after the other; status 1 where one is anything but the same on both."""
    bench = _bench(args)
    return 0 if all([_judge(bench, name) for name in args.commits]) else 1


def _judge(bench: Bench, name: str) -> bool:
    """Print the verdict of a commit, and put it on the storage's page; whether all is well."""
    found = bench.commit(name).judged()
    _write_page(bench.storage.folder, bench.storage.folder / "index.html")
    print(f"{found['commit'][:10]} {found['subject']}")
    for one in found["verdicts"]:
        print(f"    {one['kind']}: {one['sentence']}")
    return found["kinds"] == [SAME]


def bisect(args) -> int:
    """The first commit that is worse than GOOD, of those up to BAD, and why."""
    bench = _bench(args)
    found = find(bench, args.good, args.bad)
    print("\n".join(found.symptoms))
    if len(found.suspects) > 1:
        print(f"one of {len(found.suspects)}, for those between cannot be tried or decided: {' '.join(found.suspects)}")
    else:
        print(f"first bad commit, of {len(found.tried)} tried: {found.suspects[0]}")
        _judge(bench, found.suspects[0])
    return 0


def page(args) -> int:
    """Commits × sites with their verdicts, one HTML page; `run` writes it too, as index.html of the storage."""
    output = args.output or args.storage / "index.html"
    if not (args.storage / "verdicts").is_dir():
        raise CastError(f"{args.storage}: no storage: cast_pipeline run makes one")
    _write_page(args.storage, output)
    print(f"written: {output}")
    return 0


def serve(args) -> int:
    """Judge every new commit of repositories: Buildbot polls them, on SQLite and this machine unless told otherwise."""
    check_writable(args.storage)
    _program.check_ranges(args, {"port": (1, 65534, ""), "poll": (1, 86400, "s")})
    workers = dict(pair.split("=", 1) for pair in args.worker if "=" in pair)
    if len(workers) < len(args.worker):
        raise CastError("--worker: needs NAME=FILE, the file that holds its password")
    storage = Storage(args.storage)
    told = server.settings(
        storage=storage.folder, repositories=args.repository, branches=args.branch, program=_program_words(),
        options=_options(args), port=args.port, page=f"http://127.0.0.1:{args.port + 1}/", database=args.database,
        workers=workers, poll_s=args.poll,
    )  # fmt: skip
    words = server.prepared(storage.folder / "server", told)
    _write_page(storage.folder, storage.folder / "index.html")
    with Processes(storage.folder / "server") as running, interrupts.heeded(lambda: None) as stopped:
        running.start("buildbot", words)
        folder = ["--directory", str(storage.folder), "--bind", "127.0.0.1", str(args.port + 1)]
        running.start("page", [sys.executable, "-m", "http.server", *folder])
        print(f"builds: {told['address']}\npage:   {told['page']}", flush=True)
        while not stopped.wait(1.0):
            running.check()
    return 0


def radios(args) -> int:
    """What an inventory's `program` calls: play tx_NODE.cf32 over X310s and record rx_NODE.cf32, from one second of UTC on."""
    from gr_cast.blocks import site_radios

    _program.check_ranges(args, {"amplitude": (1e-6, 1, "of full scale")})
    told = air.told_of(os.environ)
    sent = {node: args.amplitude * samples for node, samples in air.given(told, Path()).items()}
    band = site_radios.Band(
        sample_rate_hz=told.sample_rate_hz, center_frequency_hz=args.frequency or told.center_frequency_hz,
        clock_source=args.clock_source, time_source=args.time_source,
    )  # fmt: skip
    site_radios.play_and_record(sent, told.receivers, told.devices, band, Path())
    return 0


def jenkins(args) -> int:
    """A job description for Jenkins, which jenkins-job-builder turns into a job."""
    pipeline = document.read(args.path)
    text = make_job(pipeline, args.repository, args.branch, _program_words(), _options(args))
    print(text, end="") if args.output is None else write_text(args.output, text)
    return 0


def _program_words() -> list[str]:
    return ["/usr/bin/python3", str(Path(__file__).resolve())]


def _options(args) -> list[str]:
    """Options of `run` that a server passes on."""
    given = [("--storage", args.storage.resolve()), ("--sites", args.sites.resolve()), ("--room", args.room)]
    given += [("--root-filesystem", args.root_filesystem)] if args.root_filesystem else []
    return [str(word) for pair in [*given, ("--budget", args.budget), ("--patience", args.patience)] for word in pair]


def _write_page(storage: Path, output: Path) -> None:
    from gr_cast.report import commits

    write_text(output, commits.render(histories(storage)))


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    command = verbs.add_parser("check", help=check.__doc__, description=check.__doc__)
    command.add_argument("path", type=Path, nargs="?", default=Path(), help="pipeline.yaml, or its folder (default: here)")
    command.add_argument("--sites", type=Path, metavar="DIR", help="folder of inventories, NAME.yaml each")
    command.set_defaults(call=check)
    command = verbs.add_parser("run", help=run.__doc__, description=run.__doc__)
    command.add_argument("commits", nargs="+", metavar="COMMIT", help="any name that Git knows")
    _add_bench(command)
    command.set_defaults(call=run)
    command = verbs.add_parser("bisect", help=bisect.__doc__, description=bisect.__doc__)
    command.add_argument("good", metavar="GOOD")
    command.add_argument("bad", metavar="BAD")
    _add_bench(command)
    command.set_defaults(call=bisect)
    command = verbs.add_parser("page", help=page.__doc__, description=page.__doc__)
    command.add_argument("--storage", type=Path, required=True, metavar="DIR")
    command.add_argument("--output", type=Path, metavar="FILE.html", help="elsewhere than in the storage")
    command.set_defaults(call=page)
    command = verbs.add_parser("serve", help=serve.__doc__, description=serve.__doc__)
    command.add_argument("--repository", nargs="+", required=True, metavar="ADDRESS", help="what Git clones")
    command.add_argument("--branch", nargs="+", default=["main"], metavar="NAME", help="of each repository (default: main)")
    command.add_argument(
        "--port", type=int, default=8010, help="of Buildbot's page; the commits' page has the next (default 8010)"
    )
    command.add_argument("--poll", type=float, default=60.0, metavar="SECONDS", help="between two looks (default 60)")
    command.add_argument("--database", metavar="URL", help="such as postgresql://USER@HOST/NAME (default: SQLite in the storage)")
    command.add_argument("--worker", nargs="+", default=[], metavar="NAME=FILE", help="remote workers, a file with each password")
    _add_bench(command, repository=False)
    command.set_defaults(call=serve)
    command = verbs.add_parser("radios", help=radios.__doc__, description=radios.__doc__)
    command.add_argument("--frequency", type=_program.carrier, metavar="HZ", help="default: the scenario's carrier")
    command.add_argument("--amplitude", type=float, default=0.5, metavar="A", help="of full scale, of what is sent (default 0.5)")
    command.add_argument("--clock-source", default="external", help="external or gpsdo (default external)")
    command.add_argument("--time-source", default="external", help="external or gpsdo: a pulse that all share (default external)")
    command.set_defaults(call=radios)
    command = verbs.add_parser("jenkins", help=jenkins.__doc__, description=jenkins.__doc__)
    command.add_argument("path", type=Path, nargs="?", default=Path(), help="pipeline.yaml, or its folder (default: here)")
    command.add_argument("--branch", nargs="+", default=["main"], metavar="NAME")
    command.add_argument("--output", type=Path, metavar="FILE.yaml", help="instead of the screen")
    _add_bench(command)
    command.set_defaults(call=jenkins)
    args = _program.parse(parser, argv)
    return args.call(args)


def _add_bench(command: argparse.ArgumentParser, repository: bool = True) -> None:
    if repository:
        command.add_argument("--repository", default=".", metavar="ADDRESS", help="of the stack: a folder or what Git clones")
    command.add_argument("--storage", type=Path, required=True, metavar="DIR", help="images, results and verdicts are kept here")
    command.add_argument("--sites", type=Path, required=True, metavar="DIR", help="folder of inventories, NAME.yaml each")
    command.add_argument("--room", choices=clean.KINDS, default="auto", help="what commands run in (default: the best there is)")
    command.add_argument("--root-filesystem", type=Path, metavar="DIR", help="of the LXC container that builds")
    command.add_argument("--budget", type=float, default=120.0, metavar="SECONDS", help="for a diagnosis (default 120)")
    command.add_argument(
        "--patience", type=float, default=1.0, metavar="X",
        help="limits are so many times longer, on a slow machine: 60 s of a node's command and an hour of a build or of a site's"
        " program, unless pipeline.yaml has others (default 1)",
    )  # fmt: skip


if __name__ == "__main__":
    _program.run(main)
