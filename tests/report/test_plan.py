# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a place: what stands where, and what a click tells, read out of the page by a browser where there is one."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.report import plan
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.scenario.create import geometry

LOSS_DB = {("a", "b"): 60.0, ("a", "w"): 80.0, ("b", "w"): 70.0}


def place():
    clock = np.arange(0, 1.01, 0.1)
    links = {key: LinkTaps(delay_s=[[0.0]], gain=[[10 ** (-loss_db / 20)]]) for key, loss_db in LOSS_DB.items()}
    track = np.stack([5 + 10 * clock, 9 + 0 * clock, 1 + 0 * clock], axis=1)
    position_m = {"a": np.array([[0.0, 0, 5]]), "b": np.array([[30.0, 0, 2]]), "w": track}
    return Scenario(name="A <yard>", nodes=("a", "b", "w"), links=links, time_s=clock, position_m=position_m)


def hut():
    corners = np.array([[x, y, z] for z in (0.0, 4.0) for x, y in ((10, 1), (12, 1), (12, 3), (10, 3))])
    walls = [[k, (k + 1) % 4, 4 + k] for k in range(4)] + [[4, 5, 6], [4, 6, 7]]
    ground = np.array([[-5.0, -5, 0], [40, -5, 0], [40, 20, 0], [-5, 20, 0]])
    roof = np.array([[-5.0, -5, 9], [40, -5, 9], [40, 20, 9], [-5, 20, 9]])
    return [geometry.Solid(name="hut", vertices_m=corners, faces=walls),
            geometry.Solid(name="ceiling", vertices_m=roof, faces=[[0, 1, 2], [0, 2, 3]]),
            geometry.Solid(name="ground", vertices_m=ground, faces=[[0, 1, 2], [0, 2, 3]])]  # fmt: skip


def test_outlines_tell_floor_and_ceiling_from_what_stands_between():
    assert [(one["name"], one["floor"]) for one in geometry.outlines(hut())] == [
        ("hut", False),
        ("ceiling", True),
        ("ground", True),
    ]


def test_the_page_needs_no_other_file_and_is_well_formed():
    text = plan.page(place(), geometry.outlines(hut()))
    assert not re.findall(r"(?:src|href)=|url\(|@import|https?://(?!www\.w3\.org/2000/svg)", text)
    assert "A &lt;yard&gt;" in text and "A <yard>" not in text.split("<script>")[0]
    HTMLParser().feed(text)


def test_a_metre_is_as_long_in_every_direction_and_north_is_up():
    text = plan.page(place(), [])
    (a,), (b,), track = (np.array(points) for points in json.loads(re.search(r"const P=(\{.*?\});", text)[1])["tracks"])
    per_m = (b - a)[0] / 30
    np.testing.assert_allclose((track[0] - a) / per_m, [5, -9], atol=0.02)
    np.testing.assert_allclose((track[-1] - track[0]) / per_m, [10, 0], atol=0.02)


def test_losses_are_those_of_every_instant_over_the_band():
    """Two taps 12.5 ns apart, the second as strong and turning: over 80 MHz powers add, over a narrow band amplitudes."""
    still, turns = place(), np.exp(1j * np.pi * np.linspace(0, 1, 11))
    moving = LinkTaps(delay_s=np.tile([0.0, 12.5e-9], (11, 1)), gain=np.stack([np.ones(11), turns], axis=1) * 1e-3)
    scenario = replace(still, links=still.links | {("a", "b"): moving})

    def losses_db(*band):
        return np.array(json.loads(re.search(r"const P=(\{.*?\});", plan.page(scenario, [], *band))[1])["loss_db"], float)[
            :, 0, 1
        ]

    np.testing.assert_allclose(losses_db(80e6), 60 - 10 * np.log10(2), atol=0.06)
    np.testing.assert_allclose(losses_db(1e4)[:-1], 60 - 20 * np.log10(np.abs(1 + turns))[:-1], atol=0.06)


def test_colours_span_a_scale_where_all_losses_are_one():
    both = {key: LinkTaps(delay_s=[[0.0]], gain=[[1e-3]]) for key in (("a", "b"), ("b", "a"))}
    low, high = re.search(
        r"chosen\.\s+([\d.]+) dB <.*> ([\d.]+) dB; white", plan.page(replace(place(), links=both), []), re.S
    ).groups()
    assert float(low) < 60 < float(high)


def test_nodes_without_a_place_are_named():
    links = {("a", "b"): LinkTaps(delay_s=[[0.0]], gain=[[1.0]])}
    with pytest.raises(CastError, match="no position of a, b"):
        plan.page(Scenario(name="x", nodes=("a", "b"), links=links), [])


def test_a_click_tells_the_loss_from_that_node(tmp_path):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("NO BROWSER: apt-get install chromium")
    click = "<script>nodes[1].dispatchEvent(new Event('click'))</script></html>"
    (tmp_path / "plan.html").write_text(plan.page(place(), geometry.outlines(hut())).replace("</html>", click))
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/profile", "--dump-dom",
               str(tmp_path / "plan.html")]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    assert re.search(r'<b id="from">b</b>', shown)
    assert re.findall(r"<title>([^<]*)</title><text", shown) == ["a: not heard", "b sends", "w: 70.0 dB"]
    assert shown.count('class="link"') == 1
