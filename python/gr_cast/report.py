# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a diagnosis: one HTML page, self-contained."""

from html import escape


def render(diagnosis) -> str:
    """The page as text."""
    d = diagnosis.document
    rows = "".join(
        f"<li>{escape(e['sentence'])} <small>({escape(e['owner']['name'])}, confidence {e['confidence']:.2f})</small>"
        for e in d["effects"]
    )
    title = escape(diagnosis.case.name)
    return f"<!doctype html><meta charset='utf-8'><title>{title}</title><h1>{escape(d['verdict'])}</h1><ul>{rows}</ul>"
