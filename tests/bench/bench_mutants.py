#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""How many small faults the tests see: mutants of the code, drawn at random, each run against the tests that meet it.

A mutant is killed when a test fails, or hangs. Works on a copy; nothing here is touched. Python is mutated by Cosmic Ray
(apps/requirements/mutants.lock), C++ by the few rules below. Places are drawn first, then one of the faults that fit there, so
that a sum, which has twelve, counts as much as a comparison. Of a Python part those tests are run that called the mutated
function, the quickest first, then those that start programs: no other can tell (mutants/runner.py).

    python3 -m venv --system-site-packages build/mutants
    build/mutants/bin/python -m pip install --require-hashes -r apps/requirements/mutants.lock
    build/mutants/bin/python tests/bench/bench_mutants.py --mutants 100
"""

import argparse
import ast
import json
import math
import os
import random
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path("build/python/gr_cast")
RUNNER = Path(__file__).resolve().parent / "mutants/runner.py"
# Part: what is mutated, what is run. Of kernels the C++ tests run, too.
VALUES = "tests/test_values.py"
PARTS = {
    "sounder": (["sounding/*.py"], ["tests/sounding", "tests/apps/test_cast_sounder.py", VALUES]),
    "emulator": (["emulation/*.py"], ["tests/emulation", "tests/blocks/test_emulator_kernel.py", VALUES]),
    "playback": (["twin/playback.py"], ["tests/twin/test_playback.py", VALUES]),
    "scenario": (
        ["scenario/model.py", "scenario/yaml_file.py", "scenario/colosseum.py", "scenario/mat_file.py", "scenario/catalogue.py"],
        [f"tests/scenario/test_{name}.py" for name in ("model", "yaml_file", "colosseum", "catalogue")] + [VALUES],
    ),
    "comparing": (["comparing/*.py"], ["tests/comparing", "tests/apps/test_cast_compare.py", VALUES]),
    "kernels": (
        ["emulator.cc", "overlap_save.cc", "vector_kernels_body.h"],
        [f"tests/blocks/test_{name}.py" for name in ("emulator_kernel", "channel_emulator", "levels")],
    ),
}
CONFIGURED = ("-DCMAKE_LINK_DEPENDS_NO_SHARED=ON",)  # bindings load what is new without being linked again
FAULTS = [  # of C++: what is found, what stands there instead
    (r" < ", (" <= ",)),
    (r" <= ", (" < ",)),
    (r" > ", (" >= ",)),
    (r" >= ", (" > ",)),
    (r" == ", (" != ",)),
    (r" != ", (" == ",)),
    (r" && ", (" || ",)),
    (r" \|\| ", (" && ",)),
    (r" \+ ", (" - ",)),
    (r" - ", (" + ",)),
    (r" \* ", (" / ",)),
    (r" / ", (" * ",)),
    (r"\bmin\b", ("max",)),
    (r"\bmax\b", ("min",)),
    (r"\btrue\b", ("false",)),
    (r"\bfalse\b", ("true",)),
    (r"(?<![\w.])[0-9]+(?![\w.])", ("+1", "-1")),
]
HINTS = ("#", "//", "UNROLL", "constexpr double", "double ")  # to the compiler, and costs of the planner: no law


@dataclass(frozen=True)
class Mutant:
    path: Path
    line: int
    text: str  # of the whole file

    def change(self) -> str:
        """The line before and after."""
        before, after = (text.split("\n")[self.line - 1].strip() for text in (self.path.read_text(), self.text))
        return f"{self.path.name}:{self.line}: {before}  →  {after}"


def _annotations(source: str) -> set[tuple[int, int]]:
    """Starts of what only tells types: (line, column) of every node."""
    told = []
    for node in ast.walk(ast.parse(source)):
        told += [getattr(node, name) for name in ("annotation", "returns") if getattr(node, name, None) is not None]
    return {(n.lineno, n.col_offset) for tree in told for n in ast.walk(tree) if hasattr(n, "lineno")}


def python_mutants(path: Path, rng: random.Random):
    """One mutant for every place of a file that a fault fits in, in random order."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator, operator_names

    source = path.read_text()
    types, places = _annotations(source), {}
    for name in sorted(operator_names()):
        operator = get_operator(name)
        if operator.arguments() or name.endswith("NoOp"):
            continue
        tree = get_ast(source)
        found = (place for node in ast_nodes(tree) for place in operator().mutation_positions(node))
        for occurrence, (start, _) in enumerate(found):
            places.setdefault(start, []).append((operator, occurrence))
    drawn = [place for place in places if not any(place[0] == line and place[1] >= column for line, column in types)]
    rng.shuffle(drawn)
    for place in drawn:
        operator, occurrence = rng.choice(places[place])
        text = mutate_code(source, operator(), occurrence)
        if text is not None and text != source:
            changed = next(n for n, (a, b) in enumerate(zip(source.split("\n"), text.split("\n"), strict=False), 1) if a != b)
            yield Mutant(path, changed, text)


def cpp_mutants(path: Path, rng: random.Random):
    source = path.read_text()
    lines = source.split("\n")
    places = [
        (number, found, fault)
        for number, line in enumerate(lines, 1)
        if not line.lstrip().startswith(HINTS)
        for pattern, others in FAULTS
        for found in re.finditer(pattern, line.split("//")[0])
        for fault in [rng.choice(others)]
    ]
    rng.shuffle(places)
    for number, found, fault in places:
        line = lines[number - 1]
        new = str(int(found[0]) + int(fault)) if fault in ("+1", "-1") else fault
        text = "\n".join([*lines[: number - 1], line[: found.start()] + new + line[found.end() :], *lines[number:]])
        yield Mutant(path, number, text)


def in_turns(streams):
    """One of each, until all have ended."""
    while streams:
        for stream in list(streams):
            try:
                yield next(stream)
            except StopIteration:
                streams.remove(stream)


def functions(source: str) -> list[range]:
    """Lines of every function that stands in no other, its decorators and all in it."""

    def within(node):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef):
                yield range(min(n.lineno for n in (child, *child.decorator_list)), child.end_lineno + 1)
            else:
                yield from within(child)

    return list(within(ast.parse(source)))


class Part:
    """One part of the code in a copy, and whether its tests pass."""

    def __init__(self, copy: Path, name: str, longest_s: float, without: list[str]):
        patterns, tests = PARTS[name]
        tests = [test for test in tests if test not in without]
        self.copy, self.is_cpp = copy, name == "kernels"
        base = copy / ("lib/kernel" if self.is_cpp else PACKAGE)
        self.paths = [path for pattern in patterns for path in sorted(base.glob(pattern)) if path.name != "__init__.py"]
        if self.is_cpp:
            self._run("cmake", "-S", ".", "-B", "build", "-G", "Ninja", *CONFIGURED, check=True)
            assert self._built("all") and self._run("ctest", "--test-dir", "build"), "the copy's own C++ tests fail"
        self.runner = subprocess.Popen(
            ["/usr/bin/python3", RUNNER, *tests, "--", *self.paths],
            cwd=copy, env=self._environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        told = json.loads(self.runner.stdout.readline())
        assert told["status"] == 0, "tests fail without any mutant"
        self.tests = {name: test for name, test in told["tests"].items() if test["seconds"] <= longest_s}

    def close(self):
        self.runner.communicate()

    def _environment(self):
        return os.environ | {"CAST_BUILD": str(self.copy / "build"), "OPENBLAS_NUM_THREADS": "1"}

    def _run(self, *command, timeout=None, check=False) -> bool:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, cwd=self.copy, env=self._environment(), start_new_session=True, **quiet) as process:
            try:
                status = process.wait(timeout)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)
                return False
        if check and status:
            raise subprocess.CalledProcessError(status, command)
        return status == 0

    def _built(self, *targets) -> bool:
        return self._run("cmake", "--build", "build", "-j1", "--target", *targets)

    def meeting(self, mutant: Mutant) -> list[str]:
        """The tests that can tell: the quickest first, those that start programs last."""
        met = self.tests
        defined = [] if self.is_cpp else functions(mutant.path.read_text())
        lines = next((lines for lines in defined if mutant.line in lines), None)
        if lines is not None:  # what runs as a file is loaded meets all
            called = {name for name, t in met.items() if any(p == str(mutant.path) and k in lines for p, k in t["called"])}
            met = {name: test for name, test in met.items() if name in called or test["starts"]}
        return sorted(met, key=lambda name: (met[name]["starts"], met[name]["seconds"]))

    def survives(self, mutant: Mutant) -> bool | None:
        """None: no mutant, it does not compile."""
        before, met = mutant.path.read_text(), self.meeting(mutant)
        for compiled in mutant.path.parent.glob(f"__pycache__/{mutant.path.stem}.*"):
            compiled.unlink()
        mutant.path.write_text(mutant.text)
        try:
            if self.is_cpp and not self._built("gnuradio-cast"):
                return None
            self.runner.stdin.write(json.dumps(met) + "\n")
            self.runner.stdin.flush()
            if json.loads(self.runner.stdout.readline()) != 0:
                return False
            return not self.is_cpp or (self._built("emulator_test") and self._run("build/lib/emulator_test", timeout=300))
        finally:
            mutant.path.write_text(before)


def copied(folder: Path) -> Path:
    """The checkout with what it built, links followed."""
    ignored = shutil.ignore_patterns("__pycache__", ".git")
    for name in ("apps", "tests", "docs", "include", "lib", "grc", "python", "build/python"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in ("CMakeLists.txt", "pytest.ini"):
        shutil.copy(ROOT / name, folder / name)
    subprocess.run([sys.executable, "-m", "compileall", "-q", "build", "tests"], cwd=folder, check=True)
    return folder


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--mutants", type=int, default=60, help="of every part")
    less = "what they alone see survives"
    parser.add_argument("--longest", type=float, default=math.inf, metavar="S", help=f"leave out tests that take longer: {less}")
    parser.add_argument("--without", nargs="+", default=[], metavar="FILE", help=f"leave out these tests: {less}")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6), help="without it a fresh one")
    args = parser.parse_args(argv)
    print(f"seed {args.seed}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = copied(Path(folder))
        for name in args.parts:
            rng = random.Random(f"{args.seed} {name}")
            part = Part(copy, name, args.longest, args.without)
            print(f"{name}: {len(part.tests)} tests", flush=True)
            drawn = in_turns([(cpp_mutants if part.is_cpp else python_mutants)(path, rng) for path in part.paths])
            killed, tried = 0, 0
            for mutant in drawn:
                if tried == args.mutants:
                    break
                change, survived = mutant.change(), part.survives(mutant)
                tried += survived is not None
                killed += survived is False
                print(f"\r{name}: {killed} of {tried}", end="\r", file=sys.stderr, flush=True)
                if survived:
                    print(f"survived: {change}", flush=True)
            part.close()
            print(f"{name}: {killed} of {tried} killed, {100 * killed / max(1, tried):.0f} %", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
