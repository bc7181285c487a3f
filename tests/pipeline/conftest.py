# SPDX-License-Identifier: GPL-3.0-or-later
"""A stack of the project's own modem in a repository of its own, with few repeats, and the bench that judges its commits."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from gr_cast.pipeline import clean
from gr_cast.pipeline.run import Bench
from gr_cast.pipeline.source import Source
from gr_cast.pipeline.stages import Storage

sys.path.append(str(Path(__file__).resolve().parent))  # its modules are the tests'
ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("git", "gcc", "make")


class Stack:
    """The repository and its sites; `commit` changes files and commits them."""

    def __init__(self, folder: Path):
        for tool in TOOLS:
            if shutil.which(tool) is None:
                pytest.skip(f"NO {tool.upper()}: the stack is not built")
        subprocess.run(["bash", ROOT / "docs/examples/stack.sh", folder], check=True, stdout=subprocess.DEVNULL)
        self.folder, self.sites = folder, Path(f"{folder}-sites")

    def commit(self, message: str, **texts) -> str:
        """Files by name (`src_send` is src/send.py): a text, or (pattern, replacement)."""
        for name, change in texts.items():
            path = self.folder / (name.replace("_", "/", 1) + ".py" if name.startswith("src_") else f"{name}.yaml")
            before = path.read_text()
            after = change if isinstance(change, str) else re.sub(*change, before, flags=re.S)
            assert after != before, f"{name} stays as it is"
            path.write_text(after)
        self.git("-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qam", message)
        return self.git("rev-parse", "HEAD")

    def shorten(self) -> str:
        """From now on there is one experiment, of long frames, four times."""
        self.commit("Long frames alone", pipeline=(r"  - name: short.*?(?=  - name: long)", ""))
        return self.commit("Fewer repeats", pipeline=(r"repeats: 5", "repeats: 4"))

    def git(self, *words) -> str:
        return subprocess.run(["git", "-C", self.folder, *words], check=True, capture_output=True, text=True).stdout.strip()

    def testbed(self, fault: str = "none", noise_db: float = -55.0) -> None:
        """From now on the testbed is the world by closed formulas."""
        shutil.copy(Path(__file__).with_name("world.py"), self.sites)
        program = f"/usr/bin/python3 {{site}}/world.py {fault} {noise_db}"
        (self.sites / "testbed.yaml").write_text(f"cast_site: 1\nprogram: {program}\n")

    def bench(self, storage: Path, kind: str = "auto", progress=lambda line: None) -> Bench:
        kept = Storage(storage)
        source = Source(str(self.folder), kept.folder)
        source.update()
        return Bench(storage=kept, source=source, inventories=self.sites, room=clean.chosen(kind), budget_s=60, progress=progress)


@pytest.fixture
def stack(tmp_path) -> Stack:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    made = Stack(tmp_path / "stack")
    made.shorten()
    return made
