# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stand-ins of srsRAN share: its configuration files, its ZeroMQ radio's questions and answers, its TUN devices."""

import configparser
import contextlib
import fcntl
import os
import socket
import struct
import subprocess
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
