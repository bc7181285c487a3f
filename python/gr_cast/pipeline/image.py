# SPDX-License-Identifier: GPL-3.0-or-later
"""From a commit to an image: a tarball that is the same, to the last bit, whenever the same inputs are built again."""

import shutil
import subprocess
import tarfile
from pathlib import Path

from .. import __version__
from ..core.errors import CastError, Faults
from ..core.files import digest_of, passing_folder, write_json, written_aside
from .clean import Outcome, Room
from .document import Environment, Pipeline
from .patience import Stopped
from .source import Source
from .stages import Storage

STACK = "stack"  # the folder of a room that holds the tree or the unpacked image


def software(environment: Environment, root: Path = Path("/")) -> dict[str, str]:
    """Version of every package that the pipeline asks for, and of the compiler, in a root file system. Raises CastError with all
    that is missing."""
    faults, found = Faults("environment"), {}
    within = [] if root == Path("/") else ["chroot", str(root)]
    for name in environment.packages:
        found[name] = _printed([*within, "dpkg-query", "-W", "-f", "${Version}", name])
        if not found[name]:
            faults.add("packages", f"{name} is not installed: apt-get install {name}")
    found[environment.compiler] = _printed([*within, environment.compiler, "--version"]).partition("\n")[0]
    if not found[environment.compiler]:
        faults.add("compiler", f"{environment.compiler} is not installed")
    if (told := _system(root)) != environment.system:
        faults.add("system", f"got {told}, needs {environment.system}")
    faults.raise_if_any()
    return found


def _printed(words: list[str]) -> str:
    """What a command prints; nothing where it fails or is not there."""
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return "" if done.returncode else done.stdout.strip()


def _system(root: Path) -> str:
    """ID-VERSION of a root file system, such as debian-12."""
    try:
        lines = (root / "etc/os-release").read_text(encoding="utf-8").splitlines()
    except OSError:
        return "unknown"
    told = dict(line.split("=", 1) for line in lines if "=" in line)
    return "-".join(told.get(key, "").strip('"') for key in ("ID", "VERSION_ID")).strip("-") or "unknown"


def built(storage: Storage, source: Source, commit: str, pipeline: Pipeline, room: Room) -> dict:
    """The image of a commit and how its build and tests ended: as the stage of this tree and recipe keeps it."""
    tools = software(pipeline.environment, room.root or Path("/"))
    inputs = {"tree": source.tree(commit), "recipe": pipeline.recipe, "test": pipeline.test, "software": tools, "room": room.kind}

    def work(folder: Path) -> dict:
        with passing_folder() as place:
            return _build(storage, source, commit, pipeline, room, tools, place)

    try:
        return storage.stage("image", inputs, work)[0]
    except Stopped as error:
        return {"image": None, "fails": " ".join(error.faults), "stopped": True, "software": tools, "room": room.kind}


def _build(storage, source, commit, pipeline, room, tools, folder: Path) -> dict:
    source.check_out(commit, folder / STACK)
    # One date for one tree: the image depends on what is in a commit, not on when it was made.
    environment = {"SOURCE_DATE_EPOCH": "0", "CAST_STACK": pipeline.name}
    result = {"image": None, "fails": None, "software": tools, "room": room.kind}
    fails, log = _through(room, folder, pipeline.build, "build", environment, pipeline.limits.build_s)
    if fails:
        return result | {"fails": fails, "log": log}
    result["image"] = _packed(storage, pipeline, folder / STACK)
    provenance = {
        "cast_image": 1,
        "image": result["image"],
        "made_by": f"gr-cast {__version__}",
        "repository": source.address,
        "commit": commit,
        "tree": source.tree(commit),
        "recipe": pipeline.recipe,
        "software": tools,
        "room": room.kind,
    }
    about = storage.folder / "images" / f"{result['image']}.json"
    if not about.exists():  # who built it first
        write_json(about, provenance)
    fails, test_log = _through(room, folder, pipeline.test, "test", environment, pipeline.limits.build_s)
    return result | {"fails": fails, "log": log + test_log}


def _through(room: Room, folder: Path, commands, what: str, environment, limit_s: float) -> tuple[str | None, str]:
    """(what failed, all that was printed) of commands one after the other. Raises Stopped where one had its time."""
    printed = ""
    for command in commands:
        done: Outcome = room.run(folder, command, within=STACK, environment=environment, timeout_s=limit_s)
        printed += f"$ {command}\n{done.log}"
        if done.status is None:
            raise Stopped(f"{what}: {command}: {done.stopped_after(limit_s)}", "build_s")
        if done.status != 0:
            return f"{what}: {command}: status {done.status}: {done.last_line}", printed
    return None, printed


def _packed(storage: Storage, pipeline: Pipeline, tree: Path) -> str:
    """The hash of the image of a built tree, which lies in the storage from then on."""
    parts = [tree / name for name in pipeline.image] or [tree]
    missing = [name for name, part in zip(pipeline.image, parts, strict=False) if not part.exists()]
    if missing:
        raise CastError(*(f"image: {name}: the build has not made it" for name in missing))
    files = sorted({path for part in parts for path in ([part, *part.rglob("*")] if part.is_dir() else [part])} - {tree})
    new = tree.with_name("image.tar")
    with tarfile.open(new, "w", format=tarfile.PAX_FORMAT) as tar:
        for path in files:
            tar.add(path, arcname=str(path.relative_to(tree)), recursive=False, filter=_plain)
    digest = digest_of(new)
    with written_aside(storage.folder / "images" / f"{digest}.tar") as aside:
        shutil.move(new, aside)
    return digest


def _plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """Without date, owner and all of the mode but whether it runs."""
    entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = 0, 0, 0, "root", "root"
    entry.mode = 0o755 if entry.isdir() or entry.mode & 0o100 else 0o644
    return entry


def unpacked(storage: Storage, digest: str, folder: Path) -> None:
    """Deploy an image into a new folder, once its hash is right."""
    path = storage.folder / "images" / f"{digest}.tar"
    if not path.is_file() or digest_of(path) != digest:
        raise CastError(f"{path}: is missing or changed: its SHA-256 is not its name")
    folder.mkdir(parents=True)
    subprocess.run(["tar", "-x", "-C", folder, "-f", path], check=True)
