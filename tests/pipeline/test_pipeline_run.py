# SPDX-License-Identifier: GPL-3.0-or-later
"""A commit from its sources to its verdict, against a testbed by closed formulas."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from gr_cast.core.errors import CastError
from gr_cast.pipeline import clean
from gr_cast.pipeline.bisect import bisect
from stack_faults import GAIN, SCRAMBLER, harmless

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_pipeline.py"


def test_one_tree_has_one_image_whoever_builds_it_and_wherever(stack, tmp_path):
    kinds = ["process", "auto"]
    images = [stack.bench(tmp_path / kind, kind).commit("HEAD").built["image"] for kind in kinds]
    other = stack.commit("A word", src_send=(r"Node that sends", "The node that sends"))
    assert images[0] == images[1] != stack.bench(tmp_path / "auto").commit(other).built["image"]
    path = tmp_path / "auto" / "images" / f"{images[0]}.tar"
    assert hashlib.sha256(path.read_bytes()).hexdigest() == images[0]
    listed = subprocess.run(["tar", "-tvf", path], capture_output=True, text=True, check=True).stdout
    assert "bin/viterbi.so" in listed and "src/" not in listed and all("root/root" in line for line in listed.splitlines())
    about = json.loads(path.with_suffix(".json").read_text())
    assert about["commit"] == stack.git("rev-parse", "HEAD~1") and "GCC" in about["software"]["gcc"].upper() + "GCC"
    assert set(about["software"]) == {"gcc", "make", "python3", "python3-numpy", "python3-yaml"}


def rooms() -> list:
    """Every kind of room that this machine has; LXC with the root file system CAST_ROOT_FILESYSTEM."""
    root = os.environ.get("CAST_ROOT_FILESYSTEM")
    kinds = ["process", *(["namespaces"] if clean.has_namespaces() else []), *(["lxc"] if root else [])]
    return [clean.chosen(kind, Path(root) if root else None) for kind in kinds]


@pytest.mark.parametrize("room", rooms(), ids=lambda room: room.kind)
def test_a_room_shows_a_command_nothing_of_the_caller_and_leaves_nothing_running(room, tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "told")
    (tmp_path / "stack").mkdir()
    done = room.run(
        tmp_path, "env; grep -o '^ *[a-z0-9]*:' /proc/net/dev; pwd", within="stack", environment={"A": "b"}, timeout_s=60
    )
    lines = done.log.splitlines()
    assert done.status == 0 and "SECRET" not in done.log and "A=b" in lines
    if room.kind != "process":
        assert lines[-1] == "/mnt/stack" and [line.strip() for line in lines if line.endswith(":")] == ["lo:"]
    mark = f"60.{os.getpid()}"
    late = room.run(tmp_path, f"sleep {mark} & sleep {mark}", within="stack", environment={}, timeout_s=1.0)
    assert late.status is None
    until = time.monotonic() + 20
    while subprocess.run(["pgrep", "-f", f"sleep {mark}"], capture_output=True).returncode == 0:
        assert time.monotonic() < until, "it still sleeps"
        time.sleep(0.1)


def test_equal_sites_are_the_same_and_a_hidden_amplifier_is_named(stack, tmp_path):
    stack.testbed()
    assert stack.bench(tmp_path / "store").commit("HEAD").judged()["kinds"] == ["same on both"]
    stack.testbed("amplifier")
    found = stack.bench(tmp_path / "store").commit("HEAD").judged()
    assert found["kinds"] == ["twin and testbed differ"]
    assert found["verdicts"][0]["cause"]["families"][0] == "pa_nonlinearity" and found["verdicts"][0]["cause"]["kind"] == "radio"


def test_a_scrambler_that_only_long_frames_notice_is_worse_at_both_sites_since_its_commit(stack, tmp_path):
    stack.testbed()
    bench = stack.bench(tmp_path / "store")
    assert bench.commit("HEAD").judged()["kinds"] == ["same on both"]
    bad = stack.commit("Scramble on", **SCRAMBLER)
    after = stack.commit("A word", src_send=(r"Node that sends", "The node that sends"))
    bench.source.update()
    found = bench.commit(bad).judged()
    assert found["kinds"] == ["worse than its parent"] * 2 and {one["since"] for one in found["verdicts"]} == {bad}
    assert "loss of node 2 in long frames: +1" in found["verdicts"][0]["sentence"]
    assert {one["since"] for one in bench.commit(after).judged()["verdicts"]} == {bad}


def test_bisection_finds_the_first_bad_commit_in_as_few_runs_as_halving_needs(stack, tmp_path):
    stack.testbed()
    commits = [stack.commit(f"Commit {k}", **(SCRAMBLER if k == 5 else harmless(k))) for k in range(1, 7)]
    found = bisect(stack.bench(tmp_path / "store"), "HEAD~6", "HEAD")
    assert found.suspects == (commits[4],) and len(found.tried) <= 1 + 3
    assert any("loss of node 2 in long frames: +1" in line for line in found.symptoms)


def test_a_gain_that_only_clips_on_the_testbed_is_named_and_laid_to_its_commit(stack, tmp_path):
    stack.testbed("rails")
    bench = stack.bench(tmp_path / "store")
    assert bench.commit("HEAD").judged()["kinds"] == ["same on both"]
    louder = stack.commit("Louder", **GAIN)
    bench.source.update()
    found = next(one for one in bench.commit(louder).judged()["verdicts"] if one["kind"] == "twin and testbed differ")
    assert found["cause"]["families"][0] == "adc_clipping" and found["since"] == louder
    assert "the commit brings it out" in found["sentence"]


def test_what_fails_is_named_with_its_command_and_its_last_word(stack, tmp_path):
    first = stack.commit("Typo", src_send=(r"import os", "import oz"))
    second = stack.commit("Untested", pipeline=(r"make check", "exit 3"))
    bench = stack.bench(tmp_path / "store")
    said = [bench.commit(name).judged()["verdicts"][0] for name in (first, second)]
    assert {one["kind"] for one in said} == {"fails"}
    assert "node 1: python3 bin/send.py: status 1: ModuleNotFoundError: No module named 'oz'" in said[0]["sentence"]
    assert "test: exit 3: status 3" in said[1]["sentence"]


def test_what_a_limit_stops_is_no_verdict_of_a_commit_and_is_done_again(stack, tmp_path):
    """A machine that is slow for a while: the flag in the repository's folder stands for its load."""
    load = tmp_path / "load"
    load.touch()
    slow = f"import os, time\ntime.sleep(60 if os.path.exists({str(load)!r}) else 0)\nimport os"
    first = stack.commit("Limits", src_send=(r"import os", slow), pipeline=(r"sites:", "limits: {command_s: 1}\nsites:"))
    second = stack.commit("A word", src_send=(r"Node that sends", "The node that sends"))
    bench = stack.bench(tmp_path / "store", "process")
    found = bench.commit(first).judged()
    assert found["kinds"] == ["not decidable"] * 2, found["verdicts"]
    for words in ("node 1: python3 bin/send.py: stopped after 1.0006 s", "limits.command_s in pipeline.yaml, or --patience"):
        assert words in found["verdicts"][0]["sentence"]
    kept = [json.loads(path.read_text()) for path in (tmp_path / "store" / "stages").glob("trial-*/result.json")]
    assert not [one for one in kept if one["fails"]]
    with pytest.raises(CastError, match="stopped after 1.0006 s"):
        bisect(bench, first, second)
    load.unlink()
    patient = replace(bench, patience=30.0)  # where these tests run, a machine is busy
    after = patient.commit(second).judged()
    assert after["kinds"] == ["same on both"] and after["compared"]
    assert patient.commit(first).judged()["kinds"] == ["same on both"]


def test_a_child_of_what_was_stopped_is_not_called_the_same(stack, tmp_path):
    slow = stack.commit("Slow", src_send=(r"import os", "import time\ntime.sleep(60)\nimport os"),
                        pipeline=(r"sites:", "limits: {command_s: 1}\nsites:"))  # fmt: skip
    quick = stack.commit("Quick", src_send=(r"import time\ntime.sleep\(60\)\n", ""), pipeline=(r"command_s: 1", "command_s: 60"))
    found = stack.bench(tmp_path / "store").commit(quick).judged()
    assert found["kinds"] == ["not decidable"] and slow[:10] in found["verdicts"][0]["sentence"]
    assert found["inputs"] is None, "nor is it kept as the last word"


@pytest.mark.parametrize("what", ["build", "test"])
def test_a_build_that_its_limit_stops_is_built_again(stack, tmp_path, what):
    flag = tmp_path / "load"
    flag.touch()
    line = f"[ ! -e {flag} ] || sleep 60"
    change = {"build": (r"build: \[make\]", f"limits: {{build_s: 1}}\nbuild: ['{line}', make]"),
              "test": (r"test: \[make check\]", f"limits: {{build_s: 1}}\ntest: ['{line}']")}  # fmt: skip
    name = stack.commit("Slow", pipeline=change[what])
    bench = replace(stack.bench(tmp_path / "store", "process"), patience=1.0)
    found = bench.commit(name).judged()
    assert found["kinds"] == ["not decidable"] and "limits.build_s" in found["verdicts"][0]["sentence"]
    flag.unlink()
    assert replace(bench, patience=60.0).commit(name).built["fails"] is None


def test_a_command_that_waits_for_a_processor_is_not_stopped_for_it(tmp_path):
    """Three others want the same processor: what needs 1 s of it takes 4 s on the wall, and may have 2.5 s."""
    (tmp_path / "stack").mkdir()
    here = str(min(os.sched_getaffinity(0)))
    spin = ["taskset", "-c", here, sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(spin, start_new_session=True) for _ in range(3)]
    try:
        work = f"taskset -c {here} {sys.executable} -c 'import time\nwhile time.process_time() < 1: pass'"
        done = clean.chosen("auto").run(tmp_path, work, within="stack", environment={}, timeout_s=2.5)
        idle = clean.chosen("auto").run(tmp_path, "sleep 60", within="stack", environment={}, timeout_s=1.5)
    finally:
        for one in busy:
            one.kill()
            one.wait()
    assert done.status == 0 and done.wall_s > 2.5, done
    assert idle.status is None and idle.wall_s < 10, "who sleeps does not wait"


def test_what_a_machine_lacks_is_named_before_anything_is_built(stack, tmp_path):
    stack.commit("Needs", pipeline=(r"\[gcc, make", "[gcc, no-such-package, make"))
    stack.commit("System", pipeline=(r"debian-12", "hurd-1"))
    with pytest.raises(CastError) as error:
        stack.bench(tmp_path / "store").commit("HEAD").judged()
    assert len(error.value.faults) == 2 and "no-such-package is not installed" in str(error.value)
    assert not list((tmp_path / "store" / "images").iterdir())


def test_a_killed_run_goes_on_where_it_was_and_in_the_end_nothing_of_it_is_left(stack, tmp_path, monkeypatch):
    passing = tmp_path / "passing"
    passing.mkdir()
    monkeypatch.setenv("TMPDIR", str(passing))
    words = [
        sys.executable,
        PROGRAM,
        "run",
        "HEAD",
        "--repository",
        stack.folder,
        "--storage",
        tmp_path / "store",
        "--sites",
        stack.sites,
    ]
    begun = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    said = []
    for line in begun.stdout:
        said.append(line.strip())
        if "repeat 3" in line:
            os.kill(begun.pid, signal.SIGKILL)
            break
    begun.wait()
    begun.stdout.close()
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and "same on both" in done.stdout, done.stderr
    again = done.stdout.splitlines()
    assert len(said) > 2 and not set(said[:-1]) & {line for line in again if "repeat" in line}
    assert [*passing.iterdir(), *(tmp_path / "store").rglob(".aside-*")] == []
    assert said[-1] in again, "what was cut is done again"
    assert not [path for path in (tmp_path / "store" / "stages").iterdir() if path.name.startswith(".")]
