# SPDX-License-Identifier: GPL-3.0-or-later
"""How to type another program of the project, so that what a message says can be pasted, in a checkout and installed."""

import os
import shutil
import sys
from pathlib import Path


def called(name: str) -> str:
    """A program as this shell finds it: beside the program that runs, by its name alone where PATH leads there."""
    own = Path(sys.argv[0])
    if not own.name.startswith("cast_"):
        return name
    there = own.with_name(name + own.suffix)
    found = shutil.which(there.name)
    return there.name if found and Path(found).absolute() == there.absolute() else str(there)


def installer() -> str:
    """What installs the optional Python tools: `bash …/install_raytracer.sh` beside the programs."""
    own = Path(sys.argv[0])
    if not own.name.startswith("cast_"):
        return "bash apps/install_raytracer.sh"
    script, here = own.resolve().with_name("install_raytracer.sh"), Path.cwd()
    return f"bash {os.path.relpath(script, here) if script.is_relative_to(here) else script}"
