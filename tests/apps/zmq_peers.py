# SPDX-License-Identifier: GPL-3.0-or-later
"""Peers of the emulator in processes of their own, which a test may kill: GNU Radio's blocks, or sockets as srsRAN has them.

A peer sends samples whose real part counts 0, 1, … (modulo PERIOD) and whose imaginary part is its life, and writes what
it hears to a file. Processes are forked from one that has GNU Radio loaded already: a life begins within milliseconds.
"""

import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import numpy as np

PERIOD = 2**20  # exact in a float
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["numpy", "zmq", "gnuradio.gr", "gnuradio.blocks", "gnuradio.zeromq"])


def _counted(first: int, n: int, life: int) -> np.ndarray:
    return (np.arange(first, first + n) % PERIOD + 1j * life).astype(np.complex64)


def _gnuradio(sink, source, rate_hz: float, life: int, heard: str) -> None:
    from gnuradio import blocks, gr

    ramp = Path(heard).with_suffix(".ramp")
    _counted(0, PERIOD, life).tofile(ramp)
    top = gr.top_block()
    heard_sink = blocks.file_sink(gr.sizeof_gr_complex, heard)
    heard_sink.set_unbuffered(True)
    sent = blocks.file_source(gr.sizeof_gr_complex, str(ramp), True)
    top.connect(sent, blocks.throttle(gr.sizeof_gr_complex, rate_hz), sink)
    top.connect(source, heard_sink)
    top.run()


def gnuradio(sends_at: str, hears_at: str, life: int, heard: str) -> None:
    """GNU Radio's own REP Sink and REQ Source, as fast as they can."""
    from gnuradio import zeromq

    sink, source = zeromq.rep_sink(8, 1, sends_at, 50, False, -1), zeromq.req_source(8, 1, hears_at, 50, False, -1)
    _gnuradio(sink, source, 1e9, life, heard)


def gnuradio_pubsub(sends_at: str, hears_at: str, life: int, heard: str) -> None:
    """GNU Radio's own PUB Sink and SUB Source, slow enough for nothing to be lost."""
    from gnuradio import zeromq

    sink, source = zeromq.pub_sink(8, 1, sends_at, 50, False, -1), zeromq.sub_source(8, 1, hears_at, 50, False, -1)
    _gnuradio(sink, source, 50e3, life, heard)


def srsran(sends_at: str, hears_at: str, life: int, heard: str, ahead: int | None = None) -> None:
    """srsRAN's radio: asks again as soon as it is answered, and answers when it has something to send.

    In lock step, with `ahead`: never sends further than so many samples beyond what it heard.
    """
    import zmq

    context, rng = zmq.Context(), random.Random(life)
    reply, request = context.socket(zmq.REP), context.socket(zmq.REQ)
    reply.bind(sends_at)
    request.connect(hears_at)
    poller = zmq.Poller()
    poller.register(reply, zmq.POLLIN)
    poller.register(request, zmq.POLLIN)
    request.send(b"\xff")
    asked, n_sent, n_heard = False, 0, 0
    with open(heard, "wb", buffering=0) as file:
        while True:
            ready = dict(poller.poll())
            if reply in ready:
                reply.recv()
                asked = True
            if request in ready:
                answer = request.recv()
                n_heard += len(answer) // 8
                file.write(answer)
                request.send(b"\xff")
            if asked and (ahead is None or n_sent < n_heard + ahead):
                asked = False
                n = rng.choice([1, 7, 300, 2000, 23040]) if ahead is None else 100
                reply.send(_counted(n_sent, n, life).tobytes())
                n_sent += n


class Peer:
    """One node's stack, in as many lives as the test wants."""

    def __init__(self, name: str, sends_at: str, hears_at: str, folder: Path):
        self.name, self.addresses, self.folder = name, (sends_at, hears_at), folder
        self.lives = 0
        self._process = None

    def live(self, kind, *arguments) -> None:
        self.lives += 1
        self._process = PROCESSES.Process(
            target=kind, args=(*self.addresses, self.lives, str(self._heard(self.lives)), *arguments), daemon=True
        )
        self._process.start()

    def die(self) -> None:
        if self._process:
            self._process.kill()
            self._process.join()

    def pause(self, seconds: float) -> None:
        os.kill(self._process.pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(self._process.pid, signal.SIGCONT)

    def n_heard(self) -> int:
        """Samples in this life."""
        assert self._process.is_alive(), f"peer {self.name} ended by itself"
        heard = self._heard(self.lives)
        return heard.stat().st_size // 8 if heard.exists() else 0

    def heard_lives(self) -> list[np.ndarray]:
        files = filter(Path.exists, map(self._heard, range(1, self.lives + 1)))
        return [np.fromfile(file, np.complex64) for file in files]

    def _heard(self, life: int) -> Path:
        return self.folder / f"{self.name}.{life}"
