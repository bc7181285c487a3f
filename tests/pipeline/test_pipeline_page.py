# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of commits × sites, as a browser shows it."""

import json
import re
import shutil
import subprocess
from html import unescape

import numpy as np
import pytest
from gr_cast.pipeline.stages import histories
from gr_cast.report import commits


def verdict(number: int, parent: int | None, *told, time_s: int = 0) -> dict:
    kinds = [kind for kind, *_ in told]
    entries = [{"kind": k, "site": s, "sentence": t, "since": None, "cause": {"folder": f} if f else None} for k, s, t, f in told]
    difference = {"mean": 0.5, "low": 0.4, "high": 0.6, "std": 0.1, "n": 4}
    compared = {
        "against": "sites", "site": "testbed", "experiment": "long", "node": "2", "metric": "loss", "unit": "", "tolerance": 0.1,
        "difference": difference, "says": "beyond",
    }  # fmt: skip
    return {
        "cast_verdict": 1, "commit": str(number) * 40, "subject": f"Commit <{number}>", "time_s": time_s, "image": "ab" * 32,
        "parent": parent and str(parent) * 40, "baseline": None, "sites": ["twin", "testbed"], "kinds": kinds,
        "verdicts": entries, "room": "namespaces", "comparisons": [compared],
        "figures": [
            {"site": s, "experiment": "long", "metric": "2 loss", "values": [0.0, 0.1 * number]} for s in ("twin", "testbed")
        ],
    }  # fmt: skip


@pytest.fixture
def storage(tmp_path):
    """Three commits of one second; their names do not tell their order."""
    folder = tmp_path / "verdicts" / "wifi"
    folder.mkdir(parents=True)
    told = [
        verdict(9, None, ("same on both", None, "nothing", None)),
        verdict(1, 9, ("worse than its parent", "twin", "loss +0.5", None)),
        verdict(5, 1, ("twin and testbed differ", "testbed", "amplifier & more", "diagnosis-x")),
    ]
    for one in told:
        (folder / f"{one['commit']}.json").write_text(json.dumps(one))
    return tmp_path


def test_parents_come_before_their_children_whatever_the_clock_says(storage):
    assert [int(one["commit"][0]) for one in histories(storage)["wifi"]] == [9, 1, 5]


def test_a_browser_shows_every_commit_at_every_site_with_its_verdict(storage, tmp_path):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("NO BROWSER: apt-get install chromium")
    path = tmp_path / "index.html"
    path.write_text(commits.render(histories(storage)))
    widths = "onload = () => document.title = [...document.images].map(i => i.naturalWidth > 300)"
    path.write_text(path.read_text().replace("</body>", f"<script>{widths}</script></body>"))
    command = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={tmp_path}/profile",
        "--dump-dom",
        str(path),
    ]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    rows = re.findall(r'<tr id="(\w+)">(.*?)</td></tr>(?=<tr id|</tbody></table></div>)', shown, flags=re.S)
    marks = {int(name[0]): re.findall(r'class="mark \w+">(\w+)<', row) for name, row in rows}
    assert [*marks.items()] == [(5, ["same", "differs"]), (1, ["worse", "same"]), (9, ["same", "same"])]
    assert "amplifier & more" in unescape(shown) and "Commit <5>" in unescape(shown)
    assert 'href="stages/diagnosis-x/diagnosis/report.html"' in shown
    assert re.search(r"<title>true</title>", shown), "the picture is drawn"


def test_a_storage_without_commits_has_a_page_that_says_so(tmp_path):
    assert "No commit has been judged yet" in commits.render(histories(tmp_path))


@pytest.mark.parametrize("count", [1, 3])
def test_sites_of_one_commit_stand_together_over_its_name(count):
    lines = {site: [(place, [1.0, 2.0]) for place in range(count)] for site in ("twin", "testbed")}
    (axes,) = commits._trend(("short", "2 loss"), lines, ["abc"] * count).axes
    left, right = axes.get_xlim()
    for container in axes.containers:
        away = np.abs(container[0].get_xdata() - np.arange(count)) / (right - left)
        assert away.max() < 0.05
