#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Say whether GNU Radio finds gr-cast as it stands, and where it does not, which line to add to which file."""

import argparse
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import _program
import cast_grc
import gr_cast
from gr_cast.core.documents import json_text
from gr_cast.core.errors import CastError

PACKAGE = Path(gr_cast.__file__).parents[1]
# What a flowgraph sees: the interpreter of GNU Radio Companion, in the environment as it is.
PROBE = """
import importlib, json, sys

def of(name, what="__file__"):
    try:
        return str(getattr(importlib.import_module(name), what, "there")), None
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"

found = {name: of(name) for name in ("gnuradio", "gr_cast", "gr_cast.blocks", "gnuradio.cast", "gnuradio.grc")}
found |= {name: of(name, "__version__") for name in ("numpy", "scipy", "matplotlib", "yaml", "zmq", "sionna.rt", "argcomplete")}
paths = []
if found["gnuradio.grc"][0]:
    from gnuradio import gr
    from gnuradio.grc.core.Config import Config
    paths = Config(gr.version(), prefs=gr.prefs()).block_paths
    found["GNU Radio"] = gr.version(), None
print(json.dumps({"found": found, "block_paths": paths, "python": sys.version.split()[0]}))
"""
OPTIONAL = {
    "sionna.rt": "ray tracing in cast_scenario create",
    "argcomplete": "completion in the shell",
    "zmq": "protocol stacks",
}


def interpreter() -> str:
    """The Python that GNU Radio Companion runs in, and flowgraphs after it."""
    program = shutil.which("gnuradio-companion") or shutil.which("grcc")
    if program is None:
        return sys.executable
    with open(program, "rb") as file:
        first = file.readline().decode(errors="replace")
    return shlex.split(first[2:])[-1] if first.startswith("#!") and "/env " not in first else sys.executable


def probed(python: str) -> dict:
    done = subprocess.run([python, "-P" if sys.version_info >= (3, 11) else "-B", "-c", PROBE], capture_output=True, text=True)
    if done.returncode:
        raise CastError(f"{python}: {done.stderr.strip().splitlines()[-1]}")
    return json_text(done.stdout.splitlines()[-1], python).document


def faults(told: dict) -> list[tuple[str, str]]:
    """(what is missing, what to do about it) of all that GNU Radio needs."""
    found, missing = told["found"], []
    if not any((PACKAGE / "gr_cast" / "blocks").glob("cast_python*")):
        missing.append(tuple(_program.NOT_BUILT.split(": ", 1)))
    if not found["gnuradio"][0]:
        missing.append((f"GNU Radio: {found['gnuradio'][1]}", "install gnuradio (3.10) for this Python"))
    if not found["gr_cast"][0]:
        missing.append(("Python does not find gr_cast", f"add to ~/.profile: export PYTHONPATH={PACKAGE}:$PYTHONPATH"))
    elif Path(found["gr_cast"][0]).parents[1].resolve() != PACKAGE.resolve():
        other = Path(found["gr_cast"][0]).parents[1]
        missing.append((f"Python finds another gr_cast, {other}", f"remove it, or: export PYTHONPATH={PACKAGE}:$PYTHONPATH"))
    elif not found["gr_cast.blocks"][0]:
        missing.append((f"the blocks do not load: {found['gr_cast.blocks'][1]}", "build and install for this Python again"))
    if not any((Path(path) / "cast_channel_emulator.block.yml").is_file() for path in told["block_paths"]):
        setting = f"[grc] local_blocks_path = {cast_grc.BLOCKS} in ~/.gnuradio/config.conf"
        missing.append(
            (
                "GNU Radio Companion does not find the blocks",
                f"add to ~/.profile: export GRC_BLOCKS_PATH={cast_grc.BLOCKS}   (or {setting})",
            )
        )
    programs = _program.PREFIX / "bin"
    if programs.joinpath("cast_doctor").is_file() and str(programs) not in os.environ.get("PATH", "").split(os.pathsep):
        missing.append(("the programs are not on PATH", f"add to ~/.profile: export PATH={programs}:$PATH"))
    major = (found["numpy"][0] or "0").split(".")[0]
    if int(major) >= 2:
        missing.append((f"NumPy {found['numpy'][0]}: GNU Radio 3.10's bindings need 1.x", "pip install 'numpy<2'"))
    for name in ("numpy", "scipy", "matplotlib", "yaml"):
        if not found[name][0]:
            missing.append((f"{name}: {found[name][1]}", f"install python3-{name}"))
    return missing


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    _program.parse(parser, argv)
    python = interpreter()
    told = probed(python)
    version = told["found"].get("GNU Radio", ["not found"])[0]
    print(f"gr-cast {gr_cast.__version__} in {PACKAGE}\nGNU Radio {version}, Python {told['python']} ({python})")
    for what, remedy in (missing := faults(told)):
        print(f"MISSING  {what}\n         {remedy}")
    for name, use in OPTIONAL.items():
        if not told["found"][name][0]:
            print(f"optional {name} is not there: {use}")
    if not missing:
        print("all that GNU Radio needs is found")
    return 1 if missing else 0


if __name__ == "__main__":
    _program.run(main)
