# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio where HOME cannot be written to."""

import os
import tempfile
from pathlib import Path

from gnuradio import blocks, gr


def settle_buffers() -> None:
    """Let GNU Radio choose its kind of buffer now where HOME cannot be written to.

    It does so once in a process and notes it in HOME/.gnuradio; where it cannot, the first flowgraph ends with an error.
    """
    home = os.environ.get("HOME")
    if not home or _takes_notes(Path(home) / ".gnuradio"):
        return
    with tempfile.TemporaryDirectory() as elsewhere:
        os.environ["HOME"] = elsewhere
        try:
            top = gr.top_block()
            top.connect(blocks.null_source(1), blocks.head(1, 1), blocks.null_sink(1))
            top.run()
        finally:
            os.environ["HOME"] = home


def _takes_notes(folder: Path) -> bool:
    try:
        folder.mkdir(exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)
