# SPDX-License-Identifier: GPL-3.0-or-later
"""What a diagnosis found, a card for each effect."""

from collections.abc import Callable
from html import escape

from .pages import in_words


def cards(document: dict, lines_of: Callable[[dict], dict[str, str]]) -> str:
    """Each effect's number, name and sentence, with `lines_of(effect)`: label → HTML; "" where nothing was found."""
    if not document["effects"]:
        return ""
    found = []
    for number, effect in enumerate(document["effects"], 1):
        lines = lines_of(effect) | {"Confidence": f"{effect['confidence']:.2f}"}
        rows = "".join(f"<dt>{label}</dt><dd>{text}</dd>" for label, text in lines.items())
        found.append(
            f"<div class='cause' data-mark='{number}'><p><span class='number-of'>{number}</span>"
            f"<b class='name'>{in_words(effect['family'])}</b></p><p>{escape(effect['sentence'])}</p><dl>{rows}</dl></div>"
        )
    title = "What the twin leaves out" if document["verdict"] == "identified" else "What was found so far"
    nats = "<p class='note'>What is worth n nats makes what was recorded e<sup>n</sup> times as likely.</p>"
    return f"<h2>{title}</h2>{''.join(found)}{nats}"
