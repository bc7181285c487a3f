# SPDX-License-Identifier: GPL-3.0-or-later
"""The documents are a site that builds without a network; schemas say what the strict reader says; links lead somewhere."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from gr_cast.core import documents
from gr_cast.core.documents import Reader
from gr_cast.core.errors import CastError
from gr_cast.twin.contract import Known, check_effects
from gr_cast.twin.effects import FAMILIES, NAMED

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "docs"))
import effect_schemas
import schemas

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("docs/reference/*.md")])


@pytest.mark.parametrize("name", schemas.FORMATS)
def test_a_schema_takes_what_the_reader_takes_and_refuses_what_it_refuses(name, tmp_path):
    """Examples pass; each with a key that nobody knows, or text for a number, is refused by both."""
    jsonschema = pytest.importorskip("jsonschema", reason="NO JSONSCHEMA: schemas are not held against the reader")
    schema, (_, read, examples) = schemas.made(name), schemas.FORMATS[name]
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    assert schema["additionalProperties"] is False and len(examples) > 1
    for path in examples:
        document = documents.yaml_file(path).document
        assert not list(check.iter_errors(document)), path
        version = next(key for key in document if key.startswith("cast_"))
        number = next(
            key
            for key in ("duration_s", "base_loss_db", "sample_rate_hz", "noise_power_db", "twin", "sampling")
            if key in {*document, "sampling"}
        )
        for wrong in (document | {"nobody_knows": 1}, document | {version: 7}, document | {number: ["many"]}):
            assert list(check.iter_errors(wrong)), wrong
            (tmp_path / "wrong.yaml").write_text(documents.yaml_text(wrong))
            with pytest.raises(CastError):
                read(tmp_path / "wrong.yaml")


def value_of(value):
    """One that a family's parameter or number of its model may have."""
    if value.words:
        return value.words[0]
    if value.kind is not float:
        return value.kind(True) if value.kind is bool else "code"
    plain = max(value.low, min(value.high, 1))
    plain = round(plain) if value.whole else plain
    return [plain] if value.many else plain


@pytest.mark.parametrize("family", NAMED)
def test_schema_and_reader_take_and_refuse_the_same_entries_of_a_family(family):
    jsonschema = pytest.importorskip("jsonschema", reason="NO JSONSCHEMA: schemas are not held against the reader")
    check = jsonschema.Draft202012Validator(effect_schemas.entry())
    check.check_schema(check.schema)
    known = Known(nodes=("a", "b"), links=(("a", "b"),), waveforms=("code",), rate_hz=2e6)
    about = FAMILIES[family]

    def faults(entry):
        reader = Reader("twin.yaml")
        check_effects(reader, [entry], known)
        return len(reader.faults) > 0, bool(list(check.iter_errors(entry)))

    level = about.owners[0]
    owner = {"level": level, "name": {"link": "a>b", "environment": "environment"}.get(level, "a")}
    parameters = {name: value_of(value) for name, value in about.parameters.items()}
    model = {name: value_of(value) for name, value in about.remembered.items()}
    good = {"family": family, "owner": owner, "parameters": parameters, "model": model}
    contradicts = about.contradiction(parameters, model) is not None
    assert faults(good) == (contradicts, False)
    wrong = [
        good | {"parameters": parameters | {"nobody_knows": 1}},
        good | {"model": model | {"nobody_knows": 1}},
        good | {"family": f"{family}s"},
        good | {"owner": owner | {"level": "nobody"}},
        good | {"nobody_knows": 1},
        *(good | {"parameters": parameters | {name: {"value": []}}} for name in parameters),
        *(
            good | {"parameters": parameters | {name: value.low - 1}}
            for name, value in about.parameters.items()
            if value.low == 0
        ),
    ]
    for entry in wrong:
        assert faults(entry) == (True, True), entry


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_links_between_documents_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not re.match(r"[a-z]+:", target):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_site_builds_without_warnings(tmp_path):
    """The notebooks are not run again here: tests/test_notebooks.py does."""
    for module in ("sphinx", "myst_parser", "nbsphinx"):
        pytest.importorskip(module, reason=f"NO {module.upper()}: the site is not built")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-D",
        "nbsphinx_execute=never",
        "-d",
        tmp_path / "trees",
        ROOT / "docs",
        tmp_path / "site",
    ]
    environment = os.environ | {"HOME": str(tmp_path), "IPYTHONDIR": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, env=environment)
    assert done.returncode == 0, done.stderr[-4000:]
    site = tmp_path / "site"
    assert all((site / "notebooks" / f"{path.stem}.html").is_file() for path in ROOT.glob("docs/notebooks/*.ipynb"))
    assert "gr_cast.sounding.sound.sound" in (site / "reference" / "api.html").read_text()
    assert json.loads((site / "schemas" / "twin.schema.json").read_text())["title"].startswith("A twin")


def test_the_flowgraph_of_the_first_hour_runs_as_it_is_typed(tmp_path):
    """Where nothing of gr-cast is installed or on a path."""
    row = next(line for line in (ROOT / "docs/first_hour.md").read_text().splitlines() if "| a flowgraph" in line)
    typed = [command.replace("/tmp", str(tmp_path)) for command in re.findall("`(.+?)`", row)]
    clean = {"PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    done = subprocess.run(["bash", "-ec", "\n".join(typed)], cwd=ROOT, env=clean, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "loopback_headless.py").is_file() and not (ROOT / "loopback.cf32").exists()
