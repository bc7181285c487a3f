# SPDX-License-Identifier: GPL-3.0-or-later
"""What packages say of the project is what the project is: version, licence, dependencies, blocks, recipes that hold."""

import importlib.util
import re
import shutil
import subprocess
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
    told = re.search(r"^## (\d\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[1]
    assert {VERSION, gr_cast.__version__, conda, debian, citation, told} == {VERSION}


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


# What PyBOMBS's own recipes (gr-recipes of March 2026) call what this project needs.
PYBOMBS = {"gnuradio", "numpy", "pybind11", "python-matplotlib", "python-zmq", "pyyaml", "scipy", "zeromq"}


def test_pybombs_finds_every_recipe_that_ours_depends_on():
    recipe = yaml.safe_load((ROOT / "packaging/pybombs/gr-cast.lwr").read_text())
    assert set(recipe["depends"]) == PYBOMBS and recipe["inherit"] == "cmake"
    told = (ROOT / "docs/packages.md").read_text()
    assert "source" in recipe or "pybombs config --package gr-cast source" in told  # without one it has no install method


def test_conda_builds_with_what_debian_builds_with():
    """GNU Radio's configuration for CMake asks for its own dependencies again: what Debian's build needs, conda's does."""
    recipe = (ROOT / "packaging/conda/meta.yaml").read_text()
    needed = (ROOT / "debian/control").read_text().split("Standards-Version")[0]
    same = {"libgmp-dev": "gmp", "libsndfile1-dev": "libsndfile", "libspdlog-dev": "spdlog", "libzmq3-dev": "zeromq"}
    same |= {"pybind11-dev": "pybind11", "python3-zmq": "pyzmq", "python3-yaml": "pyyaml", "gnuradio-dev": "gnuradio-core"}
    host = recipe.split("host:")[1].split("run:")[0]
    assert {ours for debian, ours in same.items() if debian in needed} == {
        ours for ours in same.values() if re.search(rf"- {ours}\b", host)
    }


def conda_recipe() -> dict:
    """The recipe as conda-build renders it."""
    jinja2 = pytest.importorskip("jinja2", reason="NO JINJA2: conda's recipe is not rendered")
    text = (ROOT / "packaging/conda/meta.yaml").read_text()
    names = {"compiler": lambda language: f"{language}_compiler", "stdlib": lambda language: f"{language}_stdlib"}
    return yaml.safe_load(jinja2.Environment(undefined=jinja2.StrictUndefined).from_string(text).render(names))


def test_the_conda_recipe_renders_to_what_conda_forge_asks_for():
    recipe = conda_recipe()
    assert list(recipe) == ["package", "source", "build", "requirements", "test", "about", "extra"]
    assert recipe["package"] == {"name": "gnuradio-cast", "version": VERSION}
    assert (ROOT / "packaging/conda" / recipe["source"]["path"]).resolve() == ROOT and recipe["build"]["number"] == 0
    assert (ROOT / recipe["about"]["license_file"]).is_file() and recipe["about"]["license"] in (
        ROOT / "python/gr_cast/__init__.py"
    ).read_text()
    for stage, names in recipe["requirements"].items():
        assert len(names) == len(set(names)) and all(re.fullmatch(r"[a-z0-9_-]+( \S+)?", name) for name in names), stage
    assert {name.split()[0] for name in recipe["requirements"]["run"]} <= {
        name.split()[0] for name in recipe["requirements"]["host"]
    }


def test_what_the_conda_recipe_tries_is_there():
    tried = conda_recipe()["test"]
    for name in tried["imports"]:
        assert name == "gnuradio.cast" or importlib.util.find_spec(name)
    for program, *_ in map(str.split, tried["commands"]):
        assert (ROOT / "apps" / f"{program}.py").is_file()


def test_conda_smithy_lints_the_recipe():
    if not (smithy := shutil.which("conda-smithy")):
        pytest.skip("NO CONDA-SMITHY: conda's recipe is not linted")
    told = subprocess.run([smithy, "recipe-lint", ROOT / "packaging/conda"], capture_output=True, text=True)
    assert told.returncode == 0 and "is in fine form" in told.stdout, told.stdout + told.stderr


def test_pybombs_lints_the_recipe():
    if not (pybombs := shutil.which("pybombs")):
        pytest.skip("NO PYBOMBS: its recipe is not linted")
    told = subprocess.run([pybombs, "lint", ROOT / "packaging/pybombs/gr-cast.lwr"], capture_output=True, text=True)
    assert "Linting recipe" in told.stdout and "BAD]" not in told.stdout + told.stderr
