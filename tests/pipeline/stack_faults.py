# SPDX-License-Identifier: GPL-3.0-or-later
"""Commits of the stack: two with a fault, and any number that change nothing that matters."""

SCRAMBLER = {
    "src_modem": (
        r"data \^= scrambling\(scrambler, len\(data\)\)",
        "data ^= np.concatenate([scrambling(scrambler, 1024), scrambling(scrambler ^ 1, len(data))])[: len(data)]",
    )
}
GAIN = {"src_air": (r"GAIN = 0.25", "GAIN = 0.7")}  # that clips on the testbed alone


def harmless(k: int) -> dict:
    """Another word, another order of what is independent, or an argument by name."""
    return [
        {"src_send": (r'""".*?"""', f'"""Node that sends, edition {k}."""')},
        {"src_receive": (r'""".*?"""', f'"""Node that receives, edition {k}."""')},
        {"src_air": (r"\Z", f"\n\n# {k}\n")},
    ][k % 3]
