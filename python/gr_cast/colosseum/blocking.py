# SPDX-License-Identifier: GPL-3.0-or-later
"""Calls of a script that do not return within the radio API's limit, followed into the scripts and programs that it runs."""

import posixpath
import re

from .image import RADIO_API, Image
from .shell import RUNNERS, Command, bare, commands, program_of

LIMIT_S = 5.0
_UNITS_S = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
# Programs that run until they are ended, unless one of these options is given.
_ENDLESS = {
    "tail": (r"-\w*[fF]", None), "ping": (None, r"-\w*[cw]"), "iperf3": (r"-\w*s", r"-\w*[1D]|--one-off|--daemon"),
    "iperf": (r"-\w*s", r"-\w*D"), "mgen": (None, None), "tcpdump": (None, r"-\w*[cG]"), "nc": (r"-\w*l", None),
    "watch": (None, None), "top": (None, r"-\w*[bn]"), "srsenb": (None, None), "srsue": (None, None), "srsepc": (None, None),
    "gnb": (None, None), "nr-softmodem": (None, None), "lte-softmodem": (None, None), "nr-uesoftmodem": (None, None),
    "uhd_siggen": (None, None), "uhd_fft": (None, None), "rx_samples_to_file": (None, r"--duration|--nsamps"),
    "tx_samples_from_file": (r"--repeat", None), "tx_waveforms": (None, r"--nsamps"), "yes": (None, None),
}  # fmt: skip
_SLEEPS = re.compile(r"\b(?:time\.)?sleep\(\s*([^)]*)\)?")
_BLOCKS = re.compile(
    r"while\s+(?:True|1)\s*:|\.(?:serve_forever|run_forever|mainloop)\(|(?:\btb|\btop_block|\bself\.tb)\.(?:run|wait)\(|(?<!\w)input\("
)
_DEPTH = 8


def waits(image: Image, place: str) -> list[tuple[int, str]]:
    """(line, fault) of every call in the foreground of a script that takes longer than LIMIT_S, or for ever."""
    found, slept_s, started, known = [], 0.0, 0, 0
    for command in foreground(commands(image.texts[place])):
        if command.line <= known:  # in a loop that has been named
            continue
        known = command.endless
        reason = _reason(image, place, command, started, 0)
        if reason:
            found.append((command.line, f"blocks: {reason}; limit {LIMIT_S:g} s: end it with &, or be done sooner"))
        elif command.words[0] == "sleep" and not command.loops:
            slept_s += _seconds(command.words[1:]) or 0.0
            if slept_s >= LIMIT_S:
                found.append((command.line, f"blocks: sleeps of {slept_s:g} s together until here; limit {LIMIT_S:g} s"))
                slept_s = 0.0
    for command in commands(image.texts[place]):
        started = command.line if command.background and not started else started
        if command.words[0] == "wait" and not command.background and started:
            found.append((command.line, f"blocks: waits for what line {started} starts; limit {LIMIT_S:g} s"))
    return found


def foreground(found: list[Command]) -> list[Command]:
    """What a script waits for: functions only where they are called so."""
    called = {c.words[0] for c in found if not c.background}
    return [c for c in found if not c.background and (not c.function or c.function in called)]


def _seconds(words) -> float | None:
    """What `sleep` is asked for; None where that is not told."""
    total, words = 0.0, list(words)
    into = next((n for n, word in enumerate(words) if word[0] in "<>&"), None)
    words = words[:into]
    if into is not None and len(words) > 1:  # the 2 of 2>
        words.pop()
    for word in words:
        match = re.fullmatch(r"([0-9.]+)([smhd]?)", word)
        if not match:
            return float("inf") if word == "infinity" else None
        total += float(match[1]) * _UNITS_S[match[2]]
    return total


def _reason(image: Image, place: str, command: Command, started: int, depth: int) -> str:
    """Why a command does not return in time, "" where nothing says so."""
    if command.endless:
        return f"{command.loops[-1]} loop without an end"
    if "setsid" in command.words and any(re.fullmatch(r"-\w*f|--fork", word) for word in command.words):
        return ""
    words = bare(command.words)
    if not words:
        return ""
    name = posixpath.basename(words[0])
    if name == "timeout":
        limit_s = next((s for word in words[1:] if (s := _seconds([word])) is not None), None)
        return f"timeout {limit_s:g} s" if limit_s is not None and limit_s >= LIMIT_S else ""
    if name == "sleep":
        slept_s = _seconds(words[1:])
        if slept_s is not None and slept_s >= LIMIT_S:
            return f"sleep {' '.join(words[1:])}"
        loop = next((opener for opener in command.loops if opener != "for"), "")
        return f"{loop} loop with sleep, which ends when nobody can tell" if loop else ""
    if name == "read" and "<" not in words and not command.loops and not any(w.startswith("-") and "t" in w for w in words):
        return "read waits for an input"
    if name in _ENDLESS:
        needs, unless = _ENDLESS[name]
        if (needs is None or _has(words, needs)) and not (unless and _has(words, unless)):
            return f"{name} runs until it is ended"
        return ""
    return _follow(image, place, words, started, depth)


def _has(words: list[str], option: str) -> bool:
    return any(re.fullmatch(rf"(?:{option}).*", word) for word in words[1:])


def _follow(image: Image, place: str, words: list[str], started: int, depth: int) -> str:
    """The same of a script or Python program of the image that a command runs."""
    target, is_python = program_of(words)
    runs = words[0] in RUNNERS
    path = image.resolved(posixpath.join(RADIO_API, target)) if target else ""
    text = image.texts.get(path)
    if text is None or depth >= _DEPTH or path == place:
        return ""
    first = text.split("\n", 1)[0]
    if is_python or (not runs and "python" in first):
        return _python_reason(text, path)
    for command in foreground(commands(text)):
        if reason := _reason(image, path, command, started, depth + 1):
            return f"{path}:{command.line}: {reason}"
    return ""


def _python_reason(text: str, path: str) -> str:
    """Where a Python program that is waited for sleeps or runs on."""
    for number, line in enumerate(text.splitlines(), 1):
        code = line.split("#", 1)[0]
        if match := _SLEEPS.search(code):
            slept = match[1].strip()
            try:
                if float(slept) < LIMIT_S:
                    continue
            except ValueError:
                pass
            return f"{path} runs in the foreground, and {path}:{number} sleeps ({slept})"
        if match := _BLOCKS.search(code):
            return f"{path} runs in the foreground, and {path}:{number} runs on ({match[0]})"
    return ""
