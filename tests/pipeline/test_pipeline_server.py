# SPDX-License-Identifier: GPL-3.0-or-later
"""The server judges what is pushed and goes on after it was killed; Jenkins and Ansible read what is made for them."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from gr_cast.core.errors import CastError
from gr_cast.pipeline import document, jenkins, server, site
from ports import free_port

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "apps" / "cast_pipeline.py"
PLAYBOOK = ROOT / "python" / "gr_cast" / "pipeline" / "playbook.yaml"


def until(holds, seconds: float = 240.0):
    end = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
    return found


def fetched(address: str) -> str:
    try:
        return urllib.request.urlopen(address, timeout=30).read().decode()
    except OSError:
        return ""


def test_a_server_that_is_killed_in_mid_build_goes_on_and_its_page_shows_the_commit(stack, tmp_path):
    port = free_port()
    try:
        server.python()
    except CastError as error:
        pytest.skip(f"NO BUILDBOT: {error}")
    storage = tmp_path / "store"
    words = [sys.executable, PROGRAM, "serve", "--repository", stack.folder, "--sites", stack.sites, "--storage", storage]
    words += ["--port", str(port), "--poll", "1"]

    def served():
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)
        assert process.stdout.readline().startswith("builds: ")
        until(lambda: "running" in (storage / "server" / "twistd.log").read_text())
        return process

    def killed(process, number):
        os.killpg(process.pid, number)
        process.wait()
        process.stdout.close()

    def finished() -> set:
        return {path.name for path in storage.glob("stages/trial-*")}

    process = served()
    try:
        until(lambda: (storage / "server" / "twistd.log").read_text().count("gitpoller: processing changes") > 1)
        pushed = stack.commit("A word", src_send=("Node that sends", "The node that sends"))
        until(lambda: len(finished()) >= 2)
    finally:
        killed(process, signal.SIGKILL)
    assert not list(storage.glob(f"verdicts/*/{pushed}.json"))
    kept, since = finished(), time.time()
    process = served()
    try:
        verdict = until(lambda: list(storage.glob(f"verdicts/*/{pushed}.json")))[0]
        page = until(lambda: pushed[:10] in (text := fetched(f"http://127.0.0.1:{port + 1}/")) and text)
        builds = json.loads(fetched(f"http://127.0.0.1:{port}/api/v2/builds"))["builds"]
    finally:
        killed(process, signal.SIGTERM)
    assert json.loads(verdict.read_text())["kinds"] == ["same on both"] and "A word" in page
    assert len(builds) >= 2, "the build that was cut, and the one that went on"
    assert all((storage / "stages" / name).stat().st_ctime < since for name in kept), "what was done is not done again"


def test_without_buildbot_the_line_that_installs_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_SERVER", str(tmp_path / "python"))
    with pytest.raises(CastError, match="no Buildbot here: bash apps/install_raytracer.sh --server"):
        server.python()


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("sqlite:///state.sqlite", None),
        (
            "postgresql+pg8000://ci@host/ci",
            "--database: its driver pg8000 is not beside Buildbot: .*python.* -m pip install pg8000$",
        ),
        ("ci@host", "--database: got 'ci@host': Could not parse"),
    ],
)
def test_a_database_that_buildbot_cannot_open_is_one_line_that_says_what_to_install(address, words):
    try:
        server.python()
    except CastError as error:
        pytest.skip(f"NO BUILDBOT: {error}")
    if words is None:
        return server.check_database(address)
    with pytest.raises(CastError, match=words):
        server.check_database(address)


def test_jenkins_job_builder_makes_a_job_that_calls_the_program_for_the_commit(tmp_path):
    tool = shutil.which("jenkins-jobs")
    if tool is None:
        pytest.skip("NO JENKINS-JOB-BUILDER: apt-get install jenkins-job-builder")
    pipeline = document.read(ROOT / "docs" / "examples" / "stack")
    text = jenkins.job(pipeline, "ssh://git@host/stack.git", ["main", "next"], ["cast_pipeline"], ["--storage", "/nas/a b"])
    (tmp_path / "job.yaml").write_text(text)
    shown = subprocess.run([tool, "test", "job.yaml"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert shown.returncode == 0, shown.stderr
    assert "cast_pipeline run &quot;$GIT_COMMIT&quot; --repository ssh://git@host/stack.git --storage '/nas/a b'" in shown.stdout
    assert shown.stdout.count("<name>main</name>") == shown.stdout.count("<name>next</name>") == 1


def test_ansible_reads_the_playbook_and_its_inventory(tmp_path):
    tool = shutil.which("ansible-playbook")
    if tool is None:
        pytest.skip("NO ANSIBLE: apt-get install ansible")
    inventory = ROOT / "docs" / "examples" / "hosts.yaml"
    told = subprocess.run([tool, "--syntax-check", "-i", inventory, PLAYBOOK], capture_output=True, text=True, timeout=120)
    assert told.returncode == 0, told.stdout + told.stderr
    sites = tmp_path / "not there yet"
    words = [tool, "-i", inventory, "--tags", "sites", "-e", json.dumps({"sites": str(sites), "pipeline": "none"}), PLAYBOOK]
    told = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert told.returncode == 0, told.stdout + told.stderr
    arena = site.read(sites / "arena.yaml")
    assert arena.program == "cast_pipeline radios" and arena.place("2").device == "addr=192.168.50.2,rx_gain=20,rx_antenna=RX2"
    assert arena.place("1").interface == "eth2" != site.read(sites / "box.yaml").place("1").interface
