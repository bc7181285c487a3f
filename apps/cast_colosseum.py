#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Colosseum in a box: batch jobs and images checked before anyone spends a reservation on them."""

import argparse
from pathlib import Path

import _program
from gr_cast.colosseum import check, image, job, storage
from gr_cast.core.errors import CastError


def _storage(args, path: Path) -> storage.Storage:
    return storage.storage_of(path, args.team)


def validate(args) -> int:
    """Check a batch job and the radio API of its images: every fault at once, and nothing is started."""
    here = _storage(args, args.job)
    faults = []
    names = ()
    try:
        played = job.read(args.job, here)
        names = tuple(dict.fromkeys(node.image for node in played.nodes))
    except CastError as error:
        faults += error.faults
        names = job.images_named(args.job)
    images = here.images()
    for name in names:
        if name in images:
            faults += _image_faults(images[name])
    if faults:
        raise CastError(*faults)
    print(f"{args.job}: {len(played.nodes)} SRNs, RF scenario {played.rf_scenario}, {played.duration_s} s: no fault")
    return 0


def _image_faults(path: Path) -> list[str]:
    try:
        return check.faults_of(path)
    except CastError as error:
        return list(error.faults)


def image_list(args) -> int:
    """The images that a job may name."""
    here = storage.storage_of(Path("x"), args.team or Path.cwd())
    for name, path in sorted(here.images().items()):
        print(f"{name:31s} {path.stat().st_size / 1e6:9.1f} MB  {path}")
    return 0


def image_check(args) -> int:
    """Check images without running them: their form, and their radio API."""
    faults = [fault for path in args.image for fault in _image_faults(path)]
    if faults:
        raise CastError(*faults)
    for path in args.image:
        print(f"{path}: {image.read(path).size / 1e6:.1f} MB unpacked, no fault")
    return 0


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(function, *, among=commands, name=None):
        added = among.add_parser(name or function.__name__, help=function.__doc__, description=function.__doc__)
        added.set_defaults(function=function)
        return added

    def with_team(added):
        added.add_argument(
            "--team", type=Path, metavar="DIR",
            help="the team's storage: batch, config, images, and ../common (default: TEAM of TEAM/batch/JOB.json)",
        )  # fmt: skip
        return added

    added = with_team(command(validate))
    added.add_argument("job", type=Path, metavar="JOB.json")

    images = commands.add_parser("image", help="images of containers", description="Images of containers.")
    images = images.add_subparsers(required=True, metavar="COMMAND")
    with_team(command(image_list, among=images, name="list"))
    added = command(image_check, among=images, name="check")
    added.add_argument("image", type=Path, nargs="+", metavar="IMAGE.tar.gz")

    args = _program.parse(parser, argv)
    return args.function(args)


if __name__ == "__main__":
    _program.run(main)
