# SPDX-License-Identifier: GPL-3.0-or-later
"""A box: SRNs as containers, their networks, their radios on one channel emulator. It ends with the process that holds it."""

import os
import secrets
import signal
import subprocess
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ..core import interrupts
from ..core.documents import json_file
from ..core.errors import CastError
from ..core.files import sweep_dead, write_json
from ..experiments.traffic.namespaces import Namespace
from . import host
from .container import Container, Wire, configuration, hardware_address
from .emulator import Channel, Emulator
from .storage import Storage
from .unpacked import held, unpacked

_COLLABORATION = "col"  # the bridge, in the box's own namespace
SERVER = "172.30.100.254"
STATE_FILE = "box.json"
_PATIENCE_S = 30.0
RADIO_ARGUMENTS = "driver=zmq,tx_port=ipc:///radio/tx,rx_port=ipc:///radio/rx,base_srate={rate_hz:.10g}"


@dataclass(frozen=True, kw_only=True)
class Srn:
    """What an SRN runs, and whether it has the collaboration network."""

    number: int
    image: Path
    is_gateway: bool = True

    @property
    def tag(self) -> str:
        return f"srn{self.number:03d}"

    @property
    def traffic_address(self) -> str:
        """Of tr0; sources and sinks lie behind it."""
        return f"192.168.{100 + self.number}.1"

    @property
    def collaboration_address(self) -> str:
        return f"172.30.100.{self.number}"


def colosseum_config(channel: Channel, center_frequency_hz: float) -> bytes:
    """colosseum_config.ini: the documented keys, and beside them where the radio is: in a box a socket, on Colosseum a USRP."""
    return (
        f"[RF]\ncenter_frequency = {round(center_frequency_hz)}\nrf_bandwidth = {round(channel.rate_hz)}\n\n"
        f"[COLLABORATION]\ncollab_server_ip = {SERVER}\ncollab_server_port = 5556\ncollab_client_port = 5557\n"
        f"collab_peer_port = 5558\n\n[RADIO]\ndevice_args = {RADIO_ARGUMENTS.format(rate_hz=channel.rate_hz)}\n"
    ).encode()


class Box:
    """Containers TEAM-srnXXX, named and numbered from 1. Leaving the context removes all of it."""

    def __init__(
        self, name: str | None, storage: Storage, srns: list[Srn], channel: Channel, program: Path, *, interactive: bool
    ):
        host.check_host()
        self.storage, self.srns, self.channel, self.program = storage, {srn.number: srn for srn in srns}, channel, program
        self.interactive = interactive
        self.name, self.folder = _claimed(name)
        self._stack = ExitStack()
        self._stack.callback(host.sweep, self.folder, self.name)
        self.containers: dict[int, Container] = {}
        self.ends: dict[int, Namespace] = {}
        self.emulator: Emulator | None = None

    def place(self, number: int, *parts: str) -> Path:
        return self.folder.joinpath(self.srns[number].tag, *parts)

    def host_name(self, number: int) -> str:
        return f"{self.storage.team}-{self.srns[number].tag}"

    def __enter__(self):
        try:
            os.environ[host.MARK] = str(self.folder)
            self._stack.callback(os.environ.pop, host.MARK, None)
            self._up()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        with interrupts.held_back():
            self._stack.close()

    def _up(self) -> None:
        cache = images_folder()
        self._stack.enter_context(held(cache))
        roots = {path: unpacked(path, cache) for path in {srn.image for srn in self.srns.values()}}
        for number in self.srns:
            for part in ("logs", "radio", "upper", "socket", "calls"):
                self.place(number, part).mkdir(parents=True)
        radios = {number: self.place(number, "radio") for number in self.srns}
        self.emulator = Emulator(self.program, self.folder / "emulator", radios, self.channel)
        self._stack.callback(self.emulator.stop)
        self._network = Namespace("box", "")
        self._stack.callback(self._network.close)
        self._network.run("ip", "link", "add", _COLLABORATION, "type", "bridge")
        self._network.run("ip", "address", "add", f"{SERVER}/24", "dev", _COLLABORATION)
        self._network.run("ip", "link", "set", _COLLABORATION, "up")
        for number, srn in self.srns.items():
            self._start(number, srn, roots[srn.image])
        for container in self.containers.values():
            container.wait_until_running()
        for number in self.srns:
            self._join(number)
        self.emulator.wait_until_ready()

    def _start(self, number: int, srn: Srn, root: Path) -> None:
        lxc, name = self.folder / "lxc", self.host_name(number)
        wires = [Wire(name="tr0", pair=f"tr{number}", address=srn.traffic_address)]
        if srn.is_gateway:
            wires.append(Wire(name="col0", pair=f"col{number}", address=srn.collaboration_address))
        mounts = {"/logs": self.place(number, "logs"), "/radio": self.place(number, "radio")}
        if self.interactive:
            share = self.storage.folder.resolve()
            mounts |= {"/socket": self.place(number, "socket"), f"/share/nas/{self.storage.team}": share}
        (lxc / name).mkdir(parents=True)
        self.place(number, "upper", "etc").mkdir(mode=0o755)
        self.place(number, "upper", "etc", "hostname").write_text(f"{name}\n")  # systemd would take the image's
        group = f"{host.group_of(self.folder)}/{srn.tag}"
        text = configuration(name=name, root=root, folder=self.place(number), wires=wires, mounts=mounts, group=group)
        (lxc / name / "config").write_text(text)
        self.containers[number] = Container(name, lxc, self._network.command)
        self._stack.callback(self.containers[number].stop)
        self.containers[number].start()

    def _join(self, number: int) -> None:
        """The other end of col0 joins the bridge, that of tr0 a network of its own with sources and sinks of traffic; both
        ends know each other by ARP."""
        srn = self.srns[number]
        end = Namespace(srn.tag, _beside(srn.traffic_address))
        self._stack.callback(end.close)
        self.ends[number] = end
        if srn.is_gateway:  # LXC would look for the bridge in the network that /sys was mounted in
            self._network.run("ip", "link", "set", f"col{number}", "master", _COLLABORATION)
        self._network.run("ip", "link", "set", f"tr{number}", "netns", str(end.pid))
        end.run("ip", "link", "set", f"tr{number}", "address", hardware_address(end.address))
        end.run("ip", "address", "add", f"{end.address}/24", "dev", f"tr{number}")
        end.run("ip", "link", "set", f"tr{number}", "up")
        end.run(
            "ip", "neigh", "replace", srn.traffic_address, "lladdr", hardware_address(srn.traffic_address), "dev", f"tr{number}"
        )
        end.run("ip", "route", "add", "default", "via", srn.traffic_address)
        network = srn.traffic_address.rpartition(".")[0]
        known = "".join(
            f"neigh replace {network}.{n} lladdr {hardware_address(f'{network}.{n}')} dev tr0 nud permanent\n"
            for n in range(2, 255)
        )
        self._in_network_of(number, known)

    def _in_network_of(self, number: int, batch: str) -> None:
        """Lines for `ip` in a container's network, by this machine's own `ip`: an image needs none."""
        pid = self.containers[number].pid()
        words = ["nsenter", f"--net=/proc/{pid}/ns/net", "ip", "-batch", "-"]
        done = subprocess.run(words, input=batch, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CastError(f"{self.host_name(number)}: ip: {done.stderr.strip()[-200:]}")

    def write_state(self, **more) -> None:
        state = {"name": self.name, "pid": os.getpid(), "started": host.started_at(os.getpid()), "team": self.storage.team,
                 "storage": str(self.storage.folder.resolve()),
                 "network": self._network.pid, "srns": [self.host_name(number) for number in self.srns], **more}  # fmt: skip
        write_json(self.folder / STATE_FILE, state)


def _beside(address: str) -> str:
    """The source and sink of an SRN's network."""
    return address.rpartition(".")[0] + ".2"


def _claimed(name: str | None) -> tuple[str, Path]:
    """A name that no other box has, and its folder, made here and now with this process as its owner."""
    folder = host.boxes_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o755)
    for candidate in (name,) if name else (free_name() for _ in range(20)):
        place = folder / candidate
        try:
            place.mkdir(mode=0o711)
        except FileExistsError:
            continue
        owner = {"name": candidate, "pid": os.getpid(), "started": host.started_at(os.getpid())}
        write_json(place / STATE_FILE, owner)
        return candidate, place
    raise CastError(f"box: {name}: there is one of that name: `down {name}` removes it, or give another --name")


def images_folder() -> Path:
    """Where images lie unpacked, for all boxes."""
    return host.boxes_folder() / "images"


def free_name() -> str:
    return f"box{secrets.token_hex(3)}"


def container_of(folder: Path, name: str) -> Container:
    """A container of a box that somebody else holds."""
    network = state_of(folder)["network"]
    return Container(name, folder / "lxc", lambda *inner: ["nsenter", f"--net=/proc/{network}/ns/net", *inner])


def state_of(folder: Path) -> dict:
    """What a box says of itself; {} where it was killed before it could."""
    try:
        return json_file(folder / STATE_FILE).document
    except CastError:
        return {}


def boxes() -> dict[str, Path]:
    """Every box on this machine, those that were killed too."""
    folder = host.boxes_folder()
    found = [path for path in sorted(folder.iterdir()) if path.is_dir()] if folder.is_dir() else []
    return {path.name: path for path in found if path.name != "images" and not path.name.startswith(".")}


def is_held(folder: Path) -> bool:
    """Whether the process that holds a box is still there."""
    state = state_of(folder)
    return bool(state) and host.started_at(state.get("pid", 0)) == state.get("started") != ""


def remove(name: str, folder: Path) -> list[str]:
    """End a box: ask the process that holds it, then remove what is left. What was found, in words."""
    state = state_of(folder)
    if is_held(folder):
        pid, started = state["pid"], state["started"]
        os.kill(pid, signal.SIGTERM)
        until_s = time.monotonic() + _PATIENCE_S
        while host.started_at(pid) == started and time.monotonic() < until_s:  # it removes box.json before it has ended
            time.sleep(0.05)
        if host.started_at(pid) == started:
            os.kill(pid, signal.SIGKILL)
    storage = state.get("storage")
    removed = host.sweep(folder, name)
    for aside in (images_folder(), *([Path(storage) / "images"] if storage else [])):
        sweep_dead(aside)  # images that were being unpacked, or taken of a container
    return removed
