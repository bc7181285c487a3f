# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a radio API script reads, collects or runs although nothing in its image writes them."""

import fnmatch
import posixpath
import re
import stat

from .image import RADIO_API, Image
from .shell import bare, commands, program_of

# Colosseum writes these itself, or the kernel does.
_GIVEN = ("/proc/*", "/sys/*", "/dev/*", "/run/*", "/var/log/*", "/logs", "/logs/*", "/share", "/share/*", "/socket/*",
          *(f"{RADIO_API}/{name}" for name in (
              "radio.conf", "colosseum_config.ini", "mandated_outcomes.json", "environment.json")))  # fmt: skip
_READERS = {
    "cat",
    "head",
    "tail",
    "grep",
    "egrep",
    "source",
    ".",
    "awk",
    "sed",
    "jq",
    "cut",
    "wc",
    "[",
    "[[",
    "test",
    "stat",
    "cmp",
}
_MOVERS = {"cp", "mv", "rsync", "install"}
_REMOVERS = {"rm", "rmdir", "echo", "printf"}
_INTO = {">", ">>", ">|", "&>", "&>>", "<>", ">&"}
_LITERAL = re.compile(r"""([^\s\w]?)\s*(?<!\w)[rbuf]?(["'])((?:/|\./|\.\./|~/)?[\w.*?{}/ -]*[\w*?}])\2""")
_READ_ONLY = re.compile(r"""\bopen\(\s*[rbuf]?["'][^"']+["']\s*(?:\)|,\s*(?:mode\s*=\s*)?["']rb?["'])|\.exists\(|isfile\(""")


def unwritten(image: Image, place: str) -> list[tuple[int, str]]:
    """(line, fault) of every path that a script reads or collects and nothing writes."""
    written, found = _written(image), []
    for line, path in _reads(image.texts[place]):
        if any(fnmatch.fnmatchcase(path, given) for given in _GIVEN) or _is_there(image, path):
            continue
        if not any(_meets(path, other) for other in written):
            found.append((line, f"{path}: nothing in the image writes it"))
    return found


def cannot_run(image: Image, place: str) -> list[tuple[int, str]]:
    """(line, fault) of every program that a script runs by its path and that is not there, or has no run bit; in the background
    nobody would be told. What a script asks for first, `[ -x FILE ]`, may be missing."""
    written, found = _written(image), []
    every = [(command.line, bare(command.words)) for command in commands(image.texts[place])]
    asked = {word for _, words in every for word in words if words[0] in ("[", "[[", "test")}
    for line, words in every:
        program, _ = program_of(words)
        path = _absolute(program) if program.startswith("/") and program not in asked else None
        if path is None or any(fnmatch.fnmatchcase(path, given) for given in _GIVEN):
            continue
        entry = image.entry(path)
        if entry is None and not any(_meets(path, other) for other in written):
            found.append((line, f"runs {path}: not in the image, and nothing in it writes it"))
        elif entry is not None and program == words[0] and not entry.mode & 0o111:
            found.append((line, f"runs {path}: mode {stat.S_IMODE(entry.mode):04o}: no run bit: chmod 755"))
    return found


def _absolute(word: str) -> str | None:
    """A word as an absolute path; None where it is none, or where a variable decides."""
    word = "/root" + word[1:] if word.startswith("~/") else word
    if "$" in word or "`" in word or "/" not in word or not re.fullmatch(r"[\w./*?\[\]{}@%+:,=-]+", word):
        return None
    return posixpath.normpath(posixpath.join(RADIO_API, word))


def _words(text: str):
    """(line, words) of commands, and of those that stand in $( ) or backquotes within quotes."""
    for command in commands(text):
        yield command.line, list(command.words)
        for word in command.words:
            for inner in re.findall(r"\$\(([^()]+)\)|`([^`]+)`", word):
                yield command.line, "".join(inner).replace("<", " < ").split()


def _reads(text: str):
    """(line, path) of all that a script surely reads or collects."""
    for line, words in _words(text):
        if not words:
            continue
        name = posixpath.basename(words[0])
        plain = [w for n, w in enumerate(words) if n and not w.startswith("-") and words[n - 1] not in _INTO]
        if name in _MOVERS:
            candidates = plain[:-1]
        elif name in _READERS:
            candidates = [w for w in plain if w.startswith(("/", "./", "../", "~/"))]
        else:
            candidates = []
        candidates += [words[n + 1] for n, w in enumerate(words[:-1]) if w == "<"]
        for path in filter(None, map(_absolute, candidates)):
            if path not in ("/", RADIO_API) and not path.startswith("/dev/"):
                yield line, path


def _written(image: Image) -> set[str]:
    """Paths that a program of the image writes, or may write: all that it names and does not only read."""
    found = set()
    for place, text in image.texts.items():
        first = text.split("\n", 1)[0]
        if place.endswith((".sh", ".bash")) or "sh" in posixpath.basename(first):
            found |= _written_by_shell(text)
        elif not place.endswith((".md", ".txt", ".rst", ".html")):
            for line in text.splitlines():
                if not _READ_ONLY.search(line):
                    named = (
                        _dotted(literal) if before in ("(", "=", "[", "") else literal
                        for before, _, literal in _LITERAL.findall(line)
                    )
                    found |= set(filter(None, map(_absolute, named)))
    return found


def _dotted(literal: str) -> str:
    """A literal as a path: what a program names without a folder lies where it runs."""
    return literal if "/" in literal or "." not in literal.strip(".") else f"./{literal}"


def _written_by_shell(text: str) -> set[str]:
    found = set()
    for _, words in _words(text):
        words = bare(tuple(words))
        program, name = program_of(words)[0], posixpath.basename(words[0]) if words else ""
        into = [words[n + 1] for n, w in enumerate(words[:-1]) if w in _INTO]
        plain = [w for n, w in enumerate(words) if n and words[n - 1] not in (*_INTO, "<")]
        if name in _MOVERS:
            into += plain[-1:]
        elif name not in _READERS | _REMOVERS:
            into += [w.partition("=")[2] or w for w in plain if w != program]
        found |= set(filter(None, map(_absolute, into)))
    return found


def _is_there(image: Image, path: str) -> bool:
    if "*" in path or "?" in path:
        return any(fnmatch.fnmatchcase(other, path) for other in image.entries)
    return image.entry(path) is not None


def _meets(path: str, other: str) -> bool:
    """Whether what is written at `other` can be what is read at `path`: the same, one matching the other, or in its folder."""
    return (
        fnmatch.fnmatchcase(other, path)
        or fnmatch.fnmatchcase(path, re.sub(r"\{[^}]*\}", "*", other))
        or other.startswith(path.rstrip("/") + "/")
        or ("*" in path and fnmatch.fnmatchcase(posixpath.dirname(other) + "/", posixpath.dirname(path) + "/") and "*" in other)
    )
