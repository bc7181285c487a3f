# SPDX-License-Identifier: GPL-3.0-or-later
"""First mistakes: each message says what to type next, and typing it works."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cast_compare
import cast_diagnose
import cast_emulator
import cast_scenario
import cast_sounder
import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.report.link.page import EXPERIMENTS
from gr_cast.signals import codes

ROOT = Path(__file__).resolve().parents[2]


def test_a_scenario_without_its_link_is_told_the_links(tmp_path):
    two = ["four_tap", "four_tap", "--output", str(tmp_path)]
    with pytest.raises(CastError, match="four_tap: is a scenario: add --link 'TX>RX' of 1>2"):
        cast_compare.main(two)
    cast_compare.main([*two, "--link", "1>2"])


def test_a_link_that_the_shell_cut_is_told_of_quotes(tmp_path):
    with pytest.raises(CastError, match="got '1', needs TX>RX in quotes, for a shell takes > for itself; .* has 1>2, 2>1"):
        cast_sounder.main(["run", "--link", "1", "--output", str(tmp_path)])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["rx", "--carrier", "1G"], "unrecognized arguments: --carrier 1G; is --carrier-offset meant?"),
        (["run", "--frame", "9"], "unrecognized arguments: --frame 9; is --frames meant?"),
        (["run", "--scenaro=four_tap"], "unrecognized arguments: --scenaro=four_tap; is --scenario meant?"),
        (["run", "--zzzz"], r"unrecognized arguments: --zzzz \("),
    ],
    ids=lambda words: words[1] if isinstance(words, list) else "",
)
def test_the_beginning_of_an_option_is_not_taken_for_it_but_told(words, told, capsys):
    """A carrier would be taken for a carrier's offset, and 1 GHz for what an oscillator is off by."""
    with pytest.raises(SystemExit) as ended:
        cast_sounder.main(words)
    assert ended.value.code == 2
    assert re.search(told.replace("?", r"\?"), capsys.readouterr().err)


def test_a_raw_file_without_its_format_is_told_the_options(tmp_path):
    np.tile(codes.from_spec({"code": "glfsr", "degree": 8, "samples_per_chip": 1}), 5).astype(np.complex64).tofile(
        tmp_path / "x.bin"
    )
    told = ["process", str(tmp_path / "x.bin"), "--code", "glfsr:8", "--output", str(tmp_path / "out")]
    with pytest.raises(CastError, match=r"x.bin: raw samples \(no x.bin.sigmf-meta beside it\): add --format cf32\|.* --rate HZ"):
        cast_sounder.main(told)
    cast_sounder.main([*told, "--format", "cf32", "--rate", "1M"])


@pytest.mark.parametrize("name", ["arena", "street"])
def test_an_example_that_is_not_made_yet_is_told_how(name, tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_CATALOGUE", str(tmp_path))
    with pytest.raises(CastError, match=f"{name}: not made yet: cast_scenario create {name} makes it"):
        cast_scenario.main(["show", name])


@pytest.fixture
def unbuilt(tmp_path):
    """(folder, run): a checkout without its bindings, and a function that runs one of its programs there."""
    ignore = shutil.ignore_patterns("*.so", "__pycache__")
    shutil.copytree(ROOT / "python", tmp_path / "python", ignore=ignore)
    shutil.copytree(ROOT / "apps", tmp_path / "apps", ignore=ignore)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True, "timeout": 120, "check": False}
    return tmp_path, lambda program, *words: subprocess.run([sys.executable, tmp_path / "apps" / program, *words], **options)


def test_an_unbuilt_checkout_is_told_to_build(unbuilt):
    folder, run = unbuilt
    done = run("cast_sounder.py", "run", "--output", folder / "out")
    assert done.returncode == 2
    assert done.stderr == "error: this checkout is not built: bash apps/demo.sh installs what is missing and builds it\n"
    assert not (folder / "out").exists()


def test_cast_doctor_says_first_that_a_checkout_is_not_built(unbuilt):
    done = unbuilt[1]("cast_doctor.py")
    assert done.returncode == 1
    assert done.stdout.splitlines()[2:4] == [
        "MISSING  this checkout is not built",
        "         bash apps/demo.sh installs what is missing and builds it",
    ]


def test_a_python_without_the_packages_is_told_which_one_has_them(tmp_path):
    """As where a Python of one's own comes first on PATH: `python3 apps/cast_sounder.py`."""
    bare = tmp_path / "bare" / "bin" / "python3"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", bare.parents[1]], check=True)
    bare.unlink()
    shutil.copy(Path(sys.executable).resolve(), bare)  # a link would be the system's Python by another name
    for program in sorted(ROOT.glob("apps/cast_*.py")):
        told = subprocess.run([bare, program, "--version"], capture_output=True, text=True, timeout=60, check=False)
        assert (told.returncode, told.stdout) == (2, "") and told.stderr.count("\n") == 1, program
        assert told.stderr.startswith("error: no numpy, ") and told.stderr.endswith("run this with /usr/bin/python3\n")


def test_a_matrix_that_cannot_be_written_is_told_with_the_cause():
    with pytest.raises(OSError) as error:
        cast_scenario.main(["convert", "four_tap", "/proc/x.mat"])  # a folder that not even root can write to
    assert (error.value.filename, error.value.strerror) == ("/proc/x.mat", "No such file or directory")


def test_what_stays_open_names_both_families_and_the_experiment():
    """For whatever experiment a diagnosis may name there are words."""
    for name, words in EXPERIMENTS.items():
        pair = {"families": ["extra_path", "front_end_filter"], "record_next": name}
        (line,) = cast_diagnose._next({"ambiguous": [pair]})
        assert "extra_path or front_end_filter" in line and f"Record next: {words}" in line


def test_show_leaves_nothing_in_the_folder_unasked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cast_scenario.main(["show", "four_tap"])
    assert list(tmp_path.iterdir()) == []
    cast_scenario.main(["show", "four_tap", "--plot", "four.png"])
    assert [path.name for path in tmp_path.iterdir()] == ["four.png"]


@pytest.mark.parametrize("way", ["a folder before it", "on PATH", "installed, on PATH", "installed"])
def test_what_a_message_says_to_type_is_found_by_the_shell_that_reads_it(way, tmp_path):
    """The shell is the judge: the first words of what is to be typed are pasted, with --version."""
    apps, suffix = ROOT / "apps", ".py"
    if way.startswith("installed"):
        (tmp_path / "bin").mkdir()
        for name in ("cast_scenario", "cast_diagnose"):
            (tmp_path / "bin" / name).symlink_to(apps / f"{name}.py")
        apps, suffix = tmp_path / "bin", ""
    on_path = "on PATH" in way
    environment = os.environ | {"PATH": f"{apps if on_path else ''}:/usr/bin:/bin", "CAST_CATALOGUE": str(tmp_path)}
    program = f"cast_scenario{suffix}" if on_path else f"{os.path.relpath(apps, ROOT)}/cast_scenario{suffix}"
    shell = {"cwd": ROOT, "env": environment, "capture_output": True, "text": True, "timeout": 120}
    told = subprocess.run(["sh", "-c", f"{program} show arena"], **shell).stderr
    typed = re.search(r"not made yet: (\S+) create arena", told)[1]
    assert ("/" in typed) != on_path
    assert subprocess.run(["sh", "-c", f"{typed} --version"], **shell).stdout.startswith("cast_scenario ")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("cast_scenario.py", "no command: list, show, .*create"),
        ("cast_pipeline.py", "no command: .*bisect, "),
        ("cast_emulator.py run four_tap --rate 11.52", "argument --rate: got 11.52, .*is 11.52M meant"),
        ("cast_diagnose.py", "required: CASE, --output"),
        ("cast_sounder.py heatmap x --scenario street", "unrecognized arguments: --scenario street"),
    ],
)
def test_a_wrong_argument_is_one_line_that_is_not_drowned(words, told):
    """The help that is named lists what the command takes."""
    program, *arguments = words.split()
    of = " ".join(words.split()[:2])
    done = subprocess.run([sys.executable, ROOT / "apps" / program, *arguments], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and re.fullmatch(rf"error: .*{told}.* \({of} --help\)\n", done.stderr)


@pytest.mark.parametrize(("words", "told"), [
    (["--rate=-100M"], "--rate: got -1e+08 Hz, needs 0.001 to 1e+15 Hz"),
    (["--rate", "0"], "--rate: got 0 Hz, needs 0.001 to 1e+15 Hz"),
    (["--rate", "1e30"], "--rate: got 1e+30 Hz, needs 0.001 to 1e+15 Hz"),
    (["--rate", "1M", "--duration", "0"], "--duration: got 0.0 s of 1e+06 Hz, needs more than 0 s and less than 1e12 samples"),
    (["--rate", "1M", "--output", "taken"], "--output: .*taken: is a file, needs a folder"),
])  # fmt: skip
def test_what_is_wrong_with_a_batch_is_told_of_what_is_wrong(words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    common = ["batch", "four_tap", "--transmit", "1=glfsr:8", "--duration", "0.0002", "--output", "out"]
    with pytest.raises(CastError) as error:
        cast_emulator.main([*common, *words])
    assert len(error.value.faults) == 1 and re.search(told.replace("+", r"\+"), error.value.faults[0])


@pytest.mark.parametrize("rate", ["-5", "0"])
def test_a_rate_that_none_can_sound_with_is_told(rate, tmp_path):
    with pytest.raises(CastError, match=f"^--rate: got {rate} Hz, needs more than 0 Hz$"):
        cast_sounder.main(["run", "--scenario", "four_tap", "--rate", rate, "--output", str(tmp_path / "out")])


@pytest.mark.parametrize(
    "words", [["plan", "street", "--json"], ["plan", "street", "--plot"], ["heat", "street", "--from", "x", "--plot"]]
)
def test_where_nothing_can_be_written_nothing_is_computed(words, tmp_path, monkeypatch):
    (tmp_path / "taken").touch()
    monkeypatch.setattr(cast_scenario.model, "read", lambda spec: pytest.fail("read"))
    with pytest.raises(CastError, match="taken: is a file, needs a folder"):
        cast_scenario.main([*words, str(tmp_path / "taken" / "x.json")])
