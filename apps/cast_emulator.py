#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""The channel emulator between real radios, protocol stacks and recordings; batch work; control of a running one."""

import argparse
import json
import sys
import threading
from pathlib import Path

import _program
import numpy as np
from gr_cast.core import interrupts
from gr_cast.core.documents import json_text
from gr_cast.core.errors import CastError
from gr_cast.emulation.reference import FixedPoint, noise_power_from_snr
from gr_cast.scenario import load
from gr_cast.signals import on_air, recording
from gr_cast.twin.document import Waveform, read_twin
from gr_cast.twin.playback import Conditions, Playback

_RANGES = {
    "seed": (0, 2**64 - 1, ""),
    "noise_power_db": (-400, 400, "dB"),
    "snr_db": (-400, 400, "dB"),
    "gain_db": (-400, 400, "dB"),
    "threads": (0, 1024, "threads"),
    "report": (0.01, 1e6, "s"),
    "carrier_offset": (-1e12, 1e12, "Hz"),
}


def _noise_power(args) -> float:
    if args.snr_db is not None:
        if args.noise_power_db is not None:
            raise CastError("noise: got --snr-db and --noise-power-db, needs one of them")
        if args.reference_power == "auto":
            return 0.0  # until it is known
        if not 0 < args.reference_power < np.inf:
            raise CastError(f"--reference-power: got {args.reference_power}, needs a finite number above 0")
        return noise_power_from_snr(args.snr_db, args.reference_power)
    return 0.0 if args.noise_power_db is None else 10 ** (args.noise_power_db / 10)


def _fixed_point(args) -> FixedPoint | None:
    if args.fixed_point is None:
        return None
    return FixedPoint(bits=args.fixed_point, input_full_scale=args.full_scale, output_full_scale=args.output_full_scale)


def _told(args) -> dict:
    """What an emulated recording says of its channel."""
    return {"cast:scenario": args.scenario, "core:hw": "channel emulator"}


def _check_rate(rate_hz: float) -> float:
    if not 0 < rate_hz <= 1e9:
        raise CastError(f"--rate: got {rate_hz} samples/s, needs more than 0 and at most 1e9 samples/s")
    return rate_hz


def _level(power: dict) -> str:
    return "silent" if power["mean_db"] is None else f"{power['mean_db']:.1f} (peak {power['peak_db']:.1f}) dB"


def _report(status: dict) -> None:
    print(
        f"\r{status['samples']:>14d} samples  real-time factor {status['real_time_factor']:.2f}  late updates "
        f"{status['late_updates']}  clipped {status['clipped_samples']}  "
        + "".join(f"{port} {_level(power)}  " for port, power in status["power"].items())
        + "".join(f"waiting for {peer}  " for peer in status["waiting_for"])
        + "".join(
            f"{count} {kind.replace('_', ' ')}s at {port}  "
            for port, counts in status["radios"].items()
            for kind, count in counts.items()
            if count
        )
        + "".join(f"{count} samples not finite at {port}, recorded as 0  " for port, count in status["not_finite"].items()),
        end="" if sys.stderr.isatty() else "\n",
        file=sys.stderr,
        flush=True,
    )


def _live_page(args, emulation):
    def view():
        from gr_cast.blocks.newest import EmulatorView

        return EmulatorView(emulation)

    return _program.live_page(args.web, view, f"cast_emulator: {emulation.scenario.name}")


def run(args) -> int:
    """Join the nodes of a scenario to their ports and let samples flow until interrupted or a file ends."""
    from gr_cast.blocks.control import ControlServer
    from gr_cast.blocks.emulation import Emulation
    from gr_cast.blocks.ports import Port
    from gr_cast.core.keys import read_key

    if args.control_key and not args.control:
        raise CastError("--control-key: got no --control ADDRESS that it could guard")
    rate_hz = _check_rate(args.rate)
    ports = [Port.parse(text) for text in args.port]
    defaults = {
        "sample_rate_hz": rate_hz, "center_frequency_hz": args.frequency, "gain_db": args.gain, "antenna": args.antenna,
        "subdevice": args.subdevice, "clock_source": args.clock_source, "time_source": args.time_source,
        "start_at_s": args.start_at,
    }  # fmt: skip
    settings = {(port.node, port.direction): port.radio(defaults) for port in ports if port.kind == "uhd"}
    key = read_key(args.control_key) if args.control_key else None
    with ControlServer(args.control, tuple(args.allow_load), key) as control:
        emulation = Emulation(
            load(args.scenario), ports, rate_hz, noise_power=_noise_power(args),
            snr_db=args.snr_db if args.reference_power == "auto" else None, seed=args.seed,
            fixed_point=_fixed_point(args), settings=settings, n_threads=args.threads, fields=_told(args),
            cycle=args.cycle, device=args.device, precision=args.precision,
        )  # fmt: skip
        bulk = emulation.status()["bulk_delay_samples"]
        if bulk:
            print(f"taps between samples: every link is {bulk} samples late", file=sys.stderr)
        ended = threading.Event()

        def stop() -> None:
            ended.set()
            if size := emulation.recorded_bytes():
                _program.show(f"stopped; sealing {size / 1e6:.3g} MB of recordings", last=True)

        with _live_page(args, emulation), interrupts.heeded(stop), control.obeying(emulation, ended):
            emulation.run_until(ended, _report, args.report)
    _report(emulation.status())
    print(file=sys.stderr)
    return _program.lost(emulation.lost())


def batch(args) -> None:
    """Turn recordings of the transmitters into recordings of the receivers, offline."""
    from gr_cast.blocks.batch import run_batch

    recordings = {}
    for text in args.transmit:
        node, equals, stem = text.partition("=")
        if not (equals and node and stem):
            raise CastError(f"transmit: got {text!r}, needs NODE=RECORDING or NODE=CODE, such as a=glfsr:10")
        if node in recordings:
            raise CastError(f"transmit: node {node} is given twice")
        recordings[node] = stem
    run_batch(
        load(args.scenario), recordings, Path(args.output), rate_hz=args.rate, duration_s=args.duration, receivers=args.receivers,
        chunk_samples=args.chunk, noise_power=_noise_power(args), seed=args.seed, fixed_point=_fixed_point(args), dask=args.dask,
        workers=args.workers, fields=_told(args), cycle=args.cycle,
        device=args.device, precision=args.precision, report=lambda line: print(line, file=sys.stderr),
        progress=lambda done, total: _program.progress("chunks", done, total),
    )  # fmt: skip


def play(args) -> None:
    """Play a twin with its effects, as a diagnosis writes it, and record what its receivers get: also of recordings that
    nobody has made yet, at other powers, on other carriers, of other waveforms, for longer. With --port it plays live."""
    twin = read_twin(args.twin)
    if bool(args.port) == bool(args.output):
        raise CastError("play: needs either --output (recordings) or --port (live)")
    conditions = _conditions(args, twin)
    if args.port:
        _play_live(twin, args.port, conditions)
        return
    observations = {o.name: o for o in twin.observations}
    chosen = args.recording or list(observations)
    faults = [f"--recording: got {name!r}, the twin has {', '.join(observations)}" for name in chosen if name not in observations]
    stems = {name: Path(args.output) / name for name in chosen}
    faults += [
        f"{stem}: a recording of that name exists; nothing is overwritten, choose another folder"
        for stem in stems.values()
        if recording.meta_path(stem).exists()
    ]
    if args.duration is not None and not 0 < args.duration < np.inf:
        faults.append(f"--duration: got {args.duration}, needs more than 0 s")
    if faults:
        raise CastError(*faults)
    playbacks = {}
    for name in chosen:
        o = observations[name]
        playbacks[name] = Playback(twin, o, _count(twin, o, args, conditions), conditions)
    for name, playback in playbacks.items():
        for line in playback.warnings:
            print(f"warning: {name}: {line}", file=sys.stderr)
    for name, playback in playbacks.items():
        stems[name].parent.mkdir(parents=True, exist_ok=True)
        recording.write_stream(
            stems[name], _shown(playback, name), sample_rate_hz=twin.sample_rate_hz,
            center_frequency_hz=args.carrier or observations[name].center_frequency_hz,
            fields=_played(twin, observations[name], args),
        )  # fmt: skip


def _played(twin, observation, args) -> dict:
    """What a played recording says of itself."""
    other = dict(text.split("=", 1) for text in args.transmit)
    told = {
        tx: {"file": str(Path(other[tx]).resolve()), "repeat": False} if tx in other else entry
        for tx, entry in twin.sent(observation).items()
    }
    return {
        "cast:twin": Path(args.twin).name,
        "cast:receiver": observation.receiver,
        "cast:seed": args.seed,
        **on_air.fields(told),
    }


def _conditions(args, twin) -> Conditions:
    """What the arguments change of a twin. Raises CastError, all faults at once."""
    transmitters, faults = twin.transmitters, []
    amplitude, transmit = {}, {}
    for text in args.amplitude:
        node, _, value = text.rpartition("=")
        if node and node not in transmitters:
            faults.append(f"--amplitude: no transmitter {node!r}; the twin has {', '.join(transmitters)}")
        try:
            amplitude |= {name: float(value) for name in ([node] if node else transmitters)}
        except ValueError:
            faults.append(f"--amplitude: got {text!r}, needs NODE=NUMBER or NUMBER")
    for text in args.transmit:
        node, equals, stem = text.partition("=")
        if not equals or node not in transmitters:
            faults.append(f"--transmit: got {text!r}, needs NODE=RECORDING of {', '.join(transmitters)}")
            continue
        taken = recording.read(stem)
        if taken.sample_rate_hz not in (None, twin.sample_rate_hz):
            faults.append(f"--transmit: {stem}: got {taken.sample_rate_hz} samples/s, the twin has {twin.sample_rate_hz:g}")
        transmit[node] = Waveform(name=stem, samples=taken.samples, repeat=False, built_in=False)
    if faults:
        raise CastError(*faults)
    return Conditions(
        amplitude=amplitude, transmit=transmit, center_frequency_hz=args.carrier, carrier_offset_hz=args.carrier_offset,
        gain_db=args.gain_db, noise_power_db=-np.inf if args.no_noise else args.noise_power_db, seed=args.seed,
    )  # fmt: skip


def _play_live(twin, ports: list[str], conditions: Conditions) -> None:
    from gr_cast.blocks.ports import Port
    from gr_cast.blocks.twin import TwinEmulation

    emulation = TwinEmulation(twin, [Port.parse(text) for text in ports], conditions)
    ended = threading.Event()
    with interrupts.heeded(ended.set):
        emulation.run_until(ended)
    for node, count in emulation.not_finite.items():
        print(f"warning: {node}: {count} samples that came were NaN or infinite, taken as 0", file=sys.stderr)


def _count(twin, observation, args, conditions) -> int:
    """Samples to play: as asked for, else a waveform sent once, else 0.1 s."""
    sent = [conditions.transmit.get(tx, twin.waveforms[w]) for tx, (w, _) in observation.on_air.items()]
    if args.duration is None and not any(w.repeat for w in sent):
        return max(len(w.samples) for w in sent)
    return max(1, round((args.duration or 0.1) * twin.sample_rate_hz))


def _shown(playback, name: str):
    """The chunks of a playback, with progress."""
    done = 0
    for chunk in playback.chunks():
        yield chunk
        done += len(chunk)
        _program.progress(f"{name}: samples", done, playback.count)


def ask(args) -> None:
    """Send one command to a running emulator and print its answer."""
    import zmq
    from gr_cast.core.keys import read_key

    get = json_text(args.command, "command")
    get.faults.raise_if_any()
    socket = zmq.Context.instance().socket(zmq.REQ)
    socket.setsockopt(zmq.LINGER, 0)
    if args.control_key:
        read_key(args.control_key).present(socket)
    socket.connect(args.address)
    socket.send_json(get.document)
    if not socket.poll(5000):
        or_else = "its key is not this one" if args.control_key else "it asks for a --control-key"
        raise CastError(f"{args.address}: no answer within 5 s: nobody is there, or {or_else}")
    answer = socket.recv_json()
    print(json.dumps(answer, indent=1))
    if not answer.get("ok"):
        raise CastError(*answer.get("errors", ["refused"]))


def key(args) -> None:
    """Make a key: an emulator with it obeys only who holds it too."""
    from gr_cast.core.keys import write_key

    write_key(args.file)


def _add_device(command) -> None:
    command.add_argument(
        "--device", choices=("cpu", "cuda", "auto"), default="cpu",
        help="what computes the network: this processor, a graphics card by CuPy, or the card while it can",
    )  # fmt: skip
    command.add_argument(
        "--precision",
        choices=("fp32", "tf32"),
        default="fp32",
        help="of the card: errors of -95 dB and less, or of -65 dB, sooner",
    )


def _add_control_key(command) -> None:
    command.add_argument("--control-key", metavar="FILE", help="made by `key`, the same at both ends")


def _add_common(command) -> None:
    command.add_argument("scenario", help="catalogue name or file (YAML, Colosseum .mat, Zarr)")
    command.add_argument(
        "-c", "--cycle", action="store_true", help="begin the scenario again whenever it ends, as colosseumcli rf start -c does"
    )
    command.add_argument("--seed", type=int, default=0, help="of the receivers' noise")
    command.add_argument("--noise-power-db", type=float, help="of every receiver, dB re 1 (samples squared)")
    command.add_argument("--snr-db", type=float, help="noise so far below --reference-power")
    command.add_argument("--fixed-point", type=int, metavar="BITS", help="round and saturate samples as hardware does")
    command.add_argument("--full-scale", type=float, default=1.0, help="of transmitted samples, with --fixed-point")
    command.add_argument("--output-full-scale", type=float, default=1.0, help="of received samples, with --fixed-point")


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser("run", help=run.__doc__, description=run.__doc__)
    _add_common(command)
    command.add_argument("--rate", type=_program.rate, required=True, help="samples/s of every port")
    command.add_argument(
        "--reference-power", type=lambda text: text if text == "auto" else float(text), default=1.0, metavar="POWER|auto",
        help="in units of the samples squared; auto: the loudest transmitter's in the first second it sends (default 1)",
    )  # fmt: skip
    command.add_argument(
        "--port", action="append", default=[], metavar="NODE:tx|rx=KIND:WHERE",
        help="zmq:ADDRESS (as srsRAN's radio), pubsub:ADDRESS, file:STEM, uhd:ARGS (with frequency=, gain=, antenna=, "
        "subdevice=, clock_source=, time_source=, start_at= of its own), null; repeat for every port",
    )  # fmt: skip
    command.add_argument("--control", metavar="ADDRESS", help="answer JSON commands there, such as tcp://*:5555")
    _add_control_key(command)
    command.add_argument(
        "--allow-load", action="append", type=Path, default=[], metavar="DIR",
        help="whose scenarios `load` may take from another machine, beside the catalogue; repeat",
    )  # fmt: skip
    command.add_argument("--frequency", type=_program.carrier, help="carrier of uhd ports in Hz")
    command.add_argument("--gain", type=float, default=0.0, help="of uhd ports in dB")
    command.add_argument("--antenna", default="", help="of uhd ports; empty: the device's default")
    command.add_argument("--subdevice", default="", help="of uhd ports; empty: the device's default")
    command.add_argument("--clock-source", default="internal", help="of uhd ports: internal, external, gpsdo")
    command.add_argument("--time-source", default="internal", help="of uhd ports: internal, external, gpsdo")
    command.add_argument(
        "--start-at", type=_program.second, metavar="TIME", help="timed start of uhd ports: Unix seconds or ISO 8601 with a zone"
    )
    _program.add_web(command)
    _add_device(command)
    command.add_argument("--threads", type=int, default=0, help="0: one per core")
    command.add_argument("--report", type=float, default=5.0, help="seconds between status lines")
    command.set_defaults(function=run)

    command = commands.add_parser("batch", help=batch.__doc__, description=batch.__doc__)
    _add_common(command)
    command.add_argument("--reference-power", type=float, default=1.0, help="in units of the samples squared")
    command.add_argument(
        "--transmit", action="append", default=[], metavar="NODE=RECORDING|CODE", required=True,
        help="what a node sends: a SigMF recording, or a code again and again, such as a=glfsr:10; repeat for every node",
    )  # fmt: skip
    command.add_argument("--rate", type=_program.rate, metavar="HZ", help="samples/s, where all nodes send codes")
    command.add_argument("--duration", type=float, metavar="S", help="default: as long as the longest recording")
    command.add_argument("--output", required=True, help="folder of the received recordings")
    command.add_argument("--receivers", nargs="+", help="nodes to receive; all without it")
    command.add_argument("--chunk", type=int, default=1 << 20, help="samples that one worker does at a time")
    _add_device(command)
    command.add_argument("--workers", type=int, default=1, help="processes on this machine")
    command.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler, such as tcp://host:8786")
    command.set_defaults(function=batch)

    command = commands.add_parser("play", help=play.__doc__.split(",")[0], description=play.__doc__)
    command.add_argument("--twin", required=True, metavar="FILE", help="twin.yaml or twin_corrected.yaml")
    command.add_argument("--output", metavar="DIR", help="folder of the played recordings")
    command.add_argument(
        "--port", action="append", default=[], metavar="NODE:tx|rx=KIND:WHERE",
        help="play live: zmq:ADDRESS, pubsub:ADDRESS, file:STEM, null; repeat for every port",
    )  # fmt: skip
    command.add_argument("--recording", action="append", metavar="NAME", help="of the twin's recordings; all without it")
    command.add_argument("--duration", type=float, metavar="S", help="default: a waveform sent once, else 0.1 s")
    command.add_argument(
        "--amplitude", action="append", default=[], metavar="[NODE=]A", help="of a transmitter, or of all, for the twin's own"
    )
    command.add_argument(
        "--transmit", action="append", default=[], metavar="NODE=RECORDING", help="sent once, for the twin's own waveform"
    )
    command.add_argument(
        "--carrier", type=_program.carrier, metavar="HZ", help="another carrier: offsets and Dopplers grow with it"
    )
    command.add_argument(
        "--carrier-offset", type=float, default=0.0, metavar="HZ", help="the transmitter tuned so far from the receiver"
    )
    command.add_argument("--gain-db", type=float, help="of the receiver; without it as measured by the diagnosis, else 0 dB")
    command.add_argument("--noise-power-db", type=float, help="for the twin's own, dB re 1 (samples squared)")
    command.add_argument("--no-noise", action="store_true", help="no noise and no random interference")
    command.add_argument("--seed", type=int, default=0, help="of noise, phase noise and fading")
    command.set_defaults(function=play)

    command = commands.add_parser("ask", help=ask.__doc__, description=ask.__doc__)
    command.add_argument("address", help="of the emulator's --control, such as tcp://localhost:5555")
    command.add_argument("command", help='JSON, such as {"command": "status"}')
    _add_control_key(command)
    command.set_defaults(function=ask)

    command = commands.add_parser("key", help=key.__doc__, description=key.__doc__)
    command.add_argument("file", help="to write; only this user may read it")
    command.set_defaults(function=key)

    argv = sys.argv[1:] if argv is None else argv
    args = _program.parse(parser, ["play", *argv] if "--twin" in argv[:1] else argv)
    _program.check_ranges(args, _RANGES)
    return args.function(args) or 0


if __name__ == "__main__":
    _program.run(main)
