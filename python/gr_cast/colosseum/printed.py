# SPDX-License-Identifier: GPL-3.0-or-later
"""What `status.sh` prints, as far as its text tells: words that surely are no JSON with a STATUS."""

import re

from ..core.documents import json_text, short
from ..core.errors import CastError
from .blocking import foreground
from .image import Image
from .shell import Command, bare, commands

NEEDS = 'needs {"STATUS": "READY", "INFO": "…"}, in double quotes'
_SILENT = {"exit", "return", ":", "true", "false", "test", "[", "[[", "sleep", "read", "export", "local", "set", "cd", "touch"}
_UNKNOWN = re.compile(r"\$\([^()]*\)|\$\{[^}]*\}|\$\w+|\$[?#@*!]|`[^`]*`")
_PRINTS = re.compile(r"""\bprint\(\s*(?:str\(\s*)?(?P<dict>\{)|\bprint\(\s*(["'])(?P<plain>[\w ]*)\2\s*\)""")


def no_json(image: Image, place: str) -> list[tuple[int, str]]:
    """(line, fault) of all that a script surely prints and that is no JSON; nothing where it puts JSON together of pieces."""
    text = image.texts[place]
    first = text.split("\n", 1)[0]
    if "python" in first:
        return [(n, fault) for n, line in enumerate(text.splitlines(), 1) if (fault := _python_fault(line.split("#", 1)[0]))]
    if not re.match(r"#!\s*\S*sh\b", first):
        return []
    every = foreground(commands(text))
    if any(one.words[0] in (">", ">>") or (one.words[0] == "exec" and ">" in one.words) for one in every):
        return []  # where its output goes is decided elsewhere
    told = [(one, said) for one in every if (said := _said(one)) is not None]
    if any(said.count("{") != said.count("}") for _, said in told):
        return []
    if every and all(_is_silent(one) for one in every):
        return [(every[-1].line, f"prints nothing, {NEEDS}")]
    return [(one.line, fault) for one, said in told if (fault := _fault(said))]


def _said(command: Command) -> str | None:
    """What `echo` or `printf` prints to whoever calls the script; None where it is neither, or goes elsewhere."""
    words = bare(command.words)
    if not words or words[0] not in ("echo", "printf") or command.goes_on or any(set(w) <= set("<>&") for w in words[1:] if w):
        return None
    tool, *words = words
    while words and re.fullmatch(r"-[neE]+", words[0]):
        words.pop(0)
    if tool == "printf" and words:
        return re.sub(r"%[-0-9.]*[sdifu]", "$X", words[0]).replace("\\n", "\n").replace('\\"', '"')
    return " ".join(words)


def _is_silent(command: Command) -> bool:
    words = bare(command.words)
    return not words or words[0] in _SILENT or ">" in words or ">>" in words


def _fault(said: str) -> str | None:
    """What is wrong with a text that is printed; None where a variable may make it right."""
    known = _UNKNOWN.sub("", said).strip()
    if not known:
        return None
    if not re.search("[{}]", known):
        return f"prints {short(said)}, no JSON: {NEEDS}"
    if known != said.strip():
        return f"prints {short(said)}, no JSON: {NEEDS}" if re.search(r"'\s*STATUS\s*'", said) else None
    try:
        document = json_text(known, "status.sh").document
    except CastError:
        return f"prints {short(said)}, no JSON: {NEEDS}"
    return None if "STATUS" in document else f"prints {short(said)}, without STATUS: {NEEDS}"


def _python_fault(line: str) -> str | None:
    match = _PRINTS.search(line)
    if match is None:
        return None
    if match["dict"]:
        return f"prints a dictionary as Python writes it, in single quotes: print(json.dumps(…)); {NEEDS}"
    return f"prints {short(match['plain'])}, no JSON: {NEEDS}"
