# SPDX-License-Identifier: GPL-3.0-or-later
"""A network of srsRAN 4G as a script for whoever runs it by hand: the emulator, the core, stations, terminals in namespaces."""

import shlex
from pathlib import Path

from ...core.files import write_text
from .stack import GATEWAY, Member

NAME = "run.sh"


def emulator_command(
    program: Path, scenario: Path, members: list[Member], rate_hz: float, noise_db: float, seed: int
) -> list[str]:
    """The words that play `scenario` between the radios of `members`."""
    words = [str(program), "run", str(scenario), "--rate", f"{rate_hz:.0f}", "--noise-power-db", f"{noise_db:.3f}"]
    words += ["--seed", str(seed)]
    for member in members:
        words += ["--port", f"{member.node}:tx=zmq:{member.sends}", "--port", f"{member.node}:rx=zmq:{member.receives}"]
    return words


def write_script(folder: Path, emulator: list[str], members: list[Member]) -> Path:
    """run.sh in `folder`, beside the configuration that it names."""

    def started(name: str, *words: str) -> str:
        return f"{shlex.join(words)} >{shlex.quote(str(folder / f'{name}.out'))} 2>&1 &"

    terminals = [member for member in members if member.program == "srsue"]
    spaces = [f"cast_{number}" for number in range(1, len(terminals) + 1)]  # names of namespaces are short
    lines = [
        "#!/bin/bash",
        "# As root. Ctrl-C ends all of it; what each program prints is in NAME.out beside this.",
        f"cd {shlex.quote(str(folder))}",
        f"trap 'trap - EXIT; kill $(jobs -p) 2>/dev/null; wait; for s in {' '.join(spaces)}; do ip netns delete $s; done' EXIT",
        started("emulator", *emulator),
        started("srsepc", "srsepc", str(folder / "epc.conf")),
        "sleep 2",
        *(started(f"srsenb {m.node}", "srsenb", str(m.config)) for m in members if m.program == "srsenb"),
    ]
    for space, member in zip(spaces, terminals, strict=True):
        lines += [
            f"ip netns add {space}",
            started(f"srsue {member.node}", "ip", "netns", "exec", space, "srsue", str(member.config)),
            f"echo {shlex.quote(f'{member.node}: ip netns exec {space} ping {GATEWAY}, once it is attached')}",
        ]
    write_text(folder / NAME, "\n".join([*lines, "wait", ""]))
    return folder / NAME
