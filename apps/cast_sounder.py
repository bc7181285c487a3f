#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Sound a radio channel: over the embedded emulator, with X310s, or from a recording."""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import _program
import numpy as np
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.figures import fixed
from gr_cast.core.files import check_writable, write_json, write_text
from gr_cast.core.units import db_from_amplitude
from gr_cast.experiments import paper
from gr_cast.signals import on_air, recording
from gr_cast.signals.waveform import entry_from_text, waveform_from_entry
from gr_cast.sounding import calibration, code_comparison, collect, flight, path_loss, result, transmission_log
from gr_cast.sounding.sound import LinkBudget, SoundingOptions, sound

_RANGES = {
    "seed": (0, 2**64 - 1, ""),
    "noise": (-400, 400, "dB"),
    "offset": (-1e12, 1e12, "Hz"),
    "max_spread": (0, 0.1, "s"),
}


def _arguments() -> argparse.ArgumentParser:
    output = argparse.ArgumentParser(add_help=False)
    output.add_argument("--output", default="sounding", metavar="DIR", help="folder for the result")

    code = argparse.ArgumentParser(add_help=False)
    code.add_argument(
        "--code", help="glfsr:8, gold:127, gold_paper, ga128, gb128, ls, zadoff_chu:255:1, file:STEM (run: by rate)"
    )
    code.add_argument("--samples-per-chip", type=int, default=1, metavar="N")
    code.add_argument("--once", action="store_true", help="the waveform of file:STEM is sent once, not repeated")

    estimate = argparse.ArgumentParser(add_help=False)
    estimate.add_argument("--average", type=int, default=0, metavar="K", help="code periods per frame; 0 chooses")
    estimate.add_argument("--false-alarm-rate", type=float, default=1e-3, metavar="P", help="false alarms per CIR")
    estimate.add_argument("--max-taps", type=int, default=32, metavar="N")
    estimate.add_argument(
        "--max-offset", type=float, metavar="HZ", help="carrier offset searched; default 10 ppm, 25 kHz at least"
    )
    estimate.add_argument("--no-offset-correction", action="store_true")
    estimate.add_argument(
        "--carrier-offset",
        type=float,
        metavar="HZ",
        help="known, 0 for radios on one clock: what turns beyond it is Doppler; default: the recording's own, else estimated",
    )
    estimate.add_argument("--max-spread", type=float, default=5.12e-6, metavar="S", help="longest excess delay expected")
    estimate.add_argument(
        "--band-share", type=float, metavar="SHARE", help="of the band that is looked at; default: the recording's own, else 1"
    )
    estimate.add_argument("--tx-power", type=float, metavar="DBM", help="transmitted at full scale and 0 dB of gain")
    estimate.add_argument(
        "--tx-amplitude", type=float, metavar="A", help="of full scale, as tx --amplitude; default: the recording's own, else 1"
    )
    estimate.add_argument("--tx-gain", type=float, metavar="DB", help="default: the recording's own, else 0")
    estimate.add_argument("--rx-gain", type=float, metavar="DB", help="default: the recording's own, else 0")
    estimate.add_argument("--rx-full-scale", type=float, metavar="DBM", help="full scale at 0 dB of receive gain")
    estimate.add_argument(
        "--base-loss", default="0", metavar="DB|NAME[@V]", help="taken off: dB, or a calibration, which also knows delays"
    )

    radio = argparse.ArgumentParser(add_help=False)
    radio.add_argument("--args", default="", help="UHD device arguments, such as addr=192.168.40.2")
    radio.add_argument("--rate", type=_program.rate, default=1e6, metavar="HZ")
    radio.add_argument("--frequency", type=_program.carrier, default=1e9, metavar="HZ")
    radio.add_argument("--gain", type=float, default=0.0, metavar="DB")
    radio.add_argument("--antenna", default="", help="TX/RX, RX2; empty: the device's default")
    radio.add_argument("--subdevice", default="", help="A:0, B:0; empty: the device's default")
    radio.add_argument("--clock-source", default="internal", help="internal, external or gpsdo")
    radio.add_argument("--time-source", default="internal", help="internal, external or gpsdo")
    radio.add_argument(
        "--start-at",
        type=_program.second,
        metavar="TIME",
        help="timed start: Unix seconds or ISO 8601 with a zone, alike at both ends",
    )
    radio.add_argument("--duration", type=float, metavar="S", help="default: until Ctrl-C")
    radio.add_argument("--node", default="", help="name of this node, kept in the recording")

    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name, help, *parents):
        return commands.add_parser(name, help=help, description=help, parents=list(parents))

    run = command("run", "sound a scenario over the embedded emulator: no radio (the default command)", code, estimate, output)
    run.add_argument("--scenario", default="four_tap", help="catalogue id or file")
    run.add_argument("--at", type=float, default=0.0, metavar="S", help="of the scenario, at which the recording begins")
    run.add_argument("--link", metavar="TX>RX", help="default: the scenario's first link")
    run.add_argument("--all-links", action="store_true", help="every link of the scenario, and their heat map")
    run.add_argument("--rate", type=_program.rate, default=50e6, metavar="HZ")
    run.add_argument("--frames", type=int, default=1500, metavar="N", help="frames to record, of --average periods each")
    run.add_argument("--noise", type=float, default=-100.0, metavar="DB", help="receiver noise per sample, re full scale")
    run.add_argument("--offset", type=float, default=0.0, metavar="HZ", help="carrier offset to emulate")
    run.add_argument("--seed", type=int, default=1)

    tx = command("tx", "send a code with an X310", code, radio)
    tx.add_argument("--amplitude", type=float, default=0.5, help="of full scale")
    tx.add_argument(
        "--log", metavar="FILE", help="when it began, and every underrun with its time, as JSON; rx --tx-log reads it"
    )
    tx.add_argument(
        "--restart-aligned", action="store_true", help="after an underrun begin anew in phase: at a whole number of code periods"
    )

    rx = command("rx", "record with an X310, then sound the recording", code, radio, estimate, output)
    rx.add_argument("--transmitter", default="", help="name of the node that sends, kept in the recording")
    rx.add_argument("--format", default="cf32", choices=["cf32", "ci16"], help="samples on disk")
    rx.add_argument("--record-only", action="store_true")
    _program.add_web(rx)
    rx.add_argument("--tx-log", metavar="FILE", help="the transmitter's --log: its underruns go to the metadata")

    process = command("process", "sound a recording: SigMF, or raw samples with their rate", code, estimate, output)
    process.add_argument("recording")
    process.add_argument("--rate", type=_program.rate, metavar="HZ", help="of raw samples; SigMF brings its own")
    process.add_argument("--format", choices=list(recording.RAW_FORMATS), help="of raw samples")

    heatmap = command("heatmap", "path loss of many recordings as a matrix", code, estimate, output)
    heatmap.add_argument("recordings", nargs="+")

    calibrate = command("calibrate", "base loss per link from recordings of a 0 dB scenario", code, estimate, output)
    calibrate.add_argument("recordings", nargs="+")
    calibrate.add_argument("--name", required=True, help="what --base-loss will call it")

    gather = command("collect", "results of soundings to a campaign of a place case: responses of many links in one .npz")
    gather.add_argument(
        "results",
        nargs="+",
        metavar="RESULT",
        help="folder of a sounding, its result.json, or results/*.json of a heatmap or --all-links",
    )
    gather.add_argument("--output", required=True, metavar="FILE.npz")
    gather.add_argument("--frequencies", type=int, default=collect.FREQUENCIES, metavar="K")
    gather.add_argument("--band", type=float, metavar="HZ", help="round the carrier; default: the band that was sounded")
    gather.add_argument("--from", dest="begin", type=_program.second, metavar="TIME", help="what times count from; default: 0")

    command("codes", "compare code sequences as the paper does, table and picture", output)
    devices = command("devices", "list the radios that UHD finds")
    devices.add_argument("--args", default="")
    return parser


def _spec_and_waveform(args, metadata: dict):
    """The waveform of --code, or the one that the recording names."""
    if args.code is None:
        spec = on_air.only_waveform(metadata, str(getattr(args, "recording", None) or "recording"))
        return spec, waveform_from_entry(spec)
    if args.once and not args.code.startswith("file:"):
        raise CastError("--once: goes with --code file:STEM; built-in codes repeat")
    spec = entry_from_text(args.code, samples_per_chip=args.samples_per_chip, repeat=not args.once)
    return spec, waveform_from_entry(spec)


def _options(args, metadata: dict, base_loss_db: float) -> SoundingOptions:
    def known(argument, field, default=0.0):
        value = argument if argument is not None else metadata.get(f"cast:{field}", default)
        if value is None:
            return None
        if not isinstance(value, (int, float)) or not np.isfinite(value):
            raise CastError(f"{field}: got {value!r}, needs a finite number")
        return float(value)

    amplitude = known(args.tx_amplitude, "tx_amplitude", 1.0)
    if not 0 < amplitude <= 1:
        raise CastError(f"tx_amplitude: got {amplitude}, needs more than 0 and at most 1 (full scale)")
    return SoundingOptions(
        average=args.average,
        false_alarm_rate=args.false_alarm_rate,
        max_taps=args.max_taps,
        max_offset_hz=args.max_offset,
        correct_offset=not args.no_offset_correction,
        carrier_offset_hz=known(args.carrier_offset, "carrier_offset_hz", None),
        max_spread_s=args.max_spread,
        band=known(args.band_share, "band", 1.0),
        budget=LinkBudget(
            tx_power_dbm=known(args.tx_power, "tx_power_dbm") + float(db_from_amplitude(amplitude)),
            tx_gain_db=known(args.tx_gain, "tx_gain_db"),
            rx_gain_db=known(args.rx_gain, "rx_gain_db"),
            rx_full_scale_dbm=known(args.rx_full_scale, "rx_full_scale_dbm"),
            base_loss_db=base_loss_db,
        ),
    )


def _base(args, file: recording.Recording, path) -> tuple[float, float | None]:
    """Loss in dB and delay in s, None where it is not known, that the set-up adds to a recording."""
    chosen = calibration.load(args.base_loss)
    if chosen.default_db is not None:
        return chosen.default_db, None
    link = path_loss.link_of(file, Path(path).name)
    return chosen.of(link), chosen.base_delay_s.get(link)


def _read(path, raw_format=None, rate=None) -> recording.Recording:
    if raw_format is None and rate is None and (recording.meta_path(path).is_file() or not Path(path).is_file()):
        return recording.read(path)
    if recording.meta_path(path).is_file():
        file = recording.read(path)
        if raw_format is not None:
            raise CastError(f"{path}: --format: is for raw samples, this recording is SigMF")
        if rate is not None and file.sample_rate_hz is not None and abs(rate / file.sample_rate_hz - 1) > 1e-9:
            raise CastError(f"{path}: --rate: got {rate:g} Hz, the recording says {file.sample_rate_hz:g} Hz")
        return file if rate is None else replace(file, sample_rate_hz=rate)  # SigMF may leave the rate out
    if raw_format is None or rate is None:
        formats = "|".join(recording.RAW_FORMATS)
        raise CastError(f"{path}: raw samples (no {recording.meta_path(path).name} beside it): add --format {formats} --rate HZ")
    return recording.read_raw(path, raw_format=raw_format, sample_rate_hz=rate)


def _sounded(args, file: recording.Recording, path, spec: dict, waveform) -> tuple:
    """One recording's sounding, and the content of its result.json."""
    base_loss_db, base_delay_s = _base(args, file, path)
    options = _options(args, file.metadata, base_loss_db)
    sounding = sound(file, waveform, options)
    about = {"recording": str(path), "waveform": spec, "base_loss": args.base_loss}
    document = result.as_document(sounding, about | result.about_recording(file, Path(path).name, spec, options))
    return sounding, flight.told(document, file, waveform.repeat, base_delay_s)


def _sound_file(args, file: recording.Recording, path, modelled_taps=()) -> dict:
    """Sound one recording and leave result.json, frames.csv and cir.png in --output; returns the document."""
    from gr_cast.report import plot

    spec, waveform = _spec_and_waveform(args, file.metadata)
    sounding, document = _sounded(args, file, path, spec, waveform)
    folder = result.output_folder(args.output)
    rate_mhz = f"{file.sample_rate_hz / 1e6:g} MS/s"
    title = f"{recording.stem_of(path).name}: {waveform.name} at {rate_mhz}, {sounding.frames} frames"
    plot.save(plot.sounding_figure(sounding, title, modelled_taps), folder / "cir.png")
    result.write_sounding(folder, sounding, document)
    print(result.as_table(document))
    if document["frame_std_db"] and file.metadata.get("cast:scenario") == "four_tap" and len(document["taps"]) == 4:
        told, own = paper.figures()["four_taps"], document["frame_std_db"]
        for which in ("strongest", "weakest"):
            print(f"SD of the {which} tap over the frames: {own[which]:.2g} dB; the paper: {told[which + '_tap_sd_db']:g} dB")
    print(f"\nwritten: {folder}/result.json, frames.csv, cir.png")
    return document


def _run(args) -> None:
    from gr_cast import scenario as scenarios
    from gr_cast.blocks.flowgraphs import EmulatedSounding, waveform_source

    if not 0 < args.rate < np.inf:
        raise CastError(f"--rate: got {args.rate:g} Hz, needs more than 0 Hz")
    args.code = args.code or _long_enough(args.rate, args.max_spread)
    spec, waveform = _spec_and_waveform(args, {})
    if not waveform.repeat:
        raise CastError("run: sounds repeated waveforms; drop --once")
    if args.frames < 1:
        raise CastError(f"--frames: got {args.frames}, needs 1 or more")
    scenario = scenarios.load(args.scenario)
    links = _links(args, scenario)
    _options(args, {}, 0.0)
    folder = result.output_folder(args.output)
    records = folder / "recordings"
    records.mkdir(exist_ok=True)
    args.average = args.average or 1
    period = len(waveform.samples)
    n_samples = args.frames * args.average * period
    settle_samples = period * int(np.ceil(args.max_spread * args.rate / period))
    moved = scenarios.begun_at(scenario, args.at, held_s=settle_samples / args.rate)
    stems = {link: records / f"tx{link[0]}_rx{link[1]}" for link in links}
    for stem in stems.values():  # an emulated recording can be made again: the newest run replaces the last
        recording.data_path(stem).unlink(missing_ok=True)
        recording.meta_path(stem).unlink(missing_ok=True)
    fields = {"cast:waveform": spec, "cast:scenario": args.scenario, "cast:scenario_at_s": args.at,
              "cast:noise_power_db": args.noise, "cast:seed": args.seed,
              "cast:emulated_offset_hz": args.offset,
              "core:hw": "embedded emulator"}  # fmt: skip
    if not scenario.is_static:  # the emulator knows its carrier: what moving nodes turn is Doppler
        fields["cast:carrier_offset_hz"] = args.offset
    began = time.monotonic()
    for transmitter in sorted({tx for tx, _ in links}, key=path_loss.natural_order):
        heard = {rx: stems[(tx, rx)] for tx, rx in links if tx == transmitter}
        top = EmulatedSounding(
            moved, transmitter, heard, waveform_source(waveform, spec), sample_rate_hz=args.rate, n_samples=n_samples,
            settle_samples=settle_samples, noise_power_db=args.noise, offset_hz=args.offset, seed=args.seed, fields=fields,
        )  # fmt: skip
        look = _program.patient("samples", lambda top=top: top.samples, n_samples * len(heard))
        try:
            _until_done(top, f"node {transmitter} sends, {len(heard)} listen", look=look)
            look()
        finally:
            top.finish()
    emulated_s = len({tx for tx, _ in links}) * (settle_samples + n_samples) / args.rate
    took_s = time.monotonic() - began
    print(f"emulated {emulated_s * 1e3:.4g} ms of radio time in {took_s:.2f} s ({emulated_s / took_s:.3g} × real time)")
    if args.all_links:
        _heatmap(args, list(stems.values()))
        return
    gain = scenarios.played_gain(scenario, links[0])[0]
    delays = scenario.links[links[0]].delay_s[0]
    modelled = [(d, 20 * np.log10(abs(g))) for d, g in zip(delays, gain, strict=True) if g != 0]
    _sound_file(args, recording.read(stems[links[0]]), stems[links[0]], modelled)


def _long_enough(rate_hz: float, spread_s: float) -> str:
    """The shortest GLFSR, of 255 chips or more, that lasts as long as echoes may come."""
    return next((f"glfsr:{degree}" for degree in range(8, 16) if (2**degree - 1) / rate_hz >= spread_s), "glfsr:16")


def _links(args, scenario) -> list[tuple[str, str]]:
    if args.all_links:
        return list(scenario.links)
    if args.link is None:
        return [next(iter(scenario.links))]
    link = tuple(args.link.split(">"))
    if link not in scenario.links:
        shown = ", ".join(f"{tx}>{rx}" for tx, rx in list(scenario.links)[:8])
        quote = "" if len(link) > 1 else "needs TX>RX in quotes, for a shell takes > for itself; "
        more = ", …" if len(scenario.links) > 8 else ""
        raise CastError(f"--link: got {args.link!r}, {quote}{scenario.name} has {shown}{more}")
    return [link]


def _until_done(top, what: str, first_s: float = 0.0, look=lambda: None) -> None:
    """Run a flowgraph to its end; Ctrl-C or SIGTERM ends it early and keeps what was recorded."""
    from gr_cast.blocks.running import run_to_end

    print(what, flush=True)
    with interrupts.heeded(top.stop) as stopped:
        run_to_end(top, lambda: top.samples, first_s=first_s, stopped=stopped, look=look)
    if stopped.is_set():
        print("stopped early; a recording holds what came until now", file=sys.stderr)
        raise KeyboardInterrupt


def _wait_s(args) -> float:
    return 0.0 if args.start_at is None else max(0.0, args.start_at - time.time())


def _radio_settings(args):
    from gr_cast.blocks.usrp import RadioSettings

    return RadioSettings(
        sample_rate_hz=args.rate, center_frequency_hz=args.frequency, gain_db=args.gain, antenna=args.antenna,
        subdevice=args.subdevice, device_args=args.args, clock_source=args.clock_source, time_source=args.time_source,
        start_at_s=args.start_at,
    )  # fmt: skip


def _sample_count(args) -> int | None:
    if args.duration is None:
        return None
    if not 0 < args.duration < np.inf:
        raise CastError(f"--duration: got {args.duration} s, needs a finite number above 0")
    return max(1, round(args.duration * args.rate))


def _tx(args) -> int:
    from gr_cast.blocks.flowgraphs import UsrpTransmitter
    from gr_cast.blocks.radio_events import summary

    args.code = args.code or "glfsr:8"
    spec, waveform = _spec_and_waveform(args, {})
    if not 0 < args.amplitude <= 1:
        raise CastError(f"--amplitude: got {args.amplitude}, needs more than 0 and at most 1 (full scale)")
    if not np.isfinite(waveform.samples).all():
        raise CastError(f"{waveform.name}: holds NaN; only waveforms known throughout can be sent")
    settings, n_samples = _radio_settings(args), _sample_count(args)
    if args.restart_aligned and not waveform.repeat:
        raise CastError("--restart-aligned: goes with a repeated waveform; drop --once")
    if args.log:
        check_writable(Path(args.log).parent)
    top = UsrpTransmitter(settings, waveform, amplitude=args.amplitude, n_samples=n_samples, restart_aligned=args.restart_aligned)
    about = {"waveform": spec, "sample_rate_hz": args.rate, "center_frequency_hz": args.frequency,
             "time_axis": _time_axis(args)}  # fmt: skip
    written = None  # how many events the log holds

    def write_log(is_last: bool = False) -> None:
        nonlocal written
        events = top.events.events
        if args.log and (is_last or len(events) != written):
            transmission_log.write(args.log, about, start_s=top.transmission.start_s, samples=top.samples,
                                   restarts=top.transmission.restarts, events=events)  # fmt: skip
            written = len(events)

    try:
        _until_done(top, f"sending {waveform.name} at {args.frequency / 1e6:g} MHz, {args.rate / 1e6:g} MS/s; Ctrl-C ends",
                    _wait_s(args), write_log)  # fmt: skip
    except KeyboardInterrupt:
        interrupts.settled()
        if args.duration is not None:
            raise
    finally:
        write_log(is_last=True)
    return _program.lost([f"radio: {words}"] if (words := summary(top.events.counts, top.events.events)) else [])


def _time_axis(args) -> str:
    return "device" if args.start_at is None else "utc"


def _live_page(args, top, waveform):
    def view():
        from gr_cast.blocks.newest import ReceiverView

        return ReceiverView(top, waveform, args.rate)

    return _program.live_page(args.web, view, "cast_sounder: rx")


def _rx(args) -> int:
    from gr_cast.blocks.flowgraphs import UsrpReceiver

    args.code = args.code or "glfsr:8"
    spec, waveform = _spec_and_waveform(args, {})
    settings, n_samples = _radio_settings(args), _sample_count(args)
    fields = {"cast:waveform": spec, "cast:transmitter": args.transmitter, "cast:receiver": args.node,
              "cast:rx_gain_db": args.gain,
              "cast:time_axis": _time_axis(args),
              "cast:clock_source": args.clock_source, "cast:time_source": args.time_source, "cast:antenna": args.antenna,
              "cast:subdevice": args.subdevice,
              "core:hw": f"USRP by UHD, arguments {args.args!r}"}  # fmt: skip
    told = {
        "cast:tx_gain_db": args.tx_gain,
        "cast:tx_amplitude": args.tx_amplitude,
        "cast:tx_power_dbm": args.tx_power,
        "cast:rx_full_scale_dbm": args.rx_full_scale,
        "cast:start_at_s": args.start_at,
    }
    fields |= {field: value for field, value in told.items() if value is not None}
    stem = Path(args.output) / "recording"
    check_writable(stem.parent)
    datatype = recording.RAW_FORMATS[args.format]
    top = UsrpReceiver(settings, stem, n_samples=n_samples, datatype=datatype, fields=fields)
    sent = []
    try:
        try:
            with _live_page(args, top, waveform):
                _until_done(
                    top, f"recording at {args.frequency / 1e6:g} MHz, {args.rate / 1e6:g} MS/s; Ctrl-C ends", _wait_s(args)
                )
        except KeyboardInterrupt:
            interrupts.settled()
            if args.duration is not None:
                raise
        if args.tx_log:
            sent = transmission_log.events(args.tx_log, -np.inf if args.start_at is None else args.start_at)
    finally:
        top.finish({"cast:transmit_events": sent} if sent else None)
    if not args.record_only:
        _sound_file(args, recording.read(stem), stem)
    gaps = top.recorder.gaps
    lost = [f"radio: {gaps.count} gaps, {gaps.lost_samples} samples"] if gaps.count else []
    return _program.lost(lost + ([f"transmitter: {len(sent)} underruns and late packets"] if sent else []))


def _process(args) -> None:
    _sound_file(args, _read(args.recording, args.format, args.rate), args.recording)


def _losses(args, paths) -> tuple[dict[tuple[str, str], list[float | None]], float, dict[str, dict]]:
    """Path losses of every link, the largest standard deviation of one, and each recording's result by its name."""
    losses: dict[tuple[str, str], list[float | None]] = {}
    results = {}
    largest_std_db = 0.0
    for count, path in enumerate(paths, 1):
        file = recording.read(path)
        sounding, document = _sounded(args, file, path, *_spec_and_waveform(args, file.metadata))
        results[recording.stem_of(path).name] = document
        losses.setdefault(path_loss.link_of(file, Path(path).name), []).append(sounding.path_loss_db)
        largest_std_db = max(largest_std_db, sounding.path_gain_std_db or 0.0)
        _program.progress("recordings", count, len(paths))
    return losses, largest_std_db, results


def _heatmap(args, paths) -> None:
    from gr_cast.report import plot

    losses, error_db, results = _losses(args, paths)
    nodes, matrix = path_loss.loss_matrix(losses)
    folder = result.output_folder(args.output)
    for name, document in results.items():
        write_json(result.output_folder(folder / "results") / f"{name}.json", document)
    title = f"Path loss of {int(np.isfinite(matrix).sum())} links, {len(paths)} recordings"
    plot.save(plot.heatmap_figure(matrix, nodes, title, error_db), folder / "heatmap.png")
    write_text(folder / "heatmap.csv", path_loss.matrix_csv(nodes, matrix))
    rows = [[float(value) if np.isfinite(value) else None for value in row] for row in matrix]
    heard = matrix[np.isfinite(matrix)]
    mean = float(np.mean(heard)) if len(heard) else None
    std = float(np.std(heard)) if len(heard) > 1 else None
    about = {"mean_db": mean, "std_db": std, "largest_error_db": error_db}
    write_json(folder / "heatmap.json", {"nodes": nodes, "path_loss_db": rows, **about})
    print(path_loss.matrix_text(nodes, matrix))
    known = f"each known to {max(error_db, path_loss.LEAST_ERROR_DB):.2f} dB or better"
    print(f"{path_loss.average_text(heard, error_db)}, {known}" if len(heard) else "no link was heard")
    print(f"written: {folder}/heatmap.json, heatmap.csv, heatmap.png, results/")


def _calibrate(args) -> None:
    losses, error_db, results = _losses(args, args.recordings)
    nodes, matrix = path_loss.loss_matrix(losses)
    unheard = [f"{tx}>{rx}" for tx, rx in losses if not np.isfinite(matrix[nodes.index(tx), nodes.index(rx)])]
    if unheard:
        raise CastError(f"calibrate: no signal on {', '.join(unheard)}: base loss unknown, nothing stored")
    measured = {(tx, rx): float(matrix[nodes.index(tx), nodes.index(rx)]) for tx, rx in losses}
    of_link = {link: [one for one in results.values() if (one["transmitter"], one["receiver"]) == link] for link in losses}
    delays_s = {link: delay_s for link, ones in of_link.items() if (delay_s := flight.base_delay_s(ones)) is not None}
    path = calibration.save(
        calibration.Calibration(name=args.name, base_loss_db=measured, base_delay_s=delays_s),
        {"recordings": [str(path) for path in args.recordings]},
    )
    values = np.array(list(measured.values()))
    print(f"base loss: {path_loss.average_text(values, error_db)}; stored as {path}")
    if delays_s:
        late_us = 1e6 * np.array(list(delays_s.values()))
        print(
            f"base delay {late_us.mean():.4f} µs, SD {late_us.std():.4f} µs over the {len(late_us)} that began at a second of UTC"
        )
    print(f"use it with --base-loss {args.name} (newest) or {args.name}@{path.stem[1:]}")


def _collect(args) -> None:
    snapshots, faults = [], []
    for path in args.results:
        try:
            snapshots.append(collect.read(path))
        except CastError as error:
            faults += error.faults
    if faults:
        raise CastError(*faults)
    begin_s = args.begin or 0.0
    snapshots = [replace(one, time_s=one.time_s - begin_s) for one in snapshots]
    arrays = collect.campaign(snapshots, collect.frequencies_hz(snapshots, args.frequencies, args.band))
    collect.write(args.output, arrays)
    links, instants, count = arrays["response"].shape
    heard = np.isfinite(arrays["response"][:, :, 0]).sum()
    print(
        f"{args.output}: {links} links, {instants} instants, {count} frequencies, {heard} of {links * instants} responses heard"
    )


def _codes(args) -> None:
    from gr_cast.report import plot

    rows = code_comparison.compare()
    print(f"{'code':<18}{'':<12}{'chips':>6}{'peaks every':>14}{'sidelobe, closed form':>24}{'alone':>10}{'30 dB link':>12}")
    for row in rows:
        origin = "published" if row["published"] else "fair"
        levels = [row[f"{which}_sidelobe_db"] for which in ("periodic", "alone", "link")]
        shown = ["none" if level is None else f"{fixed(level, 1)} dB" for level in levels]
        print(
            f"{row['name']:<18}{origin:<12}{row['length']:>6}{row['peak_spacing_s'] * 1e6:>11.0f} µs"
            f"{shown[0]:>24}{shown[1]:>10}{shown[2]:>12}"
        )
    print('gold_paper, the paper\'s "Gold 255", is the Gold code of 63 chips cut at 255: it nearly repeats every 63 chips.')
    folder = result.output_folder(args.output)
    plot.save(plot.codes_figure(rows), folder / "codes.png")
    curves = ("time_us", "alone_db", "link_db")
    write_json(folder / "codes.json", [{key: value for key, value in row.items() if key not in curves} for row in rows])
    print(f"written: {folder}/codes.json, codes.png")


def _devices(args) -> None:
    import uhd  # cannot share a process with gnuradio.uhd

    found = uhd.find(args.args)
    if not found:
        raise CastError(
            f"devices: no USRP answers to arguments {args.args!r}: is it on, and in this network? One beyond it is found by "
            "--args addr=192.168.40.2"
        )
    for device in found:
        print(device.to_string() if hasattr(device, "to_string") else device)


COMMANDS = {
    "run": _run,
    "tx": _tx,
    "rx": _rx,
    "process": _process,
    "heatmap": lambda args: _heatmap(args, args.recordings),
    "calibrate": _calibrate,
    "collect": _collect,
    "codes": _codes,
    "devices": _devices,
}


def main(argv=None) -> int:
    argv = sys.argv[1:] if argv is None else argv
    if not argv or (argv[0].startswith("-") and argv[0] not in ("-h", "--help", "--version")):
        argv = ["run", *argv]
    args = _program.parse(_arguments(), argv)
    _program.check_ranges(args, _RANGES)
    return COMMANDS[args.command](args) or 0


if __name__ == "__main__":
    _program.run(main)
