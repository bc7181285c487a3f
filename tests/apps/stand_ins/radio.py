# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stand-ins of srsRAN share: its configuration files, its ZeroMQ radio's questions and answers, its TUN devices."""

import configparser
import contextlib
import fcntl
import os
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import zmq

OPTIONS = Path(__file__).resolve().parent / "options"  # that the real programs know, of their sources (srsRAN 4G, release 23.04)
SUBCARRIER_HZ = 15e3


def settings(path):
    """The configuration file; what the real program would not know ends this one as it ends that."""
    config = configparser.ConfigParser(strict=False)
    config.read(path)
    known = (OPTIONS / f"{Path(sys.argv[0]).name}.txt").read_text().split()
    for section in config.sections():
        for key in config[section]:
            if f"{section}.{key}" not in known:
                sys.exit(f"unrecognised option '{section}.{key}'")
    return config


def radio(config):
    """Addresses and rate of its ZeroMQ radio, and its two gains as factors; a transmitter's that is not above 0 dB is the
    receiver's (lib/src/radio/radio.cc)."""
    arguments = dict(word.split("=", 1) for word in config["rf"]["device_args"].split(","))
    tx_db, rx_db = (float(config["rf"][name]) for name in ("tx_gain", "rx_gain"))
    gains = (10 ** (gain_db / 20) for gain_db in (tx_db if tx_db > 0 else rx_db, rx_db))
    return arguments["tx_port"], arguments["rx_port"], float(arguments["base_srate"]), *gains


def symbol(rate_hz, blocks):
    """One OFDM symbol at full load, as srsENB scales it before its tx_gain; bins of its carriers."""
    size = round(rate_hz / SUBCARRIER_HZ)
    carriers = np.r_[1 : 6 * blocks + 1, size - 6 * blocks : size]
    spectrum = np.zeros(size, complex)
    spectrum[carriers] = np.random.default_rng(1).choice([1, -1, 1j, -1j], len(carriers)) * 0.05 / np.sqrt(blocks)
    return np.fft.ifft(spectrum) * size, carriers


def answer(address, period):
    """Sends the samples of `period` again and again to whoever asks."""

    def serve():
        socket = zmq.Context.instance().socket(zmq.REP)
        socket.bind(address)
        message = np.tile(period, 10).astype(np.complex64).tobytes()
        while True:
            socket.recv()
            socket.send(message)

    threading.Thread(target=serve, daemon=True).start()


def carry(device, address, folder):
    """A TUN device whose packets go past the radio, to the socket of the address that they are for, and back."""
    os.chdir(folder)  # names of sockets are short
    tun = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(tun, 0x400454CA, struct.pack("16sH22x", device.encode(), 0x1001))
    end = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    end.bind(f"{address}.packets")

    def leave():
        while True:
            packet = os.read(tun, 65536)
            with contextlib.suppress(OSError):  # nobody has that address
                end.sendto(packet, f"{socket.inet_ntoa(packet[16:20])}.packets")

    def arrive():
        while True:
            with contextlib.suppress(OSError):
                os.write(tun, end.recv(65536))

    for words in (f"address add {address}/24 dev {device}", f"link set {device} up"):
        subprocess.run(["ip", *words.split()], check=True)
    for work in (leave, arrive):
        threading.Thread(target=work, daemon=True).start()


def samples(address):
    """Yields what comes in answer to questions."""
    socket = zmq.Context.instance().socket(zmq.REQ)
    socket.connect(address)
    while True:
        socket.send(b"\xff")
        yield np.frombuffer(socket.recv(), np.complex64)
