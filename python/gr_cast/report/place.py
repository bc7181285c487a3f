# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a place diagnosis."""

import html
import json


def render(diagnosis) -> str:
    """One page that needs no other file."""
    document = diagnosis.document
    lines = "".join(f"<li>{html.escape(effect['sentence'])}</li>" for effect in document["effects"])
    text = html.escape(json.dumps(document["fit"]))
    return (
        f"<!doctype html><meta charset='utf-8'><title>{html.escape(diagnosis.place.name)}</title>"
        f"<h1>{html.escape(diagnosis.place.name)}: {document['verdict']}</h1><ul>{lines}</ul><pre>{text}</pre>\n"
    )
