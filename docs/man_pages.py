# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a manual page of every program from its own arguments, as part of the build: man_pages.py FOLDER."""

import argparse
import importlib
import os
import sys
from pathlib import Path

from gr_cast import __version__  # the one on PYTHONPATH, before a program finds another

APPS = Path(__file__).resolve().parents[1] / "apps"
sys.path.insert(0, str(APPS))
os.environ["COLUMNS"] = "79"
import _program


class _Parsed(Exception):
    pass


def parser_of(name: str) -> argparse.ArgumentParser:
    """The arguments of a program, taken where it is about to parse them."""

    def stop(parser, *_):
        raise _Parsed(_program.settled(parser))

    sys.argv[0], _program.parse = name, stop
    try:
        importlib.import_module(name).main([])
    except _Parsed as stopped:
        return stopped.args[0]
    raise AssertionError(f"{name} parses nothing")


def roff(text: str) -> str:
    """Text that roff takes as it stands: a dot or quote that begins a line is no command."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return "\n".join(f"\\&{line}" if line[:1] in (".", "'") else line for line in escaped.splitlines())


def verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {name: verb for action in actions for name, verb in action.choices.items()}


def page(name: str, parser: argparse.ArgumentParser) -> str:
    what = " ".join(parser.description.split())
    first = what.split(": ")[0].split(". ")[0].removesuffix(".")
    parts = [f'.TH {name.upper()} 1 "" "gr-cast {__version__}" "User Commands"', ".SH NAME", f"{name} \\- {roff(first)}"]
    parts += [".SH DESCRIPTION", roff(what), ".SH OPTIONS", ".nf", roff(parser.format_help()), ".fi"]
    for verb, of_verb in verbs(parser).items():
        parts += [f'.SH "{name.upper()} {verb.upper()}"', ".nf", roff(of_verb.format_help()), ".fi"]
    parts += [
        ".SH EXIT STATUS",
        "0: done. 2: input was refused, a line for each fault, and nothing was written. 130: interrupted.",
    ]
    return "\n".join(parts) + "\n"


def main() -> None:
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(APPS.glob("cast_*.py")):
        (folder / f"{path.stem}.1").write_text(page(path.stem, parser_of(path.stem)), encoding="utf-8")


if __name__ == "__main__":
    main()
