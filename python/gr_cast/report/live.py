# SPDX-License-Identifier: GPL-3.0-or-later
"""A live page of a running program, by Bokeh: figures, taps of links, waterfalls. Served to this machine alone, and read-only."""

import asyncio
import contextlib
import logging
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from ..core.errors import CastError

PORT = 5006
_STEP_MS = 500
_LINES = 80  # of a waterfall
_LOWEST_DB, _HIGHEST_DB = -120.0, 20.0  # of a waterfall's colours at first; they follow what is seen
_LEAST_SPAN_DB = 11.2  # of them later: two standard deviations of noise in one bin, without averaging
_FOLDER = Path(os.environ.get("XDG_DATA_HOME", "~/.local/share")).expanduser() / "gr_cast/web"


@dataclass(frozen=True, kw_only=True)
class Look:
    """What is to be seen now: `figures` name to text, `taps` link to (delays in s, gains in dB), `spectra` port to
    (frequencies in Hz, evenly spaced, powers in dB)."""

    figures: dict[str, str]
    taps: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    spectra: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


def scale_db(image: np.ndarray) -> tuple[float, float]:
    """Lowest and highest colour of a waterfall in dB: what is seen, never finer than noise scatters."""
    high = float(np.max(image)) + 0.1
    return min(float(np.percentile(image, 1)), high - _LEAST_SPAN_DB), high


def spectrum(samples: np.ndarray, sample_rate_hz: float, bins: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and powers in dB, (bins,) each, of samples (n,) complex: Welch's mean, whose sum is the mean power."""
    frequency_hz = (np.arange(bins) - bins // 2) * sample_rate_hz / bins
    blocks = samples[: len(samples) // bins * bins].reshape(-1, bins)
    if not len(blocks):
        return frequency_hz, np.full(bins, _LOWEST_DB)
    window = np.hanning(bins)
    power = np.mean(np.abs(np.fft.fft(blocks * window, axis=1)) ** 2, axis=0) / (bins * np.sum(window**2))
    return frequency_hz, 10 * np.log10(np.maximum(np.fft.fftshift(power), 10 ** (_LOWEST_DB / 10)))


def _load() -> None:
    """Raises CastError, with what to type, where there is no Bokeh."""
    folder = Path(os.environ.get("CAST_WEB", _FOLDER))
    packages = str(folder / f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages")
    if packages not in sys.path:
        sys.path.append(packages)  # last: NumPy stays GNU Radio's
    try:
        import bokeh  # noqa: F401
    except ImportError:
        raise CastError(
            f"--web: Bokeh is not installed: type  {sys.executable} -m venv --system-site-packages {folder} && "
            f'{folder}/bin/pip install "numpy<2" bokeh'
        ) from None


def _page(document, look: Callable[[], Look], title: str) -> None:
    """What one browser sees; its choice of a link and a port is its own."""
    from bokeh.layouts import column, row
    from bokeh.models import ColumnDataSource, Div, LinearColorMapper, Select
    from bokeh.plotting import figure

    figures = Div(text="", name="figures")
    link, port = (Select(title=name, options=[], value="", name=name) for name in ("link", "port"))
    taps = ColumnDataSource({"delay_us": [], "gain_db": [], "floor_db": []}, name="taps")
    lines = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []}, name="waterfall")
    colours = LinearColorMapper(palette="Viridis256", low=_LOWEST_DB, high=_HIGHEST_DB)

    response = figure(
        title="taps", height=260, width=620, x_axis_label="delay, µs", y_axis_label="gain, dB", toolbar_location=None
    )
    response.segment("delay_us", "floor_db", "delay_us", "gain_db", source=taps, line_width=2)
    response.scatter("delay_us", "gain_db", source=taps, size=8)
    waterfall = figure(title="waterfall", height=260, width=620, x_axis_label="frequency, MHz", toolbar_location=None)
    waterfall.yaxis.visible = False
    waterfall.x_range.range_padding = waterfall.y_range.range_padding = 0
    picture = waterfall.image(image="image", x="x", y="y", dw="dw", dh="dh", source=lines, color_mapper=colours)
    waterfall.add_layout(picture.construct_color_bar(title="dB"), "right")
    history: dict[str, list[np.ndarray]] = {}

    def update() -> None:
        seen = look()
        figures.text = (
            "<table>"
            + "".join(f"<tr><td>{escape(k)}</td><td><b>{escape(v)}</b></td></tr>" for k, v in seen.figures.items())
            + "</table>"
        )
        for choice, there in ((link, seen.taps), (port, seen.spectra)):  # another scenario may have other links
            choice.options = list(there)
            if choice.value not in there:
                choice.value = next(iter(there), "")
        delay_s, gain_db = seen.taps.get(link.value, ((), ()))
        floor_db = np.full(len(gain_db), np.min(gain_db, initial=0.0) - 5)
        taps.data = {"delay_us": 1e6 * np.asarray(delay_s), "gain_db": np.asarray(gain_db), "floor_db": floor_db}
        for name, (_, power_db) in seen.spectra.items():
            history[name] = [*history.get(name, []), power_db][-_LINES:]
        if port.value:
            frequency_hz, _ = seen.spectra[port.value]
            image = np.array(history[port.value])
            colours.low, colours.high = scale_db(image)
            span_mhz = 1e-6 * (frequency_hz[1] - frequency_hz[0]) * len(frequency_hz)
            lines.data = {"image": [image], "x": [1e-6 * frequency_hz[0]], "y": [0], "dw": [span_mhz], "dh": [len(image)]}

    update()
    document.title = title
    document.add_root(column(Div(text=f"<h2>{escape(title)}</h2>"), row(figures, column(row(link, port), response, waterfall))))
    document.add_periodic_callback(update, _STEP_MS)


@contextlib.contextmanager
def served(look: Callable[[], Look], title: str, port: int = PORT) -> Iterator[str]:
    """The address of the page while this is entered; `look()` is asked in a thread of its own, twice a second per browser.

    Only this machine reaches it, and nothing that a browser says reaches the program. Port 0: any that is free. Raises
    CastError where there is no Bokeh, or another program has the port.
    """
    _load()
    from bokeh.server.server import Server

    for name in ("bokeh", "tornado"):  # a browser that closes its page is no matter of the program's
        logging.getLogger(name).setLevel(logging.CRITICAL)

    try:
        socket.create_server(("127.0.0.1", port)).close()  # Bokeh would leave its own open where this fails
    except (OSError, OverflowError) as error:
        raise CastError(f"--web: port {port}: {getattr(error, 'strerror', None) or error}") from None
    ready, loops, faults = threading.Event(), [], []

    def serve() -> None:
        own = asyncio.new_event_loop()
        asyncio.set_event_loop(own)
        try:
            server = Server({"/": lambda document: _page(document, look, title)}, port=port, address="127.0.0.1")
            server.start()
        except Exception as error:  # whatever it is, the program waits for this thread
            faults.append(str(error))
            own.close()
            ready.set()
            return
        loops.append((server.io_loop, server.port))
        server.io_loop.add_callback(ready.set)
        server.io_loop.start()
        server.stop()
        loop = server.io_loop.asyncio_loop
        waiting = asyncio.all_tasks(loop)  # of browsers that are still there
        for task in waiting:
            task.cancel()
        loop.run_until_complete(asyncio.gather(*waiting, return_exceptions=True))
        server.io_loop.close(all_fds=True)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    ready.wait()
    if faults:
        raise CastError(f"--web: port {port}: {faults[0]}")
    loop, number = loops[0]
    try:
        yield f"http://localhost:{number}/"
    finally:
        loop.add_callback(loop.stop)
        thread.join()
