# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stand-ins of srsRAN share: its configuration files, and its ZeroMQ radio's questions and answers."""

import configparser
import threading

import numpy as np
import zmq

CHUNK = 1920


def settings(path):
    """The configuration file, and the addresses of its radio."""
    config = configparser.ConfigParser()
    config.read(path)
    arguments = dict(word.split("=", 1) for word in config["rf"]["device_args"].split(","))
    return config, arguments


def answer(address, amplitude):
    """Sends samples of constant power to whoever asks, for ever."""

    def serve():
        socket = zmq.Context.instance().socket(zmq.REP)
        socket.bind(address)
        rng = np.random.default_rng(1)
        while True:
            socket.recv()
            turns = rng.uniform(size=CHUNK) * 2j * np.pi
            socket.send((amplitude * np.exp(turns)).astype(np.complex64).tobytes())

    threading.Thread(target=serve, daemon=True).start()


def samples(address):
    """Yields what comes in answer to questions."""
    socket = zmq.Context.instance().socket(zmq.REQ)
    socket.connect(address)
    while True:
        socket.send(b"\xff")
        yield np.frombuffer(socket.recv(), np.complex64)
