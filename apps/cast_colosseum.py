#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Colosseum in a box: batch jobs and images checked, and played in containers, before anyone spends a reservation on them."""

import argparse
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import _program
from gr_cast.colosseum import box, build, check, host, image, job, play, session, storage, timeline, unpacked
from gr_cast.colosseum.emulator import Channel
from gr_cast.core import interrupts
from gr_cast.core.documents import listed, read_bytes
from gr_cast.core.errors import CastError
from gr_cast.core.files import check_writable, write_json, write_text
from gr_cast.core.programs import called
from gr_cast.sounding.result import output_folder

PROGRAM = Path(__file__).resolve().parent / "cast_emulator.py"
# A shell's word for it, in the place of LXC's; $0 is the container.
_IF_THERE = 'command -v "$1" > /dev/null || { echo "error: $1: no such command in $0" >&2; exit 127; }; exec "$@"'
_RANGES = {
    "srns": (1, job.MAX_SRNS, "SRNs"),
    "time_scale": (1, 1e4, ""),
    "base_loss": (0, 200, "dB"),
    "noise_power_db": (-400, 400, "dB"),
    "rate": (1e4, 1e9, "samples/s"),
    "seed": (0, 2**64 - 1, ""),
}


def _storage(args, path: Path) -> storage.Storage:
    return storage.storage_of(path, args.team)


def _team(args) -> storage.Storage:
    """The storage that --team names, else the current folder where it is one."""
    here = Path.cwd()
    if args.team is None and not any((here / part).is_dir() for part in ("batch", "config", "images")):
        raise CastError(f"--team: not given, and {here} is no team's storage, which has batch, config and images")
    return storage.storage_of(here, args.team or here)


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


def _channel(args) -> Channel:
    return Channel(rate_hz=args.rate, base_loss_db=args.base_loss, noise_power_db=args.noise_power_db, seed=args.seed)


def _check_name(name: str | None) -> None:
    if name is not None and (not re.fullmatch(r"[A-Za-z0-9-]{1,24}", name) or name == "images"):
        raise CastError(f"--name: got {name!r}, needs letters, digits and dashes, at most 24")


def up(args) -> int:
    """Start standard radio nodes as containers on the channel emulator, with the interactive command line in each."""
    _check_name(args.name)
    host.check_host()
    here = _team(args)
    images = here.images()
    if args.image not in images:
        raise CastError(f"--image: got {args.image!r}, needs an image of the team or a common one: {', '.join(images) or 'none'}")
    numbers = storage.rf_scenarios()
    if args.scenario is not None and args.scenario not in numbers:
        raise CastError(f"--scenario: got {args.scenario}, needs one of {', '.join(map(str, sorted(numbers)))}")
    config = read_bytes(args.config, limit=job.MAX_CONFIG) if args.config else None
    asked = _request(args, here, images[args.image])
    if folder := box.boxes().get(args.name):
        return _told_again(args.name, folder, asked)
    if not args.foreground:
        return _up_behind(args)
    srns = [box.Srn(number=number, image=images[args.image]) for number in range(1, args.srns + 1)]
    ended = threading.Event()
    with interrupts.heeded(ended.set), box.Box(args.name, here, srns, _channel(args), PROGRAM, interactive=True) as made:
        kept = session.Session(made, args.time_scale, config=config, request=asked, say=lambda line: print(line, flush=True))
        if args.scenario is not None:
            kept.begin(args.scenario)
        kept.run(ended)
    return 0


def _request(args, here: storage.Storage, path: Path) -> dict:
    """What `up` is asked for, as a box remembers it: option → value."""
    told = {"srns": args.srns, "scenario": args.scenario, "image": str(path.resolve()), "team": str(here.folder.resolve())}
    told |= {"config": args.config and str(args.config.resolve())}
    channel = {"rate": args.rate, "base-loss": args.base_loss, "noise-power-db": args.noise_power_db, "seed": args.seed}
    return told | channel | {"time-scale": args.time_scale}


def _told_again(name: str, folder: Path, asked: dict) -> int:
    """What is said of a box that is there: that it is up as asked for, or why it cannot be."""
    state = box.state_of(folder)
    if not box.is_held(folder):
        raise CastError(f"{name}: {_killed(name)}")
    if not state.get("ready"):
        raise CastError(f"{name}: is in use: end it by `{called('cast_colosseum')} down {name}`, or give another --name")
    there = state.get("request", {})
    told = [(key, *("none" if one is None else one for one in (there.get(key), asked[key]))) for key in asked]
    apart = ", ".join(f"--{key} {has} (got {wants})" for key, has, wants in told if has != wants)
    if apart:
        end = f"{called('cast_colosseum')} down {name}"
        raise CastError(f"{name}: is up already, with {apart}: end it by `{end}`, or give another --name")
    print(f"{name}: was already up: {', '.join(state['srns'])}")
    return 0


def _up_behind(args) -> int:
    """The same in a process of its own, until all of it stands."""
    name = args.name or box.free_name()
    words = [sys.executable, __file__, "up", *sys.argv[2:], "--foreground", *([] if args.name else ["--name", name])]
    log = host.boxes_folder() / f".{name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "wb") as out:
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True)
    try:
        while not ((state := box.state_of(host.boxes_folder() / name)).get("ready") and state["pid"] == process.pid):
            if process.poll() is not None:
                lines = log.read_text(errors="replace").strip().splitlines()
                raise CastError(*(line.removeprefix("error: ") for line in lines[-20:]))
            time.sleep(0.1)
    finally:
        log.unlink(missing_ok=True)
    print(f"{name}: {', '.join(state['srns'])}")
    print(
        f"a shell in one: {called('cast_colosseum')} enter {name} {state['srns'][0]}; end: {called('cast_colosseum')} down {name}"
    )
    return 0


def enter(args) -> int:
    """Run a command, or a shell, in a container of a box."""
    folder = box.boxes().get(args.box)
    if folder is None:
        raise CastError(_no_such(args.box))
    if not box.is_held(folder):
        raise CastError(f"{args.box}: {_killed(args.box)}")
    names = box.state_of(folder).get("srns")
    if not names:
        raise CastError(f"{args.box}: {_told_of(args.box, folder)}: it has no container that could be entered yet")
    if args.srn not in names:
        raise CastError(f"{args.box}: got {args.srn or 'no container'}, needs one of {', '.join(names)}")
    inside = box.container_of(folder, args.srn)
    inside.pid()  # names one that has ended
    words = args.words or ["/bin/sh"]
    return subprocess.run(inside.words("/bin/sh", "-c", _IF_THERE, args.srn, *words), check=False).returncode


def down(args) -> int:
    """End boxes and remove all that is left of them, also after a runner was killed, and unpacked images once no box is there;
    what no box started is never touched."""
    host.check_host()
    found = box.boxes()
    unknown = [name for name in args.box if name not in found]
    if unknown:
        raise CastError(*map(_no_such, unknown))
    chosen = args.box or [name for name, folder in found.items() if args.all or not box.is_held(folder)]
    for name in chosen:
        left = box.remove(name, found[name])
        print(f"{name}: " + (f"removed {', '.join(left)}" if left else "ended"))
    for name in found:
        if name not in chosen and not args.box:
            print(f"{name}: is in use; `down {name}` ends it")
    if not box.boxes():
        number, size = unpacked.remove_unused(box.images_folder())
        if number or not chosen:
            print(f"no box is left; unpacked images: {number} removed, {size / 1e6:.1f} MB")
    return 0


def list_boxes(args) -> int:
    """The boxes of this machine, what they are, and what unpacked images take."""
    for name, folder in box.boxes().items():
        print(f"{name:24s} {_told_of(name, folder)}")
    if not box.boxes():
        print("no box is up")
    if kept := unpacked.kept(box.images_folder()):
        size = unpacked.used_bytes(*kept) / 1e6
        print(f"unpacked images: {len(kept)}, {size:.1f} MB in {box.images_folder()}: `down` removes them once no box is up")
    return 0


def _told_of(name: str, folder: Path) -> str:
    state = box.state_of(folder)
    if not box.is_held(folder):
        return _killed(name)
    if not state.get("ready"):
        return "starts, or plays a job"
    asked = state["request"]
    what = f"scenario {asked['scenario']}" if asked.get("scenario") is not None else "no scenario at its beginning"
    return f"up: {', '.join(state['srns'])}; {Path(asked['image']).name}, {what}"


def _no_such(name: str) -> str:
    return f"{name}: no such box on this machine, which has {listed(box.boxes())}"


def _killed(name: str) -> str:
    return f"its runner was killed: `{called('cast_colosseum')} down {name}` removes what is left of it"


def run(args) -> int:
    """Play a batch job by the documented timeline, and write one report of it; all containers are gone afterwards."""
    _check_name(args.name)
    host.check_host()  # before anything looks for a user's catalogue
    from gr_cast.report.colosseum_page import page

    here = _storage(args, args.job)
    taken = job.read(args.job, here)
    check_writable(args.output)
    clock = timeline.Clock(profile=timeline.PROFILES[args.profile], scale=args.time_scale, duration_s=taken.duration_s)
    scenario = play.sc.load(str(taken.rf_scenario))
    changes = play.changes_of(taken, clock.run_s, scenario, _channel(args), args.updates)
    warned = [fault for path in dict.fromkeys(node.image_path for node in taken.nodes) for fault in _image_faults(path)]
    for fault in warned:
        print(f"warning: {fault}", file=sys.stderr)
    status = 0
    for number in range(1, taken.loops + 1):
        folder = output_folder(args.output / f"loop{number}" if taken.loops > 1 else args.output)
        player = play.Player(
            taken, here, clock, _channel(args), PROGRAM, folder, changes=changes, name=args.name,
            say=lambda line: print(line, flush=True),
        )  # fmt: skip
        document = player.run()
        document["images"] = warned
        write_json(folder / "report.json", document)
        write_text(folder / "report.html", page(document))
        for fault in document["faults"]:
            print(f"fault: {fault}", file=sys.stderr)
        told = f"{document['outcome']} in {document['seconds']:.0f} s, {len(document['faults'])} faults"
        print(f"{told}: {folder}/report.html, report.json")
        if document["outcome"] == "interrupted":
            raise KeyboardInterrupt
        status = max(status, 1 if document["faults"] else 0)
    return status


def image_list(args) -> int:
    """The images that a job may name."""
    here = _team(args)
    images = here.images()
    if not images:
        print(
            f"none yet: {called('cast_colosseum')} image build {here.image_folders[0] / 'cast.tar.gz'} makes the CaST container"
        )
    for name, path in sorted(images.items()):
        print(f"{name:31s} {path.stat().st_size / 1e6:9.1f} MB  {path}")
    return 0


def image_build(args) -> int:
    """Build the CaST container: sounder, its radio API, the path-loss map; the same packages and sources give the same hash."""
    if storage.split_suffix(args.image.name)[1] != ".tar.gz":
        raise CastError(f"{args.image}: needs the suffix .tar.gz")
    check_writable(args.image.parent)
    args.image.parent.mkdir(parents=True, exist_ok=True)
    digest = build.build(args.image, say=lambda line: print(line, file=sys.stderr))
    print(f"{args.image}: {args.image.stat().st_size / 1e6:.1f} MB, sha256 {digest}")
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

    def with_team(added, usual="TEAM of TEAM/batch/JOB.json"):
        added.add_argument(
            "--team", type=Path, metavar="DIR",
            help=f"the team's storage: batch, config, images, and ../common (default: {usual})",
        )  # fmt: skip
        return added

    added = with_team(command(validate))
    added.add_argument("job", type=Path, metavar="JOB.json")

    def with_channel(added):
        added.add_argument("--rate", type=_program.rate, default=1e6, metavar="HZ", help="samples/s of every radio (default 1e6)")
        added.add_argument(
            "--base-loss", type=float, default=Channel.base_loss_db, metavar="DB", help="of every link (default 57.55)"
        )
        added.add_argument(
            "--noise-power-db", type=float, default=Channel.noise_power_db, metavar="DB", help="of every receiver (default -100)"
        )
        added.add_argument("--seed", type=int, default=0, help="of the receivers' noise")
        added.add_argument("--name", help="of the box; without it one that is free")
        added.add_argument(
            "--time-scale", type=float, default=1.0, metavar="X", help="waits are so many times shorter (default 1)"
        )
        return added

    added = with_channel(with_team(command(run)))
    added.add_argument("job", type=Path, metavar="JOB.json")
    added.add_argument("--output", type=Path, required=True, metavar="DIR", help="for /logs of every node and the report")
    added.add_argument(
        "--profile",
        choices=list(timeline.PROFILES),
        default="current",
        help="READY at 5:00 and start at 8:00, or the older 10:00 and 13:00",
    )
    added.add_argument("--updates", type=Path, metavar="FILE", help="mandated outcomes and environments that come during the job")

    added = with_channel(with_team(command(up), usual="the current folder"))
    added.add_argument("--srns", type=int, required=True, metavar="N")
    added.add_argument("--scenario", type=int, metavar="ID", help="started at once; without it nothing passes until rf start")
    added.add_argument("--image", default="cast", metavar="NAME", help="of every SRN (default cast)")
    added.add_argument("--config", type=Path, metavar="FILE", help="radio.conf of every container, as ModemConfig of a job")
    added.add_argument("--foreground", action="store_true", help="until Ctrl-C")

    command(list_boxes, name="list")

    added = command(enter)
    added.add_argument("box")
    added.add_argument("srn", nargs="?", metavar="TEAM-srnXXX")
    added.add_argument("words", nargs=argparse.REMAINDER, metavar="COMMAND", help="default: a shell")

    added = command(down)
    added.add_argument("box", nargs="*", help="without one: all whose runner is gone")
    added.add_argument("--all", action="store_true", help="those in use too")

    images = commands.add_parser("image", help="images of containers", description="Images of containers.")
    images = images.add_subparsers(required=True, metavar="COMMAND")
    with_team(command(image_list, among=images, name="list"), usual="the current folder")
    added = command(image_build, among=images, name="build")
    added.add_argument("image", type=Path, metavar="IMAGE.tar.gz", help="such as TEAM/images/cast.tar.gz")
    added = command(image_check, among=images, name="check")
    added.add_argument("image", type=Path, nargs="+", metavar="IMAGE.tar.gz")

    args = _program.parse(parser, argv)
    _program.check_ranges(args, _RANGES)
    return args.function(args)


if __name__ == "__main__":
    _program.run(main)
