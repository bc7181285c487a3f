# SPDX-License-Identifier: GPL-3.0-or-later
"""Shell scripts as far as a rehearsal needs them: simple commands with their lines, and which of them nobody waits for."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace

_OPEN = {"while": "done", "until": "done", "for": "done", "if": "fi", "case": "esac", "{": "}", "(": ")", "$(": ")"}
_CLOSE = {"done", "fi", "esac", "}", ")"}
_SKIPPED = {"then", "else", "elif", "do", "!", "time"}
_ENDS = {";", ";;", "&&", "||", "|", "|&", "&", "\n"}
_HEREDOC = re.compile(r"<<-?\s*(['\"]?)([A-Za-z_]\w*)\1")
_ASSIGNED = re.compile(r"^\s*(?:export\s+|local\s+|readonly\s+)?([A-Za-z_]\w*)=(['\"]?)([^'\"`$;&|()]*)\2\s*(?:[;#].*)?$")


@dataclass(frozen=True, kw_only=True)
class Command:
    """A simple command. `loops` are the words that opened the loops round it; `function` is the one it stands in; `goes_on`
    says that its output goes to another command. A condition that always holds has the last line of its loop in `endless`,
    where nothing in there leaves it."""

    line: int
    words: tuple[str, ...]
    background: bool = False
    loops: tuple[str, ...] = ()
    function: str = ""
    goes_on: bool = False
    endless: int = 0


PREFIXES = {"exec", "nohup", "nice", "ionice", "stdbuf", "sudo", "command", "env", "chrt", "taskset", "setsid", "unbuffer"}
RUNNERS = {"sh", "bash", "dash", "source", "."}
_PYTHON = re.compile(r"python[\d.]*")
_ALWAYS = {"while": ((":",), ("true",), ("[", "1", "]")), "until": (("false",),)}
_LEAVES = {"break", "return", "exit", "exec"}


def bare(words: tuple[str, ...]) -> list[str]:
    """The words of a command without those that only say how it is run."""
    words = list(words)
    while words and (words[0] in PREFIXES or "=" in words[0] or (words[0].startswith("-") and len(words) > 1)):
        words.pop(0)
    return words


def program_of(words: list[str]) -> tuple[str, bool]:
    """(the program or script that bare words run, whether Python runs it)."""
    is_python = bool(words) and _PYTHON.fullmatch(words[0].rpartition("/")[2]) is not None
    if is_python or (words and words[0].rpartition("/")[2] in RUNNERS):
        return next((word for word in words[1:] if not word.startswith("-")), ""), is_python
    return (words[0] if words else ""), False


def variables(text: str) -> dict[str, str]:
    """Names to the plain values that they are given once."""
    found: dict[str, set] = {}
    for line in text.splitlines():
        if match := _ASSIGNED.match(line):
            found.setdefault(match[1], set()).add(match[3].strip())
    return {name: values.pop() for name, values in found.items() if len(values) == 1}


def expanded(word: str, values: dict[str, str]) -> str:
    """A word with the variables put in that are known."""
    return re.sub(r"\$\{?([A-Za-z_]\w*)\}?", lambda m: values.get(m[1]) or m[0], word)


def lines(text: str) -> Iterator[tuple[int, str]]:
    """(number, line) with lines that go on joined; what is between << and its end left out."""
    end, joined, begin = None, "", 0
    for number, line in enumerate(text.splitlines(), 1):
        if end is not None:
            end = None if line.strip() == end else end
            continue
        begin = begin or number
        if line.endswith("\\"):
            joined += line[:-1] + " "
            continue
        joined += line
        yield begin, joined
        if match := _HEREDOC.search(joined):
            end = match[2]
        joined, begin = "", 0


def _tokens(line: str) -> list[str]:
    lexer = shlex.shlex(line, posix=True, punctuation_chars="();<>|&")
    lexer.whitespace_split, lexer.commenters = True, ""
    if (comment := re.search(r"(?:^|\s)#", line)) and line[: comment.start()].count('"') % 2 == 0:
        lexer = shlex.shlex(line[: comment.start()], posix=True, punctuation_chars="();<>|&")
        lexer.whitespace_split, lexer.commenters = True, ""
    try:
        return list(lexer)
    except ValueError:  # a quote that ends on another line
        return line.split()


def commands(text: str) -> list[Command]:
    """Every simple command of a script, in its order."""
    values, found, blocks, words = variables(text), [], [], []
    function, depth_of_function, pending = "", 0, ""

    def flush(number: int, background: bool, goes_on: bool = False) -> None:
        if words:
            loops = tuple(opener for opener, *_ in blocks if opener in ("while", "until", "for"))
            found.append(
                Command(line=number, words=tuple(expanded(w, values) for w in words), background=background, loops=loops,
                        function=function, goes_on=goes_on)
            )  # fmt: skip
            words.clear()

    for number, line in lines(text):
        tokens = [*_tokens(line), "\n"]
        position = 0
        while position < len(tokens):
            token, after = tokens[position], tokens[position + 1] if position + 1 < len(tokens) else "\n"
            position += 1
            if token == "()" and len(words) == 1:
                pending = words.pop()
            elif token == "function" and not words:
                pending, position = after, position + 1
            elif token == "(" and words and words[-1].endswith("$"):  # $( ): what is in it runs here
                words.pop()
                flush(number, False)
                blocks.append(("$(", len(found), number))
            elif not words and token in _OPEN:
                if token == "{" and pending:
                    function, depth_of_function, pending = pending, len(blocks), ""
                blocks.append((token, len(found), number))
            elif token in _CLOSE and (not words or token == ")"):
                flush(number, False)
                if blocks and token == _OPEN[blocks[-1][0]]:
                    opener, begin, _ = blocks.pop()
                    body = found[begin:]
                    if body and body[0].words in _ALWAYS.get(opener, ()) and not _LEAVES & {one.words[0] for one in body}:
                        found[begin] = replace(body[0], endless=number)
                    if "|" in tokens[position : position + 1] or opener == "$(":
                        found[begin:] = [replace(one, goes_on=True) for one in found[begin:]]
                    if next(t for t in tokens[position:] if t in _ENDS) == "&":  # redirections may stand before it
                        found[begin:] = [replace(one, background=True) for one in found[begin:]]
                    if function and len(blocks) == depth_of_function and token == "}":
                        function = ""
            elif token in _ENDS:
                flush(number, token == "&", token in ("|", "|&"))
            elif not (token in _SKIPPED and not words):
                words.append(token)
    flush(number if text.strip() else 0, False)
    return found
