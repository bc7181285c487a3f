#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Twin a protocol stack: build a commit once, try it on twin and testbed, and say where and why it differs."""

import argparse
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small products: one thread each is faster
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import _program
from gr_cast.core.errors import CastError
from gr_cast.core.files import check_writable, write_text
from gr_cast.pipeline import clean, document, site
from gr_cast.pipeline.bisect import bisect as find
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
    from gr_cast import report

    check_writable(args.storage)
    if not args.budget > 0:
        raise CastError(f"--budget: got {args.budget}, needs more than 0 seconds")
    storage = Storage(args.storage)
    source = Source(args.repository, storage.folder)
    source.update()
    return Bench(
        storage=storage,
        source=source,
        inventories=args.sites,
        room=clean.chosen(args.room, args.root_filesystem),
        budget_s=args.budget,
        render=report.render,
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


def _write_page(storage: Path, output: Path) -> None:
    from gr_cast.report import commits

    write_text(output, commits.render(histories(storage)))


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
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
    args = _program.parse(parser, argv)
    return args.call(args)


def _add_bench(command: argparse.ArgumentParser) -> None:
    command.add_argument("--repository", default=".", metavar="ADDRESS", help="of the stack: a folder or what Git clones")
    command.add_argument("--storage", type=Path, required=True, metavar="DIR", help="images, results and verdicts are kept here")
    command.add_argument("--sites", type=Path, required=True, metavar="DIR", help="folder of inventories, NAME.yaml each")
    command.add_argument("--room", choices=clean.KINDS, default="auto", help="what commands run in (default: the best there is)")
    command.add_argument("--root-filesystem", type=Path, metavar="DIR", help="of the LXC container that builds")
    command.add_argument("--budget", type=float, default=120.0, metavar="SECONDS", help="for a diagnosis (default 120)")


if __name__ == "__main__":
    _program.run(main)
