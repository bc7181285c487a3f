# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a place diagnosis: plan and section show causes where they are, in metres; it needs no other file."""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from gr_cast.diagnose import places
from gr_cast.diagnose.places import run
from gr_cast.diagnose.places.fit import evaluated
from gr_cast.diagnose.places.search import Found
from gr_cast.report.place import maps, outline, words
from gr_cast.report.place.page import render
from gr_cast.report.place.scene import scene_of
from gr_cast.twin.places.families import additions, nodes
from gr_cast.twin.places.families.base import Effect

OFFICE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "office.py"
GLASS = Effect(
    family=additions.MissingObject(), owner="place", values=np.array([0, 0, *np.log([6.31, 0.0193])]),
    choice=additions.Sheet(
        origin_m=(7.0, 6.2, 1.3), normal=(0.0, 1.0, 0.0), u=(-1.0, 0.0, 0.0), v=(0.0, 0.0, 1.0), low_m=(-6, -1.3), high_m=(6, 1.3)
    ),
)  # fmt: skip
DESK = Effect(family=nodes.NodePosition(), owner="desk", values=np.array([0.03, 0.0, 0.0]))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("example")
    subprocess.run([sys.executable, OFFICE, "make", folder], check=True, capture_output=True, timeout=120)
    return folder / "office"


def diagnosed(case, *effects, rival=None):
    """The diagnosis that a search would give that finds these effects."""

    def found(ears, base, unknown, budget, progress, vault):
        start, model = evaluated(ears, base, ()), evaluated(ears, base, effects)
        rivals = {effects[0].key: [(rival, 0.4)]} if rival else {}
        return Found(model=model, start=start, rivals=rivals, tried=9, count=sum(e.count for e in ears), spent=False)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run.search, "run", found)
        patch.setattr(run.policy, "LEAST_SURE", 0.0)  # what is drawn need not be right
        return places.diagnose(places.read_case(case))


@pytest.fixture(scope="module")
def glass(case):
    return diagnosed(case, GLASS)


@pytest.fixture(scope="module")
def page(glass):
    return render(glass)


def drawings(text):
    """The views of a page by what they show, as trees."""
    found = re.findall(r"<svg class=\"view.*?</svg>", text, flags=re.S)
    trees = [ElementTree.fromstring(one) for one in found]
    return {(tree.get("data-view"), tree.get("class").split()[1]): tree for tree in trees}


def numbers(way: str) -> np.ndarray:
    return np.array(re.findall(r"-?[\d.]+(?:e-?\d+)?", way), float).reshape(-1, 2)


def spots(tree):
    """Nodes of a drawing, name → place in its units."""
    groups = [g for g in tree.iter("g") if g.get("class") == "node"]
    dots = [next(c for c in g.findall("circle") if c.find("title") is not None) for g in groups]
    return {d.find("title").text.split(":")[0]: np.array([float(d.get("cx")), float(d.get("cy"))]) for d in dots}


def test_the_page_needs_no_other_file_and_its_drawings_are_well_formed(page):
    assert not re.findall(r"(?:src|href)=(?!'data:)|url\(|@import|https?://(?!www\.w3\.org/2000/svg)", page)
    assert {*drawings(page)} == {(view, state) for view in ("plan", "section") for state in ("before", "after")}
    HTMLParser().feed(page)


def test_a_missing_wall_is_drawn_where_it_stands_in_metres(page):
    tree = drawings(page)["plan", "before"]
    at = spots(tree)
    per_m = (at["wall_east"] - at["wall_west"])[0] / 13.2
    plane = numbers(next(p.get("d") for p in tree.iter("path") if p.get("class") == "plane"))
    south_of_it_m = (at["desk"][1] - plane[:, 1]) / per_m
    np.testing.assert_allclose(south_of_it_m, 6.2 - 4.4, atol=0.02)
    reach_m = (plane[:, 0] - at["wall_west"][0]) / per_m + 0.4
    assert 0.9 < reach_m.min() < reach_m.max() < 13.1


def test_links_say_what_the_twin_and_the_corrected_twin_leave_over_noise(page):
    for link in drawings(page)["plan", "after"].iter("line"):
        before, after = map(float, re.search(r"(-?[\d.]+) dB over noise, (-?[\d.]+) dB", link.find("title").text).groups())
        assert after < 2.0 and before > after - 0.5
    assert "door → lift" in page.replace("&gt;", ">")


def test_what_no_path_meets_is_grey_and_named(page, glass):
    tree = drawings(page)["plan", "before"]
    told = {p.find("title").text.split(":")[0]: p.get("class") for p in tree.iter("path") if p.find("title") is not None}
    assert "dark" in told["stairs"] and "No path of any sounding meets stairs." in page
    assert "lit" in told["south"] and "lit" in told["west"]


def test_an_arrow_too_short_to_see_is_enlarged_and_says_so(case):
    tree = drawings(render(diagnosed(case, DESK)))["plan", "before"]
    at = spots(tree)
    per_m = (at["wall_east"] - at["wall_west"])[0] / 13.2
    start, end = numbers(next(p.get("d") for p in tree.iter("path") if p.get("class") == "arrow"))
    times = int(next(t.text for t in tree.iter("text") if t.get("class") == "times").removeprefix("× "))
    np.testing.assert_allclose((end - start) / per_m / times, [0.03, 0.0], atol=1e-3)
    np.testing.assert_allclose(start, at["desk"], atol=0.11)


def test_what_is_open_says_where_to_sound_next_and_shows_it(case):
    diagnosis = diagnosed(case, GLASS, rival=DESK)
    text = render(diagnosis)
    x, y, z = diagnosis.document["ambiguous"][0]["record_next"]["position_m"]
    assert "Ambiguous: it is missing object or node position" in text and f"({x:.2f}, {y:.2f}, {z:.2f}) m" in text
    tree = drawings(text)["plan", "before"]
    at = spots(tree)
    per_m = (at["wall_east"] - at["wall_west"])[0] / 13.2
    target = next(g for g in tree.iter("g") if g.get("class") == "target").find("circle")
    there = (np.array([float(target.get("cx")), float(target.get("cy"))]) - at["desk"]) / per_m
    np.testing.assert_allclose(there, [x - 3.2, 4.4 - y], atol=0.02)


def test_an_echo_that_the_twin_lacks_is_brightest_at_its_own_delay(glass):
    """The wall's mirror image of the desk is 2·1.8 m behind it."""
    one = next(p for p in maps.profiles(scene_of(glass)) if p.link == "desk>wall_east")
    before, after = one.mean_db
    image = np.array([3.2, 2 * 6.2 - 4.4, 1.1])
    delay_s = np.linalg.norm(image - [13.6, 3.4, 2.2]) / 299792458.0
    assert abs(one.delay_s[np.argmax(before)] - delay_s) < 1 / 200e6 and before.max() > after.max() + 8


def test_power_alone_is_shown_over_time(case, tmp_path):
    shutil.copytree(case, tmp_path / "power")
    for name in ("office.npz", "corridor.npz"):
        heard = dict(np.load(case / name))
        power_db = 10 * np.log10((np.abs(heard["response"]) ** 2).mean(axis=2))
        own = {key: heard[key] for key in ("tx", "rx", "time_s")}
        np.savez(tmp_path / "power" / name, power_db=power_db, std_db=np.full(len(power_db), 0.5), **own)
    document = yaml.safe_load((case / "place.yaml").read_text())
    document["soundings"] = [{**one, "kind": "power"} for one in document["soundings"]]
    document["unknown"] = {"gain": "none"}
    (tmp_path / "power" / "place.yaml").write_text(yaml.safe_dump(document))
    diagnosis = diagnosed(tmp_path / "power")
    text = render(diagnosis)
    assert "Power over time" in text and "What is left, before and after" not in text and "rms error of power" in text
    course = next(one for one in maps.courses(scene_of(diagnosis)) if one.link == "desk>sofa")
    heard = np.load(case / "office.npz")["response"][0]
    np.testing.assert_allclose(course.measured_db, 10 * np.log10((np.abs(heard) ** 2).mean(axis=1)), atol=1e-4)


def test_numbers_stand_to_the_digits_that_their_deviation_leaves():
    assert words.number(1.2636e-9, 4.2e-12, "s") == "1.2636 ± 0.0042 ns"
    assert words.number([0.0475, -0.0085, 0.0022], [0.0026, 0.0027, 0.0013], "m") == "(0.0475, -0.0085, 0.0022) ± 0.0027 m"
    assert words.number(3588313472.0, 21000.0, "Hz") == "3.588313 ± 0.000021 GHz"
    assert words.number([20.14, 11.36, 0.0], [0.014, 0.01, 1.0], "m") == "(20.140, 11.360, 0.000) ± 0.014 m"
    assert words.number(-0.001, 1.0, "dB") == "0.0 ± 1.0 dB"


def cube() -> np.ndarray:
    corner = np.array([[x, y, z] for z in (0, 2) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))], float)
    rings = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return np.array([corner[list(half)] for a, b, c, d in rings for half in ((a, b, c), (a, c, d))])


def test_a_cube_has_twelve_edges_and_its_section_is_a_square():
    sides = np.linalg.norm(np.diff(outline.edges(cube()), axis=1)[:, 0], axis=1)
    assert len(sides) == 12 and np.allclose(sides, 2)
    cut = outline.section(cube(), 1, 0.5)
    assert np.linalg.norm(np.diff(cut, axis=1)[:, 0], axis=1).sum() == pytest.approx(8) and np.all(cut[:, :, 1] == 0.5)


def test_a_click_on_a_link_shows_its_curves_and_the_toggle_the_corrected_twin(page, tmp_path):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("NO BROWSER: apt-get install chromium")
    click = """<script>document.querySelector('[data-link="desk>wall_east"]').dispatchEvent(new Event('click'));
document.querySelector('#show-after').click();document.title=all('.view').map(one=>getComputedStyle(one).display).join()</script>"""
    (tmp_path / "page.html").write_text(page.replace("</body>", click + "</body>"))
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/profile", "--dump-dom",
               str(tmp_path / "page.html")]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    chart = shown[shown.index('<div id="chart">') :].split("</div>")[0]
    assert "<h2>desk → wall_east</h2>" in chart and chart.count("<polyline") == 2
    assert re.search(r"<title>(.*?)</title>", shown)[1] == "none,inline,none,inline"
