# SPDX-License-Identifier: GPL-3.0-or-later
"""A real LTE stack over the emulator: srsRAN 4G's configuration files, and its and iperf3's logs as series.

srsRAN's ZeroMQ radio asks for samples where it receives and answers where it sends; every radio gets an IPC socket each way to
the emulator. File formats are those of srsRAN 4G 23.04 (enb.conf, ue.conf, epc.conf, user_db.csv, metrics) and iperf3 3.
"""

import csv
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...comparing.series import Series
from ...core.documents import json_file, listed, read_text, short
from ...core.errors import CastError, Faults
from ...core.files import write_text
from .downlink import Cell

PROGRAMS = ("srsepc", "srsenb", "srsue")
SAMPLE_RATE_HZ = {6: 1.92e6, 15: 3.84e6, 25: 5.76e6, 50: 11.52e6, 75: 15.36e6, 100: 23.04e6}  # srsRAN's own
GATEWAY = "172.16.0.1"  # of the packet core, where traffic to the terminals comes from
METRICS_S = 1.0
SINR_AGE_S = 9e-3  # mean of what is in srsUE's SINR: a moving average, 0.1 of each subframe of 1 ms (its phy_common.cc)
# Of a station's samples at full load, every bandwidth alike: 12 carriers per block, each of amplitude 0.05 / sqrt(blocks), by a
# transform that does not scale (srsRAN's lib/src/phy/enb/enb_dl.c); its ZeroMQ radio multiplies them by tx_gain, here 0 dB.
FULL_LOAD_DB = 10 * np.log10(12 * 0.05**2)
SHORTEST_S = 0.1  # of an interval of iperf3 that is a measurement: the last may be a rest
_KEY, _OPC, _FIRST_IMSI = "00112233445566778899aabbccddeeff", "63bfa50ee6523365ff14c1f45f88737d", 1010123456000
_LONGEST_SOCKET = 107  # bytes, unix(7)
_TAIL_BYTES = 4096  # of metrics, in which a whole line is
_TEMPLATES = ("sib.conf", "rb.conf", "rr.conf")


@dataclass(frozen=True, kw_only=True)
class Member:
    """One radio of the network: its node, its configuration, its sockets (what it sends, what it receives), its metrics."""

    node: str
    program: str
    config: Path
    sends: str
    receives: str
    metrics: Path
    address: str = ""  # of a terminal, given by the core


def check_programs(generator: str) -> None:
    """Raises CastError where a program of the stack, or the traffic generator (iperf3 or mgen), is missing."""
    missing = [program for program in (*PROGRAMS, generator) if shutil.which(program) is None]
    if missing:
        raise CastError(
            f"stack: {', '.join(missing)}: not installed; build srsRAN 4G with ZeroMQ (and apt install {generator}), "
            "or leave out --stack for the modelled downlink"
        )


def write_configuration(cells: list[Cell], blocks: int, templates: Path, folder: Path, sockets: Path) -> list[Member]:
    """Every file that the stack reads, in `folder`; sib, rb and rr.conf come from `templates`, the user's own.

    `sockets`: a folder of a short name for the sockets, made where it is not there. Stations first, then terminals.
    """
    if blocks not in SAMPLE_RATE_HZ:
        raise CastError(f"resource blocks: got {blocks}, srsRAN knows {', '.join(map(str, SAMPLE_RATE_HZ))}")
    missing = [name for name in _TEMPLATES if not (templates / name).is_file()]
    if missing:
        raise CastError(
            f"{templates}: {', '.join(missing)}: no such file; srsRAN installs them (srsran_4g_install_configs.sh user), "
            "--stack-config names their folder"
        )
    nodes = [node for cell in cells for node in (cell.station, *cell.terminals)]
    longest = max(len(os.fsencode(sockets / f"{node}.tx")) for node in nodes)
    if longest > _LONGEST_SOCKET:
        raise CastError(f"{sockets}: a socket's path has {longest} bytes there, limit {_LONGEST_SOCKET}: take a shorter folder")
    folder.mkdir(parents=True, exist_ok=True)
    sockets.mkdir(parents=True, exist_ok=True)
    for name in ("sib.conf", "rb.conf"):
        write_text(folder / name, (templates / name).read_text())
    members = []
    for number, cell in enumerate(cells, 1):
        member = _member(cell.station, "srsenb", folder, sockets)
        write_text(folder / f"rr_{cell.station}.conf", _resources((templates / "rr.conf").read_text(), number, templates))
        write_text(member.config, _station(member, number, blocks, folder))
        members.append(member)
    subscribers = []
    for number, terminal in enumerate((terminal for cell in cells for terminal in cell.terminals), 2):
        member = _member(terminal, "srsue", folder, sockets, address=f"172.16.0.{number}")
        imsi = f"{_FIRST_IMSI + number:015d}"
        write_text(member.config, _terminal(member, imsi, blocks, folder))
        subscribers.append(f"{terminal},mil,{imsi},{_KEY},opc,{_OPC},9001,000000001234,9,{member.address}")
        members.append(member)
    write_text(folder / "user_db.csv", "\n".join(subscribers) + "\n")
    write_text(folder / "epc.conf", _core(folder))
    return members


def _member(node: str, program: str, folder: Path, sockets: Path, address: str = "") -> Member:
    return Member(
        node=node, program=program, config=folder / f"{program}_{node}.conf", sends=f"ipc://{sockets}/{node}.tx",
        receives=f"ipc://{sockets}/{node}.rx", metrics=folder / f"{program}_{node}.csv", address=address,
    )  # fmt: skip


def _resources(text: str, number: int, templates: Path) -> str:
    """rr.conf with a cell identity of its own; everything else is the user's."""
    for key, value in (("cell_id", f"0x{number:02X}"), ("pci", str(number))):
        text, count = re.subn(rf"(?m)^(\s*{key}\s*=\s*)[^;]+;", rf"\g<1>{value};", text, count=1)
        if not count:
            raise CastError(f"{templates / 'rr.conf'}: {key}: not found in its cell_list")
    return text


def _radio(member: Member, blocks: int, identity: str) -> str:
    rate = f"{SAMPLE_RATE_HZ[blocks]:.0f}"
    return (
        "[rf]\ndevice_name = zmq\n"
        f"device_args = tx_port={member.sends},rx_port={member.receives},id={identity},base_srate={rate}\n"
        "tx_gain = 0\nrx_gain = 0\n"  # srsRAN takes the receiver's gain for a transmitter's that is not above 0 dB
    )


def _metrics_and_log(member: Member, section: str, folder: Path, more: str = "") -> str:
    return (
        f"[{section}]\nmetrics_csv_enable = true\nmetrics_csv_filename = {member.metrics}\n"
        f"metrics_period_secs = {METRICS_S:g}\n{more}"
        f"[log]\nall_level = warning\nfilename = {folder / member.config.stem}.log\n[gui]\nenable = false\n"
    )


def _station(member: Member, number: int, blocks: int, folder: Path) -> str:
    return (
        f"[enb]\nenb_id = 0x{0x19A + number:X}\nmcc = 001\nmnc = 01\nmme_addr = 127.0.1.100\ngtp_bind_addr = 127.0.1.{number}\n"
        f"s1c_bind_addr = 127.0.1.{number}\nn_prb = {blocks}\n"
        f"[enb_files]\nsib_config = {folder / 'sib.conf'}\nrr_config = {folder / f'rr_{member.node}.conf'}\n"
        f"rb_config = {folder / 'rb.conf'}\n" + _radio(member, blocks, "enb") + _metrics_and_log(member, "expert", folder)
    )


def _terminal(member: Member, imsi: str, blocks: int, folder: Path) -> str:
    return (
        _radio(member, blocks, "ue")
        + f"[usim]\nmode = soft\nalgo = milenage\nopc = {_OPC}\nk = {_KEY}\nimsi = {imsi}\nimei = 3534900698733{imsi[-2:]}\n"
        + "[nas]\napn = internet\napn_protocol = ipv4\nforce_imsi_attach = true\n"  # else by .ctxt, whichever wrote it last
        + _metrics_and_log(member, "general", folder, "metrics_csv_flush_period_sec = 1\n")
    )


def _core(folder: Path) -> str:
    return (
        "[mme]\nmme_code = 0x1a\nmme_group = 0x0001\ntac = 0x0007\nmcc = 001\nmnc = 01\nmme_bind_addr = 127.0.1.100\n"
        "apn = internet\ndns_addr = 8.8.8.8\nencryption_algo = EEA0\nintegrity_algo = EIA1\n"
        f"[hss]\ndb_file = {folder / 'user_db.csv'}\n"
        f"[spgw]\ngtpu_bind_addr = 127.0.1.100\nsgi_if_addr = {GATEWAY}\nsgi_if_name = srs_spgw_sgi\nmax_paging_queue = 100\n"
        f"[log]\nall_level = warning\nfilename = {folder / 'epc.log'}\n"
    )


def read_terminal_metrics(path: Path) -> dict[str, Series]:
    """`sinr_db` and `dl_bps` over time of srsUE's metrics file while it was attached and heard its cell; times of the file are in
    ms. A cut last line is left out."""
    time_ms, sinr_db, dl_bps = _metrics(path, ("time", "dl_snr", "dl_brate"))
    values = {"sinr_db": sinr_db, "dl_bps": dl_bps}
    return {name: Series(name=f"{path}: {name}", time_s=time_ms / 1e3, value=value) for name, value in values.items()}


def last_time_s(path: Path) -> float | None:
    """The time of the last whole line of a terminal's metrics, which may still be written; None where there is none yet."""
    try:
        with open(path, "rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - _TAIL_BYTES, 0))
            lines = file.read().split(b"\n")[1:-1]  # the first may be cut, or is the head
    except FileNotFoundError:
        return None
    times = [line.partition(b";")[0] for line in lines]
    return next((int(time) / 1e3 for time in reversed(times) if time.isdigit()), None)


def read_station_metrics(path: Path) -> dict[str, Series]:
    """`dl_bps` and `ul_bps` of all terminals together over time, of srsENB's metrics file; its times are in s."""
    time_s, dl_bps, ul_bps = _metrics(path, ("time", "dl_brate", "ul_brate"))
    values = {"dl_bps": dl_bps, "ul_bps": ul_bps}
    return {name: Series(name=f"{path}: {name}", time_s=time_s, value=value) for name, value in values.items()}


def _metrics(path: Path, needed: tuple[str, ...]) -> list[np.ndarray]:
    """The columns `needed`, (n,) each, of a metrics file. All faults of it at once, a line of the file each."""
    text = read_text(path, missing=": the stack wrote no metrics")
    lines = text[: text.rfind("\n") + 1].split("\n")
    try:
        head, *rows = csv.reader(lines, delimiter=";")
    except csv.Error as error:
        raise CastError(f"{path}: not CSV: {error}") from None
    missing = [name for name in needed if name not in head]
    if missing:
        raise CastError(f"{path}: no column {', '.join(missing)}; has {listed(head)}")
    places = [head.index(name) for name in needed]
    carrier, attached, power = (head.index(name) if name in head else None for name in ("cc", "is_attached", "rsrp"))
    faults, columns = Faults(str(path)), []
    for number, row in enumerate(rows, 2):
        if len(row) <= max(places):  # srsRAN's last line says that it ended
            continue
        if carrier is not None and row[carrier : carrier + 1] not in ([], ["0"]):
            continue  # only the first carrier's lines: others repeat the time
        if attached is not None and row[attached : attached + 1] in (["0"], ["0.0"]):
            continue  # zeros, twice for one time, before there is a cell
        if power is not None and row[power : power + 1] == ["0.0"]:
            continue  # zeros while it is idle, which measures nothing
        try:
            values = [float(row[place]) for place in places]
        except ValueError:
            faults.add(f"line {number}", f"got {short(';'.join(row[place] for place in places))}, needs numbers")
        else:
            if np.isfinite(values).all():  # no cell yet: nan
                columns.append(values)
    if len(columns) < 2:
        when = "" if attached is None else " while it was attached"
        faults.add("", f"{len(columns)} lines of metrics{when}, needs 2 or more")
    faults.raise_if_any()
    return list(np.array(columns).T)


def read_iperf3(path: Path) -> Series:
    """Received bits per s over time of an iperf3 JSON file: the server's where it is in there, else the client's own."""
    get = json_file(path, missing=": iperf3 wrote nothing")
    document = get.mapping(get.document.get("server_output_json", get.document), "server_output_json")
    place, time_s, bits_per_s = "intervals", [], []
    for index, interval in enumerate(get.sequence(document.get(place, []), place)):
        where = f"{place}[{index}].sum"
        total = get.mapping(get.mapping(interval, f"{place}[{index}]").get("sum"), where)
        seconds, start_s, end_s = (
            get.number(total.get(key), f"{where}.{key}", "s", 0.0, 1e9) for key in ("seconds", "start", "end")
        )
        rate = get.number(total.get("bits_per_second"), f"{where}.bits_per_second", "bit/s", 0.0, 1e15)
        if seconds > SHORTEST_S:
            time_s.append((start_s + end_s) / 2)
            bits_per_s.append(rate)
    if len(time_s) < 2:
        said = short(get.document.get("error", "nothing"))
        get.faults.add(place, f"{len(time_s)} intervals, needs 2 or more; iperf3 says: {said}")
    get.faults.raise_if_any()
    return Series(name=str(path), time_s=time_s, value=bits_per_s)
