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
from gr_cast.core.errors import CastError

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "docs"))
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
