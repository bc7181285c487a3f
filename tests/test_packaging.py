# SPDX-License-Identifier: GPL-3.0-or-later
"""What packages say of the project is what the project is: version, licence, dependencies, blocks, recipes that hold."""

import re
from pathlib import Path

import gr_cast
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
VERSION = re.search(r"project\(gr-cast VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())[1]


def test_one_version_is_named_everywhere():
    conda = re.search(r'set version = "([^"]+)"', (ROOT / "packaging/conda/meta.yaml").read_text())[1]
    debian = re.match(r"gr-cast \(([^-]+)-", (ROOT / "debian/changelog").read_text())[1]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    assert {VERSION, gr_cast.__version__, conda, debian, citation} == {VERSION}


def test_the_manifest_is_one_that_cgran_reads():
    head, body = (ROOT / "MANIFEST.md").read_text().split("---\n")
    manifest = yaml.safe_load(head)
    assert {"title", "brief", "tags", "author", "copyright_owner", "license", "gr_supported_version", "dependencies"} <= set(
        manifest
    )
    blocks = [yaml.safe_load(path.read_text())["label"] for path in ROOT.glob("grc/*.block.yml")]
    assert all(label in body or "(ZMQ)" in label for label in blocks)


def test_packages_need_what_the_programs_import():
    """Every Python package that is imported outside a function, of those that do not come with Python."""
    found = set()
    for path in [*ROOT.glob("python/gr_cast/**/*.py"), *ROOT.glob("apps/*.py")]:
        found |= set(re.findall(r"^(?:from|import) (numpy|scipy|matplotlib|yaml|zmq)\b", path.read_text(), flags=re.M))
    control = (ROOT / "debian" / "control").read_text().split("Package: gr-cast")[1]
    container = (ROOT / "packaging" / "Containerfile").read_text()
    setup = (ROOT / "apps" / "setup.sh").read_text()
    for package in sorted(f"python3-{name}" for name in found):
        assert package in control and package in container and package in setup


@pytest.mark.parametrize("path", ["CONTRIBUTING.md"])
def test_the_files_that_recipes_name_are_there(path):
    for name in re.findall(r"`((?:python|tests|docs|apps|grc)/[\w./]+)`", (ROOT / path).read_text()):
        assert (ROOT / name).exists() or "my_" in name, name
