# SPDX-License-Identifier: GPL-3.0-or-later
"""IP packets over modems and the emulator: what a TUN device sends becomes samples, and samples become what it receives."""

import collections
import os
import select
import threading
import time

import numpy as np
from gnuradio import gr

from ..core.errors import CastError
from ..emulation.reference import filter_length
from ..scenario import Scenario
from .emulation import Emulation
from .modem import Modem

_GAP = 200  # samples of silence between two frames
LATENCY_S = 35e-3  # that samples are held back: made together at one end, looked at together at the other
LATENCIES_S = 2e-3, 1.0  # the least and the most that may be asked for
_MADE = 1 / 7  # of it at the sender
_CATCH_UP_S = 0.1  # of samples that may be made together after the machine was busy elsewhere
_SEND_BUFFER = 1 << 20  # bytes of packets that wait; more stay in the kernel's own queue, which drops


class FrameSource(gr.sync_block):
    """Frames of the packets read from a TUN file, silence between them, at the pace of the wall clock."""

    def __init__(self, modem: Modem, tun: int, sample_rate_hz: float, latency_s: float = LATENCY_S):
        gr.sync_block.__init__(self, "frame_source", None, [np.complex64])
        self._step = max(1, int(_MADE * latency_s * sample_rate_hz))
        self.set_min_output_buffer(int(_CATCH_UP_S * sample_rate_hz))
        self._modem, self._tun, self._rate_hz = modem, tun, sample_rate_hz
        self._left = np.empty(0, np.complex64)
        self._waiting: collections.deque[bytes] = collections.deque()
        self._ending = threading.Event()
        self.frames = 0
        self.ends_at = 0  # the newest frame, in samples

    @property
    def is_quiet(self) -> bool:
        return not self._waiting and not self._left.size

    def start(self):
        self._begin, self._made = time.monotonic(), 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        return True

    def stop(self):
        self._ending.set()
        self._reader.join()
        return True

    def _read(self) -> None:
        held = 0
        while not self._ending.is_set():
            if held > _SEND_BUFFER:
                time.sleep(0.01)
            elif select.select([self._tun], [], [], 0.05)[0]:
                packet = os.read(self._tun, 65536)
                if packet[0] >> 4 == 4:  # the kernel's own IPv6 announcements would only fill the air
                    self._waiting.append(packet)
            held = sum(map(len, tuple(self._waiting)))

    def work(self, input_items, output_items):
        out = output_items[0]
        due = int((time.monotonic() - self._begin) * self._rate_hz) - self._made
        step = min(len(out), self._step)
        if due < step:
            time.sleep((step - due) / self._rate_hz)
            return 0
        n = min(len(out), due)
        done = 0
        while done < n:
            if not self._left.size and self._waiting:
                frame = self._modem.modulate(self._waiting.popleft())
                self._left = np.concatenate([frame, np.zeros(_GAP, np.complex64)])
                self.frames += 1
                self.ends_at = self._made + done + len(self._left)
            if not self._left.size:
                out[done:n] = 0
                break
            part = self._left[: n - done]
            out[done : done + len(part)] = part
            self._left = self._left[len(part) :]
            done += len(part)
        self._made += n
        return n


class FrameSink(gr.sync_block):
    """Writes the packets of whole frames to a TUN file."""

    def __init__(self, modem: Modem, tun: int, sample_rate_hz: float, longest_frame: int, latency_s: float = LATENCY_S):
        gr.sync_block.__init__(self, "frame_sink", [np.complex64], None)
        self._modem, self._tun = modem, tun
        self._fresh, self._old = max(1, int((1 - _MADE) * latency_s * sample_rate_hz)), longest_frame
        self._samples = np.empty(0, np.complex64)
        self._begin = 0  # of `_samples`, in the stream: frames that begin before it are through
        self._newest = -2 * _GAP  # where the newest packet began, in the stream
        self.frames = 0

    @property
    def heard_until(self) -> int:
        return self._begin

    def work(self, input_items, output_items):
        self._samples = np.concatenate([self._samples, input_items[0]])
        if len(self._samples) >= self._old + self._fresh:
            self._look()
        return len(input_items[0])

    def _look(self) -> None:
        for packet in self._modem.demodulate(self._samples):
            start = self._begin + packet.start_sample
            if start <= self._newest + _GAP:  # heard in the samples that were kept from the last look
                continue
            self._newest = start
            self.frames += 1
            try:
                os.write(self._tun, packet.payload)
            except OSError:  # not an IP packet, or a device that is down: as lost as on the air
                pass
        # A frame that began here may end in samples to come.
        drop = len(self._samples) - self._old
        self._samples = self._samples[drop:]
        self._begin += drop


class RadioLink:
    """Nodes of a scenario with a modem each between their TUN files and one emulator, in real time.

    `latency_s` is how long samples are held back to be made and looked at together: the less, the more often the modem looks
    at the same samples again. `frame_s` is the longest frame's own time on the air.
    """

    def __init__(
        self, scenario: Scenario, tuns: dict[str, int], modem: Modem, sample_rate_hz: float, *, noise_power: float, mtu: int,
        seed: int = 0, latency_s: float = LATENCY_S,
    ):  # fmt: skip
        missing = [node for node in tuns if node not in scenario.nodes]
        if missing:
            raise CastError(f"{scenario.name}: no node {', '.join(missing)}; the scenario has {', '.join(scenario.nodes)}")
        longest = len(modem.modulate(bytes(mtu))) + 2 * _GAP
        self.frame_s = longest / sample_rate_hz
        self._sources = {node: FrameSource(modem, tun, sample_rate_hz, latency_s) for node, tun in tuns.items()}
        self._sinks = {node: FrameSink(modem, tun, sample_rate_hz, longest, latency_s) for node, tun in tuns.items()}
        ends = {(node, "tx"): block for node, block in self._sources.items()}
        ends |= {(node, "rx"): block for node, block in self._sinks.items()}
        self._emulation = Emulation(scenario, [], sample_rate_hz, noise_power=noise_power, seed=seed, ends=ends)
        self._rate_hz = sample_rate_hz
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._emulation.run_until, args=(self._ended,), daemon=True)

    def __enter__(self):
        self._begin = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    @property
    def is_quiet(self) -> bool:
        """Whether nothing waits and every frame is through, its echoes included."""
        sent_until = max(source.ends_at for source in self._sources.values()) + filter_length(self._rate_hz)
        heard = all(sink.heard_until >= sent_until for sink in self._sinks.values())
        return heard and all(source.is_quiet for source in self._sources.values())

    def status(self) -> dict:
        """The emulator's status, the factor of real time since the start, and the frames that each node sent and heard."""
        frames = {node: {"sent": self._sources[node].frames, "heard": self._sinks[node].frames} for node in self._sources}
        status = self._emulation.status()
        passed_s = time.monotonic() - self._begin
        return status | {"frames": frames, "real_time_factor": status["samples"] / self._rate_hz / passed_s}
