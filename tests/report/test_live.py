# SPDX-License-Identifier: GPL-3.0-or-later
"""The live page, as a real browser shows it."""

import base64
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.report import live
from gr_cast.report.live import Look, scale_db, served, spectrum

RATE_HZ = 1e6
PROGRAMS = Path(__file__).resolve().parents[2] / "apps"


@pytest.fixture
def bokeh():
    try:
        live._load()
    except CastError as error:
        pytest.skip(f"NO BOKEH: {error}")


class Browser:
    """Debian's Chromium without a screen, asked by its own protocol."""

    def __init__(self, folder: Path):
        words = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--window-size=1100,820"]
        command = ["chromium", *words, f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        told = folder / "DevToolsActivePort"
        number = until(lambda: told.exists() and told.read_text().splitlines(), 60)[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{number}/json/list", timeout=30))
        self._address, self._count = next(p["webSocketDebuggerUrl"] for p in pages if p["type"] == "page"), 0

    def ask(self, method: str, **parameters):
        from tornado.ioloop import IOLoop
        from tornado.websocket import websocket_connect

        async def asked():
            wire = await websocket_connect(self._address, max_message_size=1 << 26)
            await wire.write_message(json.dumps({"id": 1, "method": method, "params": parameters}))
            while (answer := json.loads(await wire.read_message())).get("id") != 1:
                pass
            wire.close()
            return answer["result"]

        loop = IOLoop(make_current=False)
        try:
            return loop.run_sync(asked, timeout=60)
        finally:
            loop.close(all_fds=True)

    def value(self, script: str):
        return self.ask("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


def until(holds, seconds: float = 40.0):
    end = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < end
        time.sleep(0.2)
    return found


@pytest.fixture
def browser(tmp_path):
    if shutil.which("chromium") is None:
        pytest.skip("NO BROWSER: apt install chromium")
    opened = Browser(tmp_path / "profile")
    yield opened
    opened.close()


def test_a_spectrum_holds_the_power_where_it_is():
    rng = np.random.default_rng(1)
    samples = 2 * np.exp(2j * np.pi * 0.25 * np.arange(1 << 14)) + 0.1 * (rng.normal(size=(1 << 14, 2)) @ (1, 1j))
    frequency_hz, power_db = spectrum(samples, RATE_HZ)
    assert frequency_hz[np.argmax(power_db)] == 250e3
    assert np.sum(10 ** (power_db / 10)) == pytest.approx(np.mean(np.abs(samples) ** 2), rel=0.02)


def test_colours_of_a_waterfall_span_what_is_seen_and_never_less_than_noise_scatters():
    low, high = scale_db(np.full((5, 64), -120.0))
    assert low <= -120 <= high and high - low > 2 * 5.57  # of an exponential variable in dB
    seen = np.linspace(-80.0, -10.0, 1000).reshape(10, 100)
    assert scale_db(seen) == pytest.approx((-80, -10), abs=1)


def test_a_browser_shows_figures_taps_and_a_waterfall_that_go_on(bokeh, browser, tmp_path):
    looks = [0]

    def look() -> Look:
        looks[0] += 1
        tone = np.exp(2j * np.pi * 0.01 * (looks[0] % 50) * np.arange(4096))
        taps = {"1>2": (np.array([0.0, 1.28e-6]), np.array([-3.0, -20.0]))}
        return Look(
            figures={"samples": str(looks[0]), "waiting for": "nobody"}, taps=taps, spectra={"2:rx": spectrum(tone, RATE_HZ)}
        )

    named = "Bokeh.documents[0].get_model_by_name('{}')"
    with served(look, "a title", 0) as address:
        browser.ask("Page.navigate", url=address)
        rows = f"{named.format('waterfall')}.data.dh[0]"
        ready = f"window.Bokeh && Bokeh.documents.length && {named.format('waterfall')} && {rows} > 3"
        until(lambda: browser.value(f"!!({ready})"))
        assert browser.value("document.title") == "a title"
        before = browser.value(rows)
        until(lambda: browser.value(rows) > before)
        assert "nobody" in browser.value(f"{named.format('figures')}.text")
        assert browser.value(f"Array.from({named.format('taps')}.data.gain_db)") == [-3.0, -20.0]
        assert browser.value(f"Array.from({named.format('taps')}.data.delay_us)") == pytest.approx([0, 1.28])
        picture = base64.b64decode(browser.ask("Page.captureScreenshot")["data"])
        assert picture.startswith(b"\x89PNG")
        (Path(os.environ.get("CAST_SCREENSHOT", tmp_path)) / "live.png").write_bytes(picture)


def test_a_page_shows_a_link_that_is_there_now_and_no_taps_of_one_that_is_not(bokeh):
    from bokeh.document import Document

    seen, document = [{}], Document()
    tone = {"2:rx": spectrum(np.ones(512, complex), RATE_HZ)}
    live._page(document, lambda: Look(figures={}, taps=seen[0], spectra=tone if seen[0] else {}), "t")
    (update,) = document.session_callbacks

    def shown(taps: dict) -> tuple[str, list[float]]:
        seen[0] = taps
        update.callback()
        return document.get_model_by_name("link").value, list(document.get_model_by_name("taps").data["gain_db"])

    one, other = (np.array([0.0]), np.array([-3.0])), (np.array([0.0]), np.array([-20.0]))
    assert shown({}) == ("", [])
    assert shown({"a>b": one}) == ("a>b", [-3.0])
    assert shown({"c>d": other, "a>b": one}) == ("a>b", [-3.0])  # what was chosen stays
    assert shown({"c>d": other}) == ("c>d", [-20.0])
    assert shown({}) == ("", [])


def test_a_page_that_cannot_be_served_is_a_fault_and_not_a_wait(bokeh, monkeypatch):
    import bokeh.server.server

    def broken(*_, **__):
        raise RuntimeError("no such thing")

    monkeypatch.setattr(bokeh.server.server, "Server", broken)
    with pytest.raises(CastError, match="--web: port 0: no such thing"), served(lambda: Look(figures={}), "t", 0):
        pass


def test_the_page_is_this_machines_alone_and_its_port_is_free_afterwards(bokeh, caplog):
    caplog.set_level("INFO")
    with served(lambda: Look(figures={}), "t", 0) as address:
        with pytest.raises(urllib.error.HTTPError, match="405"):
            urllib.request.urlopen(address, data=b"x", timeout=30)
        assert caplog.text == ""  # what browsers do is told nowhere
        number = int(address.rpartition(":")[2].strip("/"))
        others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)} - {"127.0.0.1"}
        for host in [host for host in others if not host.startswith("127.")]:
            with pytest.raises(OSError):
                socket.create_connection((host, number), timeout=2)
        with pytest.raises(CastError, match=f"port {number}: "), served(lambda: Look(figures={}), "u", number):
            pass
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", number), timeout=2)


def test_without_bokeh_the_line_says_what_to_type(tmp_path):
    scenario = tmp_path / "s.yaml"
    scenario.write_text(
        "cast_scenario: 1\nname: s\nnodes: [a, b]\nlinks:\n  - {tx: a, rx: b, taps: [{delay_s: 0, gain_db: 0}]}\n"
    )
    blocked = "import sys, runpy; sys.modules['bokeh'] = None; sys.argv = sys.argv[1:]; sys.path.insert(0, sys.argv[1]); "
    blocked += "program = sys.argv.pop(1); runpy.run_path(program + '/cast_emulator.py', run_name='__main__')"
    command = [sys.executable, "-c", blocked, "x", str(PROGRAMS), "run", str(scenario), "--rate", "1e6", "--web"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 2
    assert f"--web: Bokeh is not installed: type  {sys.executable} -m venv " in done.stderr  # not of PATH's first


def test_an_emulator_tells_its_page_links_taps_levels_and_who_is_waited_for():
    from gnuradio import blocks as stock
    from gr_cast.blocks.emulation import Emulation
    from gr_cast.blocks.newest import EmulatorView
    from gr_cast.blocks.ports import Port
    from gr_cast.scenario import LinkTaps, Scenario

    link = LinkTaps(delay_s=[[0.0, 2e-6]], gain=[[1.0, 0.1]])
    scenario = Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link}, base_loss_db=30.0)
    tone = np.tile(np.exp(2j * np.pi * np.arange(4) / 4), 50_000).astype(np.complex64)
    emulation = Emulation(scenario, [Port.parse("b:rx=null")], RATE_HZ, ends={("a", "tx"): stock.vector_source_c(tone.tolist())})
    view = EmulatorView(emulation)
    emulation.run_until(threading.Event())
    seen = view.look()
    assert seen.figures["waiting for"] == "nobody" and seen.figures["samples"] == "200,000"
    delay_s, gain_db = seen.taps["a>b"]
    assert delay_s == pytest.approx([0, 2e-6]) and gain_db == pytest.approx([-30, -50])
    frequency_hz, power_db = seen.spectra["b:rx"]
    assert frequency_hz[np.argmax(power_db)] == 250e3
    # 1 and 0.1 half a turn later, 30 dB below.
    assert 10 * np.log10(np.sum(10 ** (power_db / 10))) == pytest.approx(20 * np.log10(0.9) - 30, abs=0.05)


@pytest.mark.parametrize("datatype", ["cf32_le", "ci16_le"])
def test_a_receivers_page_shows_the_taps_of_its_newest_samples(datatype):
    from gnuradio import blocks as stock
    from gnuradio import gr
    from gr_cast.blocks.newest import ReceiverView
    from gr_cast.signals.waveform import waveform_from_text

    waveform = waveform_from_text("glfsr:8", samples_per_chip=1, repeat=True)
    period = np.asarray(waveform.samples, np.complex64)
    heard = np.tile(0.5 * np.roll(period, 7) + 0.05j * np.roll(period, 10), 400)[: 255 * 400 - 100].astype(np.complex64)

    class Receiver(gr.top_block):
        def __init__(self):
            super().__init__("receiver", catch_exceptions=False)
            self.datatype, self.samples = datatype, len(heard)
            self.recorder = SimpleNamespace(gaps=SimpleNamespace(lost_samples=3))
            self.radio = stock.vector_source_c(heard.tolist())
            if datatype == "ci16_le":
                shorts = np.rint(heard.view(np.float32) * 32768).astype(int)
                self.radio = stock.vector_source_s(shorts.tolist(), False, 2)

    receiver = Receiver()
    view = ReceiverView(receiver, waveform, RATE_HZ)
    assert len(view.look().taps["newest samples"][0]) == 0
    receiver.run()
    seen = view.look()
    delay_s, gain_db = seen.taps["newest samples"]
    assert sorted(delay_s) == pytest.approx([0, 3e-6], abs=1e-9)
    assert sorted(gain_db) == pytest.approx([20 * np.log10(0.05), 20 * np.log10(0.5)], abs=0.1)
    assert seen.figures["power"] == f"{10 * np.log10(0.25 + 0.0025):.1f} dB"
    assert seen.figures["carrier offset"] == "0.0 Hz"  # not -0.0, on whichever side of it the estimate lies
    assert seen.figures["lost"] == "3" and seen.figures["samples"] == f"{len(heard):,}"
