# SPDX-License-Identifier: GPL-3.0-or-later
"""A team's storage in a folder: images made of scripts, configurations, jobs."""

import functools
import io
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

RADIO_API = "/root/radio_api"
SCRIPTS = ("start.sh", "stop.sh", "status.sh", "update_environment.sh", "update_outcomes.sh", "scenario_discontinuity.sh")
GOOD = {
    "start.sh": "#!/bin/sh\necho ACTIVE > /tmp/state\n",
    "stop.sh": "#!/bin/sh\necho FINISHED > /tmp/state\n",
    "status.sh": '#!/bin/sh\nread STATE < /tmp/state\necho "{\\"STATUS\\": \\"${STATE:-READY}\\", \\"INFO\\": \\"\\"}"\n',
    "update_environment.sh": "#!/bin/sh\nexit 0\n",
    "update_outcomes.sh": "#!/bin/sh\nexit 0\n",
    "scenario_discontinuity.sh": "#!/bin/sh\nexit 0\n",
}


METADATA = b"architecture: x86_64\ncreation_date: 1700000000\n"


def _add_metadata(tar: tarfile.TarFile) -> None:
    member = tarfile.TarInfo("metadata.yaml")
    member.size = len(METADATA)
    tar.addfile(member, io.BytesIO(METADATA))


def write_image(path: Path, files: dict[str, str | bytes], modes: dict[str, int] | None = None) -> Path:
    """An LXC image of these files; a shell that is none stands at /bin/sh where the files hold none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w:gz") as tar:
        _add_metadata(tar)
        for name, content in ({"/bin/sh": b"\x7fELF\0", "/usr/bin/python3": b"\x7fELF\0"} | files).items():
            data = content.encode() if isinstance(content, str) else content
            member = tarfile.TarInfo(f"rootfs{name}")
            member.size, member.mode = len(data), (modes or {}).get(name, 0o755)
            tar.addfile(member, io.BytesIO(data))
    return path


def radio_api(**changed) -> dict[str, str]:
    """The good scripts with some replaced (start="…"); None leaves one out."""
    scripts = GOOD | {f"{name}.sh": text for name, text in changed.items()}
    return {f"{RADIO_API}/{name}": text for name, text in scripts.items() if text is not None}


def job_document(srns: int = 3, image: str = "good") -> dict:
    return {
        "BatchName": "a job", "Duration": 60, "RFScenario": 90003, "TrafficScenario": 2,
        "NodeData": [
            {"RFNode_ID": n, "ImageName": image, "ModemConfig": "radio.conf", "isGateway": n == 1, "TrafficNode_ID": n,
             "node_type": "competitor"}
            for n in range(1, srns + 1)
        ],
    }  # fmt: skip


def make(folder: Path) -> Path:
    """TEAM's folder with a good image, a configuration and a job."""
    team = folder / "team"
    for name in ("batch", "config", "images"):
        (team / name).mkdir(parents=True)
    (team / "config" / "radio.conf").write_text("{}\n")
    write_image(team / "images" / "good.tar.gz", radio_api())
    (team / "batch" / "job.json").write_text(json.dumps(job_document()))
    return team


PROGRAMS = ("dash", "cat", "sleep", "mkdir", "mv", "cp", "ls", "date", "head", "ip", "pkill")


def _libraries(*paths: Path | str) -> dict[str, bytes]:
    """What these programs and libraries of this machine are linked with."""
    listed = "".join(subprocess.run(["ldd", path], capture_output=True, text=True, check=True).stdout for path in paths)
    return {f"/usr/{lib.removeprefix('/usr/').lstrip('/')}": Path(lib).read_bytes() for lib in set(re.findall(r"(/\S+)", listed))}


@functools.cache
def _programs() -> dict[str, bytes]:
    """A few of this machine's programs: enough of a system for a container."""
    paths = {name: shutil.which(name) for name in PROGRAMS}
    files = {f"/usr/bin/{name}": Path(path).read_bytes() for name, path in paths.items()}
    return files | _libraries(*paths.values()) | {"/usr/bin/sh": files["/usr/bin/dash"]}


def python() -> dict[str, bytes]:
    """The Python that runs this, with its standard library, as /usr/bin/python3."""
    place, program = Path(sysconfig.get_path("stdlib")), os.path.realpath(sys.executable)
    left_out = {"__pycache__", "dist-packages", "site-packages", "test", "idlelib", "lib2to3", "ensurepip", "tkinter"}
    files = [path for path in place.rglob("*.*") if path.suffix in (".py", ".so") and not left_out & set(path.parts)]
    linked = _libraries(program, *(path for path in files if path.suffix == ".so"))
    return {str(path): path.read_bytes() for path in files} | linked | {"/usr/bin/python3": Path(program).read_bytes()}


def write_system(path: Path, files: dict[str, str | bytes]) -> Path:
    """An image that boots: the programs above and these files."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w") as tar:
        _add_metadata(tar)
        for name, target in (("bin", "usr/bin"), ("sbin", "usr/bin"), ("lib", "usr/lib"), ("lib64", "usr/lib64")):
            member = tarfile.TarInfo(f"rootfs/{name}")
            member.type, member.linkname = tarfile.SYMTYPE, target
            tar.addfile(member)
        for name, content in (_programs() | files).items():
            data = content.encode() if isinstance(content, str) else content
            member = tarfile.TarInfo(f"rootfs{name}")
            member.size, member.mode = len(data), 0o755
            tar.addfile(member, io.BytesIO(data))
    return path
