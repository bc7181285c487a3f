# SPDX-License-Identifier: GPL-3.0-or-later
"""An interactive reservation: the command line's socket in every container, and what it asks for done in the box."""

import platform
import subprocess
import threading
import time
from pathlib import Path

from ..core.errors import CastError
from ..core.files import passing_folder, write_json, written_aside
from ..experiments.traffic import flows
from . import clisocket, desk, maps, traffic
from .box import Box, colosseum_config
from .image import METADATA, RADIO_API
from .storage import split_suffix
from .world import world_of

_LOOK_S = 0.1


class Session:
    """A box's desk, kept by `run(ended)` until the event is set; what goes wrong is said, and the session goes on."""

    def __init__(
        self,
        box: Box,
        time_scale: float = 1.0,
        *,
        config: bytes | None = None,
        request: dict | None = None,
        say=lambda line: None,
    ):
        self.box, self._say, self._scale, self._config, self._request = box, say, time_scale, config, request or {}
        self._world = world_of(box.storage, len(box.srns), time_scale)
        self._images = (box.storage.folder / "images").resolve()
        self._desk = desk.Desk(images=frozenset({*box.storage.images(), *_names_below(self._images)}))
        self._lock = threading.Lock()
        self._generators: traffic.Generators | None = None
        self._snapshots: list[threading.Thread] = []
        self._closing = threading.Event()
        self._runs = 0

    def begin(self, number: int) -> None:
        """Start a scenario as `rf start` would. Raises CastError."""
        request = {"version": desk.VERSION, "command": "rf_scenario_start", "scenario_id": number, "scenario_cycle": False}
        reply = self._answer(min(self.box.srns), request)
        if reply["status"] != desk.QUEUED:
            raise CastError(reply["message"])

    def run(self, ended: threading.Event) -> None:
        for container in self.box.containers.values():
            container.put(f"{RADIO_API}/colosseum_config.ini", colosseum_config(self.box.channel, 1e9))
            if self._config is not None:
                container.put(f"{RADIO_API}/radio.conf", self._config)
        paths = {number: self.box.place(number, "socket", "clisocket") for number in self.box.srns}
        with clisocket.Server(paths, self._answer):
            self.box.write_state(ready=True, request=self._request)
            try:
                while not ended.wait(_LOOK_S):
                    with self._lock:
                        self._desk, actions = desk.passed(self._world, self._desk, time.time(), self._played_s())
                        self._do(actions)
            finally:
                if self._generators:
                    self._generators.stop()
                self._closing.set()
                for thread in self._snapshots:
                    thread.join()

    def _played_s(self) -> float | None:
        """How much of the scenario the emulator has played; what a slow one has not played is not over."""
        rf = self._desk.rf
        if rf is None or rf.status != "ACTIVE" or self._world.rf[rf.number].length_s is None:
            return None
        return self.box.emulator.status()["scenario_time_s"]

    def _answer(self, srn, request) -> dict:
        with self._lock:
            self._desk, reply, actions = desk.answered(self._world, self._desk, request, srn, time.time())
            self._do(actions)
        return reply

    def _do(self, actions: tuple[desk.Action, ...]) -> None:
        for action in actions:
            try:
                self._act(action)
            except (CastError, OSError) as error:
                self._say(f"{action.what}: {error}")

    def _act(self, action: desk.Action) -> None:
        if action.what == "play":
            self.box.emulator.play(action.state.number, maps.node_of_srn(action.state.radio_map), action.state.cycle)
        elif action.what == "clear":
            self.box.emulator.clear()
        elif action.what == "begin_traffic":
            self._begin_traffic(action.state)
        elif action.what == "end_traffic" and self._generators:
            self._generators.stop()
            self._generators = None
        elif action.what == "snapshot":
            path = self._images / f"{action.name}.tar.gz"
            if not path.parent.resolve().is_relative_to(self._images):  # a link that a container has made
                raise CastError(f"{path}: leaves the team's images")
            thread = threading.Thread(target=self._snapshot, args=(action.srn, path), daemon=True)
            self._snapshots.append(thread)
            thread.start()

    def _begin_traffic(self, state: desk.TrafficState) -> None:
        path = self.box.storage.traffic()[state.number]
        if path is None:
            return
        if not traffic.is_installed():
            raise CastError("mgen: not installed (Debian: apt install mgen)")
        self._runs += 1
        ends = {node: self.box.ends[srn] for node, srn in state.node_map.items()}
        folder = self.box.folder / "traffic" / str(self._runs)
        self._generators = traffic.Generators(traffic.read(path, flows.read(path).duration_s), ends, folder, self._scale)

    def _snapshot(self, number: int, path: Path) -> None:
        try:
            snapshot(self.box.containers[number].pid(), path, self._closing)
            self._say(f"snapshot: {path}")
        except (CastError, OSError) as error:
            self._say(f"snapshot: {error}")


def _names_below(images: Path) -> set[str]:
    """Images in folders of the team's, as a snapshot names them."""
    return {name for path in images.rglob("*") for name, suffix in [split_suffix(str(path.relative_to(images)))] if suffix}


def snapshot(pid: int, path: Path, closing: threading.Event) -> None:
    """A running container's own files as an image, or none once `closing` is set; what is mounted into it stays out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with passing_folder() as folder, written_aside(path) as aside:
        write_json(folder / METADATA, {"architecture": platform.machine(), "creation_date": int(time.time())})  # JSON is YAML
        words = [
            "tar", "--one-file-system", "--numeric-owner", "--sort=name", "--exclude=./.init", "-czf", str(aside),
            "--transform=s,^\\./,rootfs/,rSh", "-C", str(folder), METADATA, "-C", f"/proc/{pid}/root", "./",
        ]  # fmt: skip
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None:
            if closing.wait(_LOOK_S):
                process.kill()
        if process.wait() not in (0, 1):  # 1: a file changed while it was read
            raise CastError(f"{path}: {'given up: the box ends' if closing.is_set() else 'tar failed'}")
