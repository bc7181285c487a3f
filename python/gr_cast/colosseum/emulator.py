# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel emulator beside a box: the program that every user runs, joined to the radios' sockets and told what to play."""

import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from .. import scenario as sc
from ..core.errors import CastError

_START_S = 60.0  # on a machine that does other things too
_ANSWER_S = 20.0


@dataclass(frozen=True, kw_only=True)
class Channel:
    """What a box's emulator is: samples/s, the loss of the set-up on every link, every receiver's noise."""

    rate_hz: float = 1e6
    base_loss_db: float = 57.55  # Colosseum's, as published
    noise_power_db: float = -100.0
    seed: int = 0


def as_srns(scenario: sc.Scenario, node_of_srn: dict[int, int], srns: tuple[int, ...], base_loss_db: float) -> sc.Scenario:
    """A scenario whose nodes are SRNs: each hears and is heard as the node that it is, and not at all where it is none."""
    srn_of = {scenario.nodes[node - 1]: str(srn) for srn, node in node_of_srn.items() if node <= len(scenario.nodes)}
    links = {(srn_of[tx], srn_of[rx]): taps for (tx, rx), taps in scenario.links.items() if tx in srn_of and rx in srn_of}
    losses = {
        (srn_of[tx], srn_of[rx]): loss for (tx, rx), loss in scenario.link_base_loss_db.items() if tx in srn_of and rx in srn_of
    }
    moved = replace(
        scenario, nodes=tuple(str(srn) for srn in srns), links=links, link_base_loss_db=losses, position_m={}
    )  # fmt: skip
    return sc.with_base_loss(moved, base_loss_db)


def quiet(srns: tuple[int, ...], center_frequency_hz: float | None = None) -> sc.Scenario:
    """Between scenarios nothing passes."""
    return sc.Scenario(name="cleared", nodes=tuple(str(s) for s in srns), links={}, center_frequency_hz=center_frequency_hz)


class Emulator:
    """cast_emulator.py in a process that ends with this one; nothing passes until `play`."""

    def __init__(self, program: Path, folder: Path, radios: dict[int, Path], channel: Channel):
        self._folder, self._srns, self._channel = folder, tuple(sorted(radios)), channel
        folder.mkdir(parents=True, exist_ok=True)
        sc.save(folder / "cleared.yaml", quiet(self._srns))
        self._control = f"ipc://{folder}/control"
        ports = [
            f"--port={srn}:{direction}=zmq:ipc://{radios[srn]}/{direction}" for srn in self._srns for direction in ("tx", "rx")
        ]
        words = [
            sys.executable, str(program), "run", str(folder / "cleared.yaml"), f"--rate={channel.rate_hz!r}",
            f"--noise-power-db={channel.noise_power_db}", f"--seed={channel.seed}", f"--control={self._control}", "--report=60",
            *ports,
        ]  # fmt: skip
        self._out = open(folder / "out", "wb")
        self._process = subprocess.Popen(
            ["setpriv", "--pdeathsig", "KILL", *words], stdin=subprocess.DEVNULL, stdout=self._out, stderr=self._out
        )
        self._count = 0

    def wait_until_ready(self) -> None:
        """Raises CastError with the emulator's own words where it does not come up."""
        until_s = time.monotonic() + _START_S
        while time.monotonic() < until_s:
            if self._process.poll() is not None:
                break
            if (self._folder / "control").exists():
                self.status()
                return
            time.sleep(0.05)
        raise CastError(f"emulator: does not start: {self.last_words()}")

    def last_words(self) -> str:
        lines = (self._folder / "out").read_text(errors="replace").splitlines()
        return " | ".join(lines[-3:]) or "it said nothing"

    def play(self, number: int, node_of_srn: dict[int, int], cycle: bool) -> None:
        scenario = as_srns(sc.load(str(number)), node_of_srn, self._srns, self._channel.base_loss_db)
        self._count += 1
        path = self._folder / f"{self._count}.zarr"
        sc.save(path, scenario)
        self.ask({"command": "load", "scenario": str(path), "cycle": cycle})

    def clear(self) -> None:
        self.ask({"command": "load", "scenario": str(self._folder / "cleared.yaml"), "cycle": False})

    def status(self) -> dict:
        return self.ask({"command": "status"})

    def ask(self, command: dict) -> dict:
        """The emulator's status after a command. Raises CastError where it does not obey."""
        import zmq

        with zmq.Context() as context, context.socket(zmq.REQ) as asking:
            asking.setsockopt(zmq.LINGER, 0)
            asking.connect(self._control)
            asking.send_json(command)
            if not asking.poll(int(1000 * _ANSWER_S)):
                raise CastError(f"emulator: no answer to {command['command']} within {_ANSWER_S:g} s: {self.last_words()}")
            answer = asking.recv_json()
        if not answer.get("ok"):
            raise CastError(*(f"emulator: {line}" for line in answer.get("errors", ["refused"])))
        return answer["status"]

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def stop(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._out.close()
