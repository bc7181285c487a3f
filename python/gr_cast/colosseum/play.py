# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch job played in a box by the documented timeline. Whatever a script does is noted, and the job goes on."""

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

from .. import scenario as sc
from ..core import interrupts
from ..core.errors import CastError
from ..core.files import digest_of
from . import radio_api, traffic, updates
from .box import Box, Srn, colosseum_config
from .emulator import Channel
from .image import RADIO_API
from .job import Job
from .storage import Storage
from .timeline import Clock
from .unpacked import copy_logs, used_bytes


@dataclass(kw_only=True)
class Record:
    """What a run notes: calls, changes of state (seconds, host, state, information), faults in words, figures."""

    calls: list[radio_api.Call] = field(default_factory=list)
    states: list[tuple[float, str, str, str]] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)


class Player:
    """One playing of a job; `run()` gives the report's document, also where it is interrupted."""

    def __init__(
        self, job: Job, storage: Storage, clock: Clock, channel: Channel, program: Path, output: Path, *,
        changes: list[updates.Update], name: str | None = None, say: Callable[[str], None] = lambda line: None,
    ):  # fmt: skip
        self.job, self.storage, self.clock, self.channel, self.output, self.say = job, storage, clock, channel, output, say
        self._changes = changes
        srns = [Srn(number=node.srn, image=node.image_path, is_gateway=node.is_gateway) for node in job.nodes]
        self.scenario = sc.load(str(job.rf_scenario))
        self.box = Box(name, storage, srns, channel, program, interactive=False)
        self.record = Record()
        self._generators: traffic.Generators | None = None
        self._ended: set[int] = set()
        self._discontinuities = 0
        self._fastest = 0.0  # real-time factor between two looks at the emulator
        self._figures: dict = {}

    def run(self) -> dict:
        self._began = time.monotonic()
        try:
            with contextlib.ExitStack() as stack:
                stack.push(self.box)  # its folder is there before it is entered
                self._event("containers load and boot")
                stack.enter_context(self.box)
                self.box.write_state(job=self.job.name)
                stack.callback(self._collect)
                self._pool = stack.enter_context(ThreadPoolExecutor(len(self.job.nodes)))
                self._configure()
                self._boot()
                self._start()
                self._play()
                self._stop()
                outcome = "played"
        except CastError as error:
            self.record.faults += error.faults
            outcome = "failed"
        except KeyboardInterrupt:
            interrupts.settled()
            self.record.faults.append("interrupted")
            outcome = "interrupted"
        return self._document(outcome)

    def _now_s(self) -> float:
        return time.monotonic() - self._began

    def _event(self, text: str) -> None:
        self.record.events.append((self._now_s(), text))
        self.say(text)

    def _configure(self) -> None:
        """What Colosseum writes into a container before its radio may be asked for its state."""
        config = colosseum_config(self.channel, self.scenario.center_frequency_hz or 1e9)
        for node in self.job.nodes:
            container = self.box.containers[node.srn]
            container.put(f"{RADIO_API}/radio.conf", node.modem_config.read_bytes())
            container.put(f"{RADIO_API}/colosseum_config.ini", config)
        self._write([change for change in self._changes if change.at_s <= 0], call=False)

    def _boot(self) -> None:
        self._event("status.sh is polled")
        scaled_s, most_s = self.clock.ready_s()
        self._poll_until(scaled_s, most_s, ("READY",))
        late = [self.box.host_name(node.srn) for node in self.job.nodes if self._state(node.srn) != "READY"]
        for name in late:
            self.record.faults.append(f"{name}: not READY at {self._minutes(self.clock.profile.ready_s)}")
        self._poll_until(self.clock.start_s, self.clock.start_s, ())

    def _start(self) -> None:
        self._event("start.sh, scenario and traffic")
        self._begin_traffic()
        self.box.emulator.play(self.job.rf_scenario, {node.srn: node.rf_node for node in self.job.nodes}, cycle=True)
        self._call_all("start.sh")
        for script in updates.SCRIPT_OF.values():
            self._call_all(script)

    def _begin_traffic(self) -> None:
        if self.job.traffic_path is None:
            return
        if not traffic.is_installed():
            self.record.faults.append("traffic: mgen: not installed (Debian: apt install mgen): the job goes on without it")
            return
        flows = traffic.read(self.job.traffic_path, max(self.clock.run_s, 1.0))
        ends = {str(node.traffic_node): self.box.ends[node.srn] for node in self.job.nodes}
        self._generators = traffic.Generators(flows, ends, self.output / "traffic", self.clock.scale)

    def _play(self) -> None:
        begin = self._now_s()
        left = [change for change in self._changes if change.at_s > 0]
        length_s = None if self.scenario.is_static else float(self.scenario.time_s[-1])
        samples, looked_s = self.box.emulator.status()["samples"], begin
        while (passed_s := self._now_s() - begin) < self.clock.run_s:
            due = [change for change in left if change.at_s / self.clock.scale <= passed_s]
            self._write(due, call=True)
            left = left[len(due) :]
            self._poll()
            status, now_s = self.box.emulator.status(), self._now_s()
            self._fastest = max(self._fastest, (status["samples"] - samples) / self.channel.rate_hz / max(now_s - looked_s, 1e-3))
            samples, looked_s = status["samples"], now_s
            if length_s and int(status["scenario_time_s"] / length_s) > self._discontinuities:
                self._discontinuities = int(status["scenario_time_s"] / length_s)
                self._event("the scenario begins again: scenario_discontinuity.sh")
                self._call_all("scenario_discontinuity.sh")
            time.sleep(max(0.0, min(self.clock.poll_s, self.clock.run_s - (self._now_s() - begin))))

    def _stop(self) -> None:
        self._event("stop.sh")
        self._figures["emulator"] = self._emulator_figures()
        self._call_all("stop.sh")
        self.box.emulator.clear()
        if self._generators:
            self._generators.stop()
        scaled_s, most_s = self.clock.stop_s()
        self._poll_until(scaled_s, most_s, ("FINISHED",))
        for node in self.job.nodes:
            if (state := self._state(node.srn)) != "FINISHED":
                name = self.box.host_name(node.srn)
                self.record.faults.append(f"{name}: {state or 'no state'} when it was taken away, 2:00 after stop.sh")
        self._event("containers are taken away")

    def _emulator_figures(self) -> dict:
        status = self.box.emulator.status()
        kept = ("samples", "late_updates", "clipped_samples", "scenario_time_s", "waiting_for")
        figures = {key: status[key] for key in kept} | {"real_time_factor": self._fastest}
        waits = [peer.partition("=")[0] for peer in figures["waiting_for"]]
        if figures["samples"] == 0:
            self.record.faults.append("emulator: no sample has passed: no radio was joined to it, or one of them was not")
        elif waits:
            self.record.faults.append(f"emulator: waits for {', '.join(waits)}: nothing passes while a radio does not answer")
        return figures

    def _write(self, changes: list[updates.Update], *, call: bool) -> None:
        for change in changes:
            if call:
                self._event(f"{change.file} is replaced")
            for node in self._alive():
                self.box.containers[node].put(f"{RADIO_API}/{change.file}", change.data)
            if call:
                self._call_all(updates.SCRIPT_OF[change.file])

    def _alive(self) -> list[int]:
        """SRNs whose containers run; one that has ended by itself is named once."""
        for number, container in self.box.containers.items():
            if number not in self._ended and not container.is_running:
                self._ended.add(number)
                self.record.faults.append(f"{self.box.host_name(number)}: its container ended after {self._now_s():.1f} s")
        return [number for number in self.box.containers if number not in self._ended]

    def _call(self, number: int, script: str) -> radio_api.Call:
        words = self.box.containers[number].words(f"{RADIO_API}/{script}")
        return radio_api.call(words, srn=number, script=script, at_s=self._now_s(), folder=self.box.place(number, "calls"))

    def _call_all(self, script: str) -> None:
        for call in self._pool.map(lambda number: self._call(number, script), self._alive()):
            self._note(call)

    def _note(self, call: radio_api.Call) -> None:
        name = self.box.host_name(call.srn)
        known = {fault.partition(" (")[0] for fault in self.record.faults}
        for fault in call.faults:
            line = f"{name}: {call.script}: {fault}"
            if line not in known:
                self.record.faults.append(f"{line} (at {call.at_s:.1f} s)")
        if call.script != "status.sh" or call.faults:
            self.record.calls.append(call)
        if call.state and call.state != self._state(call.srn):
            self.record.states.append((call.at_s, name, call.state, call.info))
            self.say(f"{name}: {call.state} {call.info}".rstrip())

    def _state(self, number: int) -> str:
        name = self.box.host_name(number)
        return next((state for _, host, state, _ in reversed(self.record.states) if host == name), "")

    def _poll(self) -> None:
        self._call_all("status.sh")

    def _poll_until(self, scaled_s: float, most_s: float, wanted: tuple[str, ...]) -> None:
        """Poll for `scaled_s`, and on to `most_s` until all say one of `wanted`."""
        begin = self._now_s()
        while True:
            self._poll()
            passed_s = self._now_s() - begin
            is_done = all(self._state(number) in wanted for number in self._alive()) if wanted else True
            if passed_s >= most_s or (passed_s >= scaled_s and is_done):
                return
            limit_s = scaled_s if passed_s < scaled_s else most_s
            time.sleep(max(0.01, min(self.clock.poll_s, limit_s - passed_s)))

    def _collect(self) -> None:
        """What is under /logs, and how much was written; also of a job that failed."""
        if self._generators:
            self._generators.stop()
        self._figures["nodes"] = {}
        for node in self.job.nodes:
            target = self.output / self.box.host_name(node.srn)
            copy_logs(self.box.place(node.srn, "logs"), target)
            self._figures["nodes"][node.srn] = {
                "disk_bytes": used_bytes(self.box.place(node.srn, "upper"), self.box.place(node.srn, "logs")),
                "logs": sorted(str(path.relative_to(self.output)) for path in target.rglob("*") if path.is_file()),
            }

    def _document(self, outcome: str) -> dict:
        rows = []
        if self._generators:
            try:
                rows = self._generators.results()
            except CastError as error:
                self.record.faults += error.faults
        nodes = self._figures.get("nodes", {})
        return {
            "cast_colosseum": 1, "job": self.job.name, "outcome": outcome, "rf_scenario": self.job.rf_scenario,
            "traffic_scenario": self.job.traffic_scenario, "duration_s": self.job.duration_s, "profile": self.clock.profile.name,
            "time_scale": self.clock.scale, "seconds": self._now_s(), "channel": asdict(self.channel),
            "faults": self.record.faults,
            "events": [{"at_s": at_s, "event": text} for at_s, text in self.record.events],
            "nodes": [
                {
                    "host": self.box.host_name(node.srn), "rf_node": node.rf_node, "traffic_node": node.traffic_node,
                    "image": node.image, "image_sha256": digest_of(node.image_path),
                    "states": [
                        {"at_s": at_s, "state": state, "info": info}
                        for at_s, host, state, info in self.record.states if host == self.box.host_name(node.srn)
                    ],
                    "calls": [
                        {"at_s": c.at_s, "script": c.script, "seconds": c.seconds, "status": c.status,
                         "printed": c.printed[:2000], "errors": c.errors[:2000], "faults": list(c.faults)}
                        for c in self.record.calls if c.srn == node.srn
                    ],
                    **nodes.get(node.srn, {"disk_bytes": 0, "logs": []}),
                }
                for node in self.job.nodes
            ],
            "emulator": self._figures.get("emulator"), "traffic": rows,
        }  # fmt: skip

    @staticmethod
    def _minutes(seconds: float) -> str:
        return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def changes_of(job: Job, duration_s: float, scenario: sc.Scenario, channel: Channel, path: Path | None) -> list[updates.Update]:
    """All that a job's radios are told: at its beginning, and what the file `path` says beyond."""
    flows = traffic.read(job.traffic_path, max(duration_s, 1.0)) if job.traffic_path else None
    begun = updates.first(flows, scenario.center_frequency_hz or 1e9, channel.rate_hz)
    return begun + (updates.read(path, job.duration_s) if path else [])
