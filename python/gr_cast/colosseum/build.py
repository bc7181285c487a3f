# SPDX-License-Identifier: GPL-3.0-or-later
"""The CaST container, built from Debian's packages and this project's own files: the same of both gives the same hash."""

import gzip
import io
import json
import os
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

from ..core.errors import CastError
from ..core.files import digest_of, passing_folder, written_aside

SUITE = "bookworm"
PACKAGES = (
    "base-files", "dash", "coreutils", "python3", "python3-numpy", "python3-scipy", "python3-yaml", "python3-zmq", "python3-uhd",
    "python3-matplotlib", "iproute2",
)  # fmt: skip
_EPOCH = 1_700_000_000  # of every file
# Compilers, headers and documents that packages bring along, and what apt and dpkg leave behind.
_LEFT_OUT = re.compile(
    r"usr/(?:include|share/(?:doc|man|locale|info|lintian|unicode|javascript|icons|fonts/(?!truetype/dejavu)|bug)|lib/gcc|src)(?:/|$)"
    r"|usr/lib/\w+-linux-gnu/(?:openblas-pthread|gconv|cmake|pkgconfig|libicudata|lib[at]san|liblsan|libubsan|libgprofng|libctf)"
    r"|usr/lib/python3[\d.]*/(?:config-|test|idlelib|lib2to3|ensurepip)|usr/libexec/uhd|.*/tests?/|.*\.(?:a|pyc)$|.*/__pycache__"
    r"|usr/lib/python3/dist-packages/(?:pythran|gast|beniget|sympy)"
    r"|usr/bin/(?:\w+-linux-gnu-|gcc|g\+\+|cpp|c\+\+|gcov|lto-dump|uhd_|usrp|x86)"
    r"|var/(?:cache|lib/apt|lib/dpkg|log|tmp)/|etc/(?:machine-id|resolv\.conf|hostname|apt)|dev/|proc/|sys/|run/|tmp/"
)
_LIBRARIES = {
    "libblas.so.3": "blas/libblas.so.3",
    "liblapack.so.3": "lapack/liblapack.so.3",
}  # alternatives, which dpkg would set
_INIT = """#!/bin/sh
export PYTHONPATH=/opt/cast PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 MPLCONFIGDIR=/tmp HOME=/root
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
python3 -m gr_cast.colosseum.sounder >> /logs/sounder.log 2>&1 &
trap 'exit 0' TERM PWR
while :; do sleep 3600 & wait $!; done
"""
_STATE = '{"STATUS": "BOOTING", "INFO": "loads"}\n'


def build(path: Path, say=lambda line: None) -> str:
    """Write the image to `path`; its SHA-256. Raises CastError where Debian's tools or packages cannot be had."""
    if shutil.which("mmdebstrap") is None:
        raise CastError("image: mmdebstrap: not installed (Debian: apt install mmdebstrap)")
    if os.geteuid() != 0:
        raise CastError("image: got no root: its files belong to root (sudo)")
    with passing_folder() as folder:
        system, names = folder / "system.tar", folder / "packages"
        say(f"Debian {SUITE}: {', '.join(PACKAGES)}")
        _debian(system, names)
        packages = sorted(_named(name) for name in names.read_text().split())
        say(f"{len(packages)} packages; writing {path}")
        with written_aside(path) as aside:
            _write(aside, system, packages)
    return digest_of(path)


def _debian(system: Path, names: Path) -> None:
    """Debian's packages extracted into a tarball, and the names of their files."""
    words = [
        "mmdebstrap", "--variant=extract", "--mode=root", f"--include={','.join(PACKAGES)}",
        "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr", "--aptopt=Apt::Install-Recommends false",
        f'--extract-hook=ls "$1/var/cache/apt/archives" > {names}', SUITE, str(system),
    ]  # fmt: skip
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(_EPOCH), "PATH": os.environ.get("PATH", "") + ":/usr/sbin:/sbin"}
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
    )
    try:
        told = process.communicate()[1]
    except BaseException:  # asked to end, it tidies up
        process.terminate()
        process.communicate()
        raise
    if process.returncode:
        lines = [line for line in told.splitlines() if line.startswith("E:") or "rr:" in line]
        raise CastError(*(f"image: mmdebstrap: {line[:300]}" for line in lines[:3] or [told.strip()[-300:]]))


def _named(file: str) -> str:
    """`package version` of a package's file."""
    return " ".join(file.removesuffix(".deb").split("_")[:2]).replace("%3a", ":")


def _own_files() -> dict[str, tuple[bytes, int]]:
    """What this project puts into the image: place to bytes and mode."""
    package = Path(__file__).resolve().parents[1]
    files = {
        f"opt/cast/gr_cast/{path.relative_to(package)}": (path.read_bytes(), 0o644)
        for path in sorted(package.rglob("*"))
        if path.suffix in (".py", ".yaml", ".json", ".html") and "__pycache__" not in path.parts
    }
    for path in sorted((package / "colosseum/sounder/radio_api").glob("*.sh")):
        files[f"root/radio_api/{path.name}"] = (path.read_bytes(), 0o755)
    return files | {"sbin/init": (_INIT.encode(), 0o755), "root/cast/state": (_STATE.encode(), 0o644)}


def _write(path: Path, system: Path, packages: list[str]) -> None:
    """Metadata and `rootfs/` as LXC and LXD take them; every name in order, every time the same."""
    metadata = {
        "architecture": "x86_64", "creation_date": _EPOCH,
        "properties": {"description": "CaST: sounder and path-loss map", "os": "debian", "release": SUITE},
    }  # fmt: skip
    software = json.dumps({"suite": SUITE, "packages": packages}, indent=1) + "\n"
    with (
        open(path, "wb") as file,
        gzip.GzipFile(filename="", mode="wb", fileobj=file, compresslevel=6, mtime=_EPOCH) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as tar,
        tarfile.open(system) as debian,
    ):
        _add(tar, "metadata.yaml", json.dumps(metadata, indent=1).encode() + b"\n", 0o644)  # JSON is YAML
        own = _own_files() | {"etc/cast-image.json": (software.encode(), 0o644)}
        own = {name.replace("sbin/", "usr/sbin/", 1) if name.startswith("sbin/") else name: entry for name, entry in own.items()}
        library = ""
        for member in sorted(debian.getmembers(), key=lambda member: member.name):
            name = member.name.removeprefix("./").removeprefix(".")
            if _LEFT_OUT.match(name) or name in own or not (member.isreg() or member.isdir() or member.issym() or member.islnk()):
                continue
            library = os.path.dirname(os.path.dirname(name)) if name.endswith("/blas/libblas.so.3") else library
            content = debian.extractfile(member) if member.isreg() else None
            if member.islnk():
                member.linkname = "rootfs/" + member.linkname.removeprefix("./")
            member.name = f"rootfs/{name}".rstrip("/")
            member.mtime, member.uname, member.gname, member.pax_headers = _EPOCH, "", "", {}
            tar.addfile(member, content)
        for name, target in _LIBRARIES.items():
            link = tarfile.TarInfo(f"rootfs/{library}/{name}")
            link.type, link.linkname, link.mtime = tarfile.SYMTYPE, target, _EPOCH
            tar.addfile(link)
        for name, (data, mode) in sorted(own.items()):
            _add(tar, f"rootfs/{name}", data, mode)


def _add(tar: tarfile.TarFile, name: str, data: bytes, mode: int) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode, member.mtime = len(data), mode, _EPOCH
    tar.addfile(member, io.BytesIO(data))
