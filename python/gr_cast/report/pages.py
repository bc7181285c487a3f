# SPDX-License-Identifier: GPL-3.0-or-later
"""What pages of all kinds share: their style, their words for the contract's names, and pictures that keep to a time."""

import base64
import re
import time
from collections.abc import Callable

from matplotlib.figure import Figure

from .plot import png

INK, CAUSE, NOISE, GOOD = "#1b2733", "#b3541e", "#8a99a8", "#3b7a57"
TITLES = ("twin as it is", "corrected twin")
NEGATIVE = re.compile(r"(?<=[\s>(])-(?=\d)")  # the sign of a number, not the dash of an option or a picture's code

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1b2733;max-width:66rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem}
h2{font-size:1.15rem;margin:2rem 0 .6rem;border-bottom:1px solid #d5dce3}
.verdict{font-size:1.2rem;padding:.7rem 1rem;border-left:.4rem solid;background:#f5f7f9;margin:1rem 0}
.identified{border-color:#b3541e}.no_mismatch{border-color:#3b7a57}
.ambiguous{border-color:#b8860b}.unexplained{border-color:#8b1a1a}
.next{padding:.6rem 1rem;background:#fff8e6;border-left:.4rem solid #b8860b;margin:1rem 0}
.next p{margin:.2rem 0}
.cause{margin:0 0 1rem;padding:.5rem 1rem;border:1px solid #e3e8ed;border-radius:.3rem}
.cause b.name{font-size:1.05rem}.cause p{margin:.2rem 0}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;margin:.4rem 0;font-size:.92rem}
dt{color:#5b6b7a}dd{margin:0}
.number-of{display:inline-block;min-width:1.4rem;text-align:center;background:#b3541e;color:#fff;border-radius:.2rem;
margin-right:.5rem}
table{border-collapse:collapse;font-size:.92rem}
th,td{text-align:left;padding:.25rem .9rem .25rem 0;border-bottom:1px solid #e3e8ed;vertical-align:top}
td.number,th.number{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
img{max-width:100%}.note{color:#5b6b7a;font-size:.92rem}code{background:#f0f3f6;padding:0 .2rem;white-space:nowrap}
"""


class Album:
    """The pictures of a page, drawn as long as there is time; `left_out` counts those that are not."""

    def __init__(self, deadline: float):
        self.deadline, self.left_out, self._longest_s = deadline, 0, 0.0

    def image(self, draw: Callable[[], Figure | None], alt: str) -> str:
        """What `draw` draws, or nothing where it would not be there by the deadline."""
        begun = time.thread_time()
        figure = draw() if begun + self._longest_s <= self.deadline else None
        if figure is None:
            self.left_out += 1
            return ""
        picture = base64.b64encode(png(figure, 100)).decode()
        self._longest_s = max(self._longest_s, time.thread_time() - begun)
        return f"<img alt='{alt}' src='data:image/png;base64,{picture}'>"

    def note(self) -> str:
        """What is not shown, in one sentence."""
        if not self.left_out:
            return ""
        pictures = "1 picture is" if self.left_out == 1 else f"{self.left_out} pictures are"
        return f"<p class='note'>{pictures} left out: the time for this case was up. The maps are in residual.npz.</p>"


def in_words(name: str) -> str:
    """A name of the contract as an engineer writes it."""
    short = {"pa": "PA", "iq": "I/Q", "dc": "DC", "lo": "LO", "adc": "ADC"}
    return " ".join(short.get(word, word) for word in name.split("_"))


def listed(words: list[str]) -> str:
    words = list(dict.fromkeys(words))
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""


def runner_up(effect: dict, d: dict, does: str) -> str:
    """What comes next to an effect of a document, which as a family `does` ("fits", "explains") what it does."""
    name, evidence = effect["family"], effect["evidence"]
    equal = [f for pair in d["ambiguous"] if name in pair["families"] for f in pair["families"] if f != name]
    if equal:
        return f"{listed([in_words(f) for f in equal])}: it {does} as well"
    if not evidence["runner_up"]:
        was_weighed = evidence["heldout_gain_nats"] is not None or not d["residual"]["out_of_time"]
        return "none comes near" if was_weighed else "not worked out"
    margin = evidence["runner_up_margin_nats"]
    return f"{in_words(evidence['runner_up'])}, {abs(margin):,.0f} nats {'behind' if margin >= 0 else 'ahead'}"
