# SPDX-License-Identifier: GPL-3.0-or-later
"""The report: one page that needs nothing else, says everything that the diagnosis says, and maps that measure what they show."""

import re
import sys
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

sys.path.append(str(Path(__file__).resolve().parents[1] / "diagnose"))
from conftest_world import World
from gr_cast.diagnose import diagnose, read_case
from gr_cast.diagnose.maps import before_and_after, maps_of, power_of, steps
from gr_cast.diagnose.write import maps
from gr_cast.report.link.page import in_one_sentence, render
from gr_cast.report.link.pictures import maps_figure, waterfall_figure
from gr_cast.report.pages import Album, runner_up

ECHO, DC = 0.3 * 0.1 * np.exp(1j), 0.02


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A diagnosis of an echo 20 dB below the first path and DC, under a carrier offset that the twin knows."""
    world = World()
    y = (world.clean() + ECHO * world.path(60)) * np.exp(2j * np.pi * 180 * world.n / 1e6) + DC
    folder = world.write(tmp_path_factory.mktemp("report") / "case", world.noisy(y))
    offset = "{family: carrier_frequency_offset, owner: {level: rx, name: rx1}, parameters: {offset_hz: {value: 180.0, std: 0}}}"
    with open(folder / "twin.yaml", "a") as file:
        file.write(f"effects: [{offset}]\n")
    return diagnose(read_case(folder))


class Page(HTMLParser):
    """Text of a page; every tag closed in order, nothing fetched."""

    def __init__(self, page: str):
        super().__init__()
        self.open, self.text, self.sources, self.faults = [], [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.sources += [v for k, v in attributes if k in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(tag)

    def handle_data(self, data):
        self.text.append(data)


def test_a_page_needs_nothing_else_and_says_what_the_diagnosis_says(found):
    page = Page(render(found))
    text = " ".join("".join(page.text).replace("\N{MINUS SIGN}", "-").split())
    assert not page.faults and not page.open
    assert len(page.sources) >= 2 and all(s.startswith("data:image/png;base64,") for s in page.sources)
    assert {e["family"] for e in found.document["effects"]} == {"extra_path", "dc_offset"}
    for effect in found.document["effects"]:
        assert effect["sentence"].replace("\N{MINUS SIGN}", "-") in text
    assert "Identified: the twin leaves out" in text and "Runner-up" in text and "dB of residual" in text
    assert "gain / dB" in text and re.search(r"receiver rx1", text)


def test_a_delay_of_next_to_nothing_is_told_without_an_exponent(found):
    for finding in found.findings:
        base = finding.fit.model.base
        kept, base[0] = base[0], 1e-8 - finding.scene.anchor
        shown = " ".join("".join(Page(render(found)).text).split())
        base[0] = kept
        assert not re.search(r"\de-\d", shown)


def test_an_open_question_is_followed_by_the_recording_that_answers_it(found):
    why = "dc_offset and lo_leakage explain this recording equally well."
    entry = {"families": ["dc_offset", "lo_leakage"], "why": why, "record_next": "offset_carrier"}
    document = {**found.document, "verdict": "ambiguous", "ambiguous": [entry]}
    text = "".join(Page(render(replace(found, document=document))).text)
    assert "it is DC offset or LO leakage" in text
    assert "Record next: the same with the transmitter tuned" in text and "LO leakage: it fits as well" in text


def test_a_page_is_whole_without_the_pictures_that_its_time_does_not_hold(found):
    everything = Page(render(found))
    hurried = Page(render(replace(found, deadline=time.thread_time())))
    assert not hurried.faults and not hurried.open and not hurried.sources
    text = "".join(hurried.text)
    assert "2 pictures are left out" in text and "left out:" not in "".join(everything.text)
    assert all(effect["sentence"] in text.replace("\N{MINUS SIGN}", "-") for effect in found.document["effects"])


def test_a_picture_is_drawn_only_where_the_longest_before_it_would_still_be_in_time():
    def draw():
        drawn.append(begun := time.thread_time())
        while time.thread_time() < begun + 0.3:
            pass
        return Figure(figsize=(1, 1))

    drawn, album = [], Album(time.thread_time() + 0.5)
    pages = [album.image(draw, "") for _ in range(5)]
    assert len(drawn) == 1 and [bool(page) for page in pages] == [True, False, False, False, False]
    assert "4 pictures are left out" in album.note()


def test_steps_that_are_not_told_in_time_are_not_told(found):
    finding = replace(found.findings[0], steps=None, data=replace(found.findings[0].data, deadline=time.thread_time()))
    assert steps(finding) is None


def test_the_maps_show_the_echo_at_its_delay_and_the_dc_at_its_frequency(found):
    finding = found.findings[0]
    before, after = before_and_after(finding, finding.data.noise_power)
    delay = np.nanmean(before.delay_time, axis=0)
    assert before.delay_s[np.argmax(delay)] == pytest.approx(60e-6, abs=1e-9)
    bins = before.time_frequency.shape[1]
    assert np.argmax(np.nanmean(before.time_frequency, axis=0)) == bins // 2
    for m in (after.time_frequency, after.position):
        assert np.nanmean(m) == pytest.approx(1.0, abs=0.05)  # noise, and no more
    assert np.abs(np.abs(after.gain) - 1).max() < 5 * after.gain_std.max()


def test_the_curve_of_a_bent_signal_is_its_gain_by_amplitude(found):
    fit = found.findings[0].fit
    bend = 1 - 0.1 * np.abs(fit.chain.y) ** 2 / np.mean(np.abs(fit.chain.y) ** 2)
    m = maps_of(replace(fit, data=replace(fit.data, y=fit.chain.y * bend)), 1.0)
    assert np.allclose(m.gain, 1 - 0.1 * m.amplitude**2, atol=0.01)


def test_the_steps_go_down_from_the_twin_to_the_corrected_twin(found):
    finding = found.findings[0]
    levels = [power_of(finding.twin), *(power for _, power in steps(finding))]
    assert len(levels) == 3 and levels == sorted(levels, reverse=True)
    assert levels[-1] == power_of(finding.fit)
    # The strongest is the echo, of known power; the DC is what is left, over the noise.
    assert levels[0] - levels[1] == pytest.approx(max(abs(ECHO) ** 2, DC**2), rel=0.15)
    assert levels[1] - levels[2] == pytest.approx(min(abs(ECHO) ** 2, DC**2), rel=0.15)


def test_a_bar_that_no_list_holds_is_said_not_to_be_claimed(found):
    axis = waterfall_figure(found.findings[0], {"extra_path"}).axes[0]
    bars = [label.get_text() for label in axis.get_yticklabels()]
    assert "extra path" in bars and "DC offset (fitted, not claimed)" in bars


def test_left_and_right_share_the_scales_of_both_curves(found):
    finding = found.findings[0]
    fit = replace(finding.fit, data=replace(finding.fit.data, y=finding.fit.data.y * np.exp(0.5j * np.abs(finding.fit.chain.y))))
    figure = maps_figure(replace(finding, twin=finding.fit, fit=fit), [], [])
    gains = [axis for axis in figure.axes if "predicted" in axis.get_xlabel()]
    places = {axis.get_position().bounds for axis in gains}
    phases = [axis for axis in figure.axes if axis.get_position().bounds in places and axis not in gains]
    for left, right in (gains, phases):
        assert left.get_ylim() == right.get_ylim() and left is not right


def test_every_map_of_every_recording_is_kept(found):
    kept = maps(found)
    assert {"recording/before/delay_time", "recording/after/gain", "recording/after/position"} <= set(kept)
    assert all(np.isfinite(v[~np.isnan(v)]).all() for v in kept.values())


@pytest.mark.parametrize("left", [[], [{"test": "time", "recording": "recording", "time_s": [0.0, 0.001]}]])
def test_a_time_that_was_over_is_said_before_what_to_record(found, left):
    residual = {"where": left, "record_next": "longer_recording" if left else None, "p_value": 1e-9, "out_of_time": True}
    document = {**found.document, "verdict": "unexplained", "residual": {**found.document["residual"], **residual}}
    text = "".join(Page(render(replace(found, document=document))).text)
    headline = text[text.index("Unexplained") : text.index("First diagnose with a larger --budget")]
    assert "The time was over before all was weighed: a larger --budget may find more." in headline
    assert "no known physics" not in text
    assert not left or text.index("a larger --budget") < text.index("Record next: the same for longer")
    assert "--budget" not in "".join(Page(render(found)).text)


@pytest.mark.parametrize(("held_out", "is_late", "said"), [
    (None, True, "not worked out"),
    (12.0, True, "none comes near"),
    (None, False, "none comes near"),
])  # fmt: skip
def test_rivals_that_nobody_weighed_are_not_told_to_be_far(held_out, is_late, said):
    evidence = {"runner_up": None, "runner_up_margin_nats": None, "heldout_gain_nats": held_out}
    document = {"ambiguous": [], "residual": {"out_of_time": is_late}}
    assert runner_up({"family": "dc_offset", "evidence": evidence}, document, "fits") == said


def test_recordings_stand_in_order_of_time_with_the_delay_of_the_whole_and_none_where_nothing_is_heard(found):
    """Sent 37.2 samples late, in microseconds; 510 are a period."""
    (whole,) = found.findings
    once = replace(whole.scene, sources=[replace(source, repeat=False) for source in whole.scene.sources], anchor=-7000)

    def part(first: int, late: float, scene=whole.scene, absent=False):
        model = replace(whole.fit.model, base=np.array([late - scene.anchor, 1.0, 0.0]))
        observation, fit = whole.observation.part(first, first + 4000), replace(whole.fit, model=model)
        return replace(whole, observation=observation, scene=scene, fit=fit, absent=absent)

    parts = [part(8000, 37.2 - 8000, once), part(4000, (37.2 - 4000) % 510), part(12_000, 5.0, absent=True), part(0, 37.2)]
    page = render(replace(found, findings=parts, deadline=time.thread_time()))
    rows = re.findall(r"<tr><td>recording, (\d+) to (.*?)</tr>", page)
    gain_and_delay = [re.findall(r"<td class='number'>(.*?)</td>", row)[2:4] for _, row in rows]
    assert [begin for begin, _ in rows] == ["0", "4", "8", "12"]
    assert gain_and_delay == [["0.00", "37.2000"]] * 3 + [["–", "–"]]


@pytest.mark.parametrize(("corrected_db", "unexplained_db", "said"), [
    (-24.0, 0.029, "what is left is not noise, by 0.029 dB in its loudest test, and no known physics explains it"),
    (-26.0, 2.094, "falls from -20.0 to -26.0 dB (noise was taken to be -24.6 dB)"),
    (-24.0, 0.0, "what is left is not noise, and no known physics explains it"),
])  # fmt: skip
def test_the_headline_has_the_numbers_of_the_document_and_none_beside(found, corrected_db, unexplained_db, said):
    fit = {"twin_nmse_db": -20.0, "corrected_nmse_db": corrected_db, "noise_floor_db": -24.6, "split": "vault"}
    left = {"unexplained_db": unexplained_db, "where": [{"test": "time", "recording": "recording"}], "out_of_time": False}
    document = {**found.document, "verdict": "unexplained", "fit": fit, "residual": found.document["residual"] | left}
    headline = in_one_sentence(document)
    assert said in headline
    numbers = {"-20.0", "-24.6", f"{corrected_db}", f"{unexplained_db:.2g}"}
    assert set(re.findall(r"-?\d+\.\d+", headline)) <= numbers
