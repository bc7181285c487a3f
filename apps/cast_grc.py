#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Open flowgraphs in gnuradio-companion, where the blocks of this built checkout or install are found."""

import argparse
import os
import shutil
from pathlib import Path

import _program
import gr_cast
from gr_cast.core.errors import CastError

_HERE = Path(__file__).resolve().parent
FLOWGRAPHS = _HERE / "flowgraphs"
_CHECKOUT, _INSTALLED = _HERE.parent / "grc", _HERE.parents[1] / "gnuradio/grc/blocks"
BLOCKS = _CHECKOUT if _CHECKOUT.is_dir() else _INSTALLED


def flowgraph_path(name: str) -> Path:
    """The file of a shipped flowgraph's name, or of a path."""
    path = FLOWGRAPHS / f"{name}.grc" if "/" not in name and not name.endswith(".grc") else Path(name)
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in FLOWGRAPHS.glob("*.grc")))
        raise CastError(f"flowgraph: got {name!r}, needs a .grc file or one of {shipped}")
    return path


def environment(inherited) -> dict:
    """The environment in which GNU Radio Companion, and what it starts, find the blocks and gr_cast."""
    python = Path(gr_cast.__file__).parents[1]

    def first(place, variable):
        return os.pathsep.join([str(place), *filter(None, [inherited.get(variable)])])

    found = {"GRC_BLOCKS_PATH": first(BLOCKS, "GRC_BLOCKS_PATH"), "PYTHONPATH": first(python, "PYTHONPATH")}
    return dict(inherited) | found


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "flowgraphs",
        nargs="*",
        default=["loopback"],
        metavar="FLOWGRAPH",
        help="a shipped name or a .grc file (default: loopback)",
    )
    paths = [flowgraph_path(name) for name in _program.parse(parser, argv).flowgraphs]
    companion = shutil.which("gnuradio-companion")
    if companion is None:
        raise CastError("gnuradio-companion: not found on PATH; install GNU Radio with its graphical tools")
    os.execve(companion, [companion, *map(str, paths)], environment(os.environ))


if __name__ == "__main__":
    _program.run(main)
