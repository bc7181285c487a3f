#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A worked example: a twin that looks right, a cause found in it, and a recording foretold that nobody has made yet.

A QPSK link is recorded at one transmit power. The world is GNU Radio's: a third-order distortion from gr-channels, a
two-path FIR filter, Gaussian noise. The twin knows the paths and the noise, and nothing of the amplifier. Its EVM and
its residual power are those of the noise, to a tenth of a dB. The diagnosis names the amplifier; then both twins
foretell a recording at more power, which is made afterwards.

    docs/examples/amplifier.py FOLDER          writes everything there, prints the figures, draws amplifier.png
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "build" / "python"))
from gnuradio import analog, blocks, channels, filter, gr
from gnuradio.filter import firdes
from gr_cast.report.plot import new_figure, save
from gr_cast.signals import recording

RATE_HZ, SAMPLES_PER_SYMBOL, SYMBOLS, COUNT = 4e6, 4, 500, 40_000
PATHS = [1.0, 0.0, 0.0, 0.3j]  # one tap per sample
BEND = -0.015  # y = x + BEND·x|x|²
NOISE_POWER = 10**-2.5
MORE_POWER = 2.5  # amplitude of the recording that is foretold; the one that is diagnosed has 1


def waveform() -> np.ndarray:
    """One period of root-raised-cosine QPSK, by GNU Radio's own filter."""
    symbols = np.exp(0.25j * np.pi * (1 + 2 * np.random.default_rng(1).integers(0, 4, SYMBOLS)))
    taps = firdes.root_raised_cosine(SAMPLES_PER_SYMBOL, SAMPLES_PER_SYMBOL, 1.0, 0.25, 20 * SAMPLES_PER_SYMBOL + 1)
    shaped = through(np.tile(symbols, 3), filter.interp_fir_filter_ccf(SAMPLES_PER_SYMBOL, taps))
    period = shaped[SYMBOLS * SAMPLES_PER_SYMBOL :][: SYMBOLS * SAMPLES_PER_SYMBOL]
    return period / np.sqrt(np.mean(np.abs(period) ** 2))


def through(samples: np.ndarray, *chain) -> np.ndarray:
    """Samples through GNU Radio blocks."""
    top, source, sink = gr.top_block(), blocks.vector_source_c(samples.tolist()), blocks.vector_sink_c()
    top.connect(source, *chain, sink)
    top.run()
    return np.array(sink.data())


def world(x: np.ndarray, amplitude: float, seed: int) -> np.ndarray:
    """What the receiver records."""
    adder = blocks.add_cc()
    top, sink = gr.top_block(), blocks.vector_sink_c()
    source = blocks.vector_source_c(np.resize(x, COUNT + 64).tolist())
    noise = analog.noise_source_c(analog.GR_GAUSSIAN, np.sqrt(NOISE_POWER), seed)
    top.connect(
        source, blocks.multiply_const_cc(amplitude), channels.distortion_3_gen(BEND), filter.fir_filter_ccc(1, PATHS), (adder, 0)
    )
    top.connect(noise, blocks.head(8, COUNT + 64), (adder, 1))
    top.connect(adder, sink)
    top.run()
    return np.array(sink.data())[64:]


def write_case(folder: Path, x: np.ndarray) -> None:
    folder.mkdir(parents=True)
    recording.write(folder / "waveform", x, sample_rate_hz=RATE_HZ)
    recording.write(folder / "recording", world(x, 1.0, seed=2), sample_rate_hz=RATE_HZ, center_frequency_hz=2.4e9)
    taps = [
        {"delay_s": k / RATE_HZ, "gain_db": float(20 * np.log10(abs(a))), "phase_rad": float(np.angle(a))}
        for k, a in enumerate(PATHS)
        if a
    ]
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": RATE_HZ,
        "center_frequency_hz": 2.4e9,
        "waveforms": {"qpsk": {"file": "waveform", "repeat": True}},
        "nodes": {"tx": {"transmit": "qpsk", "amplitude": 1.0}, "rx": {}},
        "links": [{"tx": "tx", "rx": "rx", "taps": taps}],
        "recordings": [{"file": "recording", "receiver": "rx", "transmitters": ["tx"]}],
        "noise": {"rx": {"power_db": float(10 * np.log10(NOISE_POWER))}},
        "unknown": ["delay", "phase", "gain"],
    }
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin, sort_keys=False))


def program(name: str, *arguments) -> None:
    subprocess.run([sys.executable, ROOT / "apps" / name, *map(str, arguments)], check=True)


def foretell(twin: Path, output: Path, amplitude: float) -> np.ndarray:
    """What a twin says that the receiver will record, without its noise."""
    duration_s = COUNT / RATE_HZ
    program(
        "cast_emulator.py", "play", "--twin", twin, "--output", output,
        "--amplitude", amplitude, "--duration", duration_s, "--no-noise",
    )  # fmt: skip
    return recording.read(output / "recording").samples.astype(complex)


def aligned(said: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """A prediction at the delay and the complex gain of a recording: a twin does not claim them."""
    period = SYMBOLS * SAMPLES_PER_SYMBOL
    match = np.fft.ifft(np.fft.fft(recorded[:period]) * np.conj(np.fft.fft(said[:period])))
    said = np.roll(said, int(np.argmax(np.abs(match))))
    return said * np.vdot(said, recorded) / np.vdot(said, said)


def residual_db(said: np.ndarray, recorded: np.ndarray) -> float:
    return float(10 * np.log10(np.mean(np.abs(recorded - said) ** 2) / np.mean(np.abs(recorded) ** 2)))


def symbols_of(samples: np.ndarray) -> np.ndarray:
    """QPSK symbols behind a zero-forcing equaliser of the paths and the matched filter."""
    taps = firdes.root_raised_cosine(1.0, SAMPLES_PER_SYMBOL, 1.0, 0.25, 20 * SAMPLES_PER_SYMBOL + 1)
    spectrum = np.fft.fft(samples) / np.fft.fft(PATHS, len(samples)) * np.abs(np.fft.fft(taps, len(samples)))
    matched = np.fft.ifft(spectrum)
    return max((matched[k::SAMPLES_PER_SYMBOL] for k in range(SAMPLES_PER_SYMBOL)), key=lambda s: np.abs(np.mean(s**4)))


def evm_percent(symbols: np.ndarray) -> float:
    """Against the nearest point, after gain and phase."""
    symbols = symbols * np.exp(-1j * (np.angle(np.mean(symbols**4)) - np.pi) / 4) / np.sqrt(np.mean(np.abs(symbols) ** 2))
    nearest = (np.sign(symbols.real) + 1j * np.sign(symbols.imag)) / np.sqrt(2)
    return float(100 * np.sqrt(np.mean(np.abs(symbols - nearest) ** 2)))


def main(folder: str) -> int:
    folder = Path(folder)
    if folder.exists():
        print(f"error: {folder}: exists; nothing is overwritten, choose another folder", file=sys.stderr)
        return 2
    x = waveform()
    write_case(folder / "amplifier", x)
    program("cast_diagnose.py", folder / "amplifier", "--output", folder / "diagnosis")
    twins = {"twin": folder / "amplifier" / "twin.yaml", "corrected": folder / "diagnosis" / "amplifier" / "twin_corrected.yaml"}
    print(f"\n{'':34}{'residual':>10}{'noise':>10}{'EVM':>9}")
    pictures = {}
    for title, amplitude, seed in (("as recorded and diagnosed", 1.0, 2), (f"foretold: {MORE_POWER} × amplitude", MORE_POWER, 3)):
        recorded = world(x, amplitude, seed)
        floor_db = 10 * np.log10(NOISE_POWER / np.mean(np.abs(recorded) ** 2))
        for name, path in twins.items():
            said = aligned(foretell(path, folder / f"played_{name}_{amplitude}", amplitude), recorded)
            pictures[name, amplitude] = said, recorded
            level = f"{residual_db(said, recorded):7.2f} dB{floor_db:7.2f} dB"
            evm = f"{evm_percent(symbols_of(recorded)):7.2f} %" if name == "twin" else ""
            print(f"{title + ', ' + name:34}{level}{evm}")
    clean = evm_percent(symbols_of(pictures["twin", 1.0][0] + world(0 * x, 1.0, 4)))
    print(f"EVM of the twin's own signal with the twin's noise: {clean:.2f} %")
    draw(folder / "amplifier.png", pictures)
    print(f"{folder}/amplifier.png, {folder}/diagnosis/amplifier/report.html")
    return 0


def draw(path: Path, pictures: dict) -> None:
    figure = new_figure(13, 4.2)
    axes = figure.subplots(1, 3, width_ratios=[1, 1.15, 1.3])
    said, recorded = pictures["twin", 1.0]
    for samples, colour, label in ((recorded, "#1f5fa8", "recorded"), (said, "#d1701f", "twin, no noise")):
        s = symbols_of(samples)
        s = s / np.sqrt(np.mean(np.abs(s) ** 2))
        axes[0].plot(s.real, s.imag, ".", ms=2, color=colour, label=label)
    axes[0].set(title=f"as recorded: EVM {evm_percent(symbols_of(recorded)):.1f} %, nothing to see", xlabel="I", ylabel="Q")
    axes[0].set_aspect("equal")
    colours = {"twin": "#d1701f", "corrected": "#3b7a57"}
    _, recorded = pictures["twin", MORE_POWER]
    level = np.abs(pictures["twin", MORE_POWER][0])
    edges = np.quantile(level, np.linspace(0.02, 1, 25))
    middle = (edges[1:] + edges[:-1]) / 2
    for name, samples in (("recorded", recorded), *((n, pictures[n, MORE_POWER][0]) for n in colours)):
        linear = pictures["twin", MORE_POWER][0]
        inside = [(level >= a) & (level < b) for a, b in zip(edges, edges[1:], strict=False)]
        gain = [np.abs(np.vdot(linear[i], samples[i]) / np.vdot(linear[i], linear[i])) for i in inside]
        style = dict(marker="o", ls="", color="#1f5fa8") if name == "recorded" else dict(color=colours[name], lw=2)
        axes[1].plot(middle, 20 * np.log10(gain), label=name, **style)
    axes[1].set(title=f"foretold at {MORE_POWER} × amplitude", xlabel="twin's amplitude", ylabel="gain over the twin's / dB")
    f, density = spectrum(recorded)
    axes[2].plot(f / 1e6, density, color="#1f5fa8", label="recorded")
    for name, colour in colours.items():
        said = pictures[name, MORE_POWER][0]
        f, density = spectrum(recorded - said)
        axes[2].plot(f / 1e6, density, color=colour, label=f"left by {name}: {residual_db(said, recorded):.1f} dB")
    axes[2].axhline(10 * np.log10(NOISE_POWER / RATE_HZ), color="#8a8a8a", ls=":", label="noise")
    axes[2].set(title="what each twin leaves at that power", xlabel="frequency / MHz", ylabel="power density / dB/Hz")
    for axis in axes:
        axis.legend(fontsize=8)
        axis.grid(alpha=0.25)
    save(figure, path)


def spectrum(samples: np.ndarray, bins: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and density in dB/Hz, by Welch's method."""
    pieces = samples[: len(samples) // bins * bins].reshape(-1, bins) * np.hanning(bins)
    power = np.mean(np.abs(np.fft.fft(pieces)) ** 2, axis=0) / np.sum(np.hanning(bins) ** 2) / RATE_HZ
    return np.fft.fftshift(np.fft.fftfreq(bins, 1 / RATE_HZ)), np.fft.fftshift(10 * np.log10(power))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: docs/examples/amplifier.py FOLDER")
    sys.exit(main(sys.argv[1]))
