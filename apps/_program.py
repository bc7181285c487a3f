# SPDX-License-Identifier: GPL-3.0-or-later
"""What every program shares: find gr_cast beside the program, show progress, turn bad input into one line and exit status 2."""

import argparse
import contextlib
import difflib
import math
import multiprocessing
import os
import re
import select
import sys
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
PREFIX = (_HERE / "../../..").resolve()  # where this is installed; a checkout may lie in the root folder
# A built checkout first, then the plain sources, then that prefix.
_PLACES = [_HERE.parent / "build" / "python", _HERE.parent / "python"] + [
    PREFIX / "lib" / _PYTHON / folder for folder in ("dist-packages", "site-packages")
]
sys.path[:0] = [str(place) for place in _PLACES if (place / "gr_cast").is_dir()]

_main = Path(getattr(sys.modules["__main__"], "__file__", None) or "none")  # not of a program where this is only imported
_IS_PROGRAM = _main.resolve().parent == _HERE


def _lacking() -> str:
    """What to do where this Python has not what every program loads first of all; empty where it has."""
    names = [name for name in ("numpy", "scipy", "matplotlib", "yaml") if find_spec(name) is None]
    is_systems = Path(sys.executable).resolve() == Path("/usr/bin/python3").resolve()
    remedy = f"apt-get install python3-{' python3-'.join(names)}" if is_systems else "run this with /usr/bin/python3"
    return f"error: no {', '.join(names)} in {sys.executable}: {remedy}" if names else ""


if _IS_PROGRAM and (_told := _lacking()):
    print(_told, file=sys.stderr)
    sys.exit(2)

from gr_cast import __version__
from gr_cast.core import interrupts
from gr_cast.core.errors import CastError
from gr_cast.core.frequencies import LEAST_CARRIER_HZ, LEAST_RATE_HZ, hertz

if multiprocessing.parent_process() is not None or _IS_PROGRAM:
    interrupts.end_quietly()

os.environ.setdefault("GR_CONF_LOG_LOG_LEVEL", "warn")  # GNU Radio's own lines about every flowgraph; before it is loaded
LOST = 3
_COMMAND = "_command"  # the parser of the command that was given
PATIENCE_S = 10.0  # that a run may take without a word
_NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?[kMG]?$")


def parse(parser: argparse.ArgumentParser, argv=None, namespace=None) -> argparse.Namespace:
    """The arguments of a program, which then also tells its version, and completes in a shell where argcomplete is installed."""
    parser.add_argument("--version", action="version", version=f"{parser.prog.removesuffix('.py')} {__version__} (gr-cast)")
    if "_ARGCOMPLETE" in os.environ:
        with contextlib.suppress(ImportError):
            import argcomplete

            argcomplete.autocomplete(parser)
    args, unknown = settled(parser).parse_known_args(argv, namespace)
    command = vars(args).pop(_COMMAND)
    if unknown:  # argparse itself would name the help of the program, where the command's options are not
        command.error(f"unrecognized arguments: {' '.join(unknown)}{_meant(command, unknown)}")
    return args


def _meant(command: argparse.ArgumentParser, unknown: list[str]) -> str:
    """The options that somebody may have meant, as the end of a message; nothing where none is near."""
    every = [option for action in command._actions for option in action.option_strings if option.startswith("--")]
    words = [word.split("=")[0] for word in unknown if word.startswith("--")]
    begun = [option for word in words for option in every if option.startswith(word)]
    near = [option for word in words for option in difflib.get_close_matches(word, every, 1)]
    meant = list(dict.fromkeys(begun + near))
    return f"; is {' or '.join(meant)} meant?" if meant else ""


def settled(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """The parser of a program and those of its commands as all programs have them: every default told, -2e6 a number, and no
    option for another one of which it is the beginning (`--carrier` is no `--carrier-offset`)."""
    for one in _parsers(parser):
        one.allow_abbrev = False
        one.error = partial(_refuse, one)
        one.set_defaults(**{_COMMAND: one})
        one._negative_number_matcher = _NEGATIVE  # argparse's own takes -2e6 for an option
        for action in one._actions:
            action.help = _with_default(action)
    return parser


def _refuse(parser: argparse.ArgumentParser, message: str) -> None:
    """argparse's own way to refuse arguments shows all options first, which drowns the one line that says what is wrong."""
    commands = [name for action in parser._actions if isinstance(action, argparse._SubParsersAction) for name in action.choices]
    if commands and "required: COMMAND" in message:
        message = f"no command: {', '.join(commands)}"
    parser.exit(2, f"error: {message} ({parser.prog} --help)\n")


def _with_default(action: argparse.Action) -> str | None:
    """An option's help with its default, where it has one and does not tell it."""
    told, default = action.help or "", action.default
    if (
        default in (None, "", argparse.SUPPRESS)
        or default is False
        or default == []
        or "default" in told
        or not action.option_strings
    ):
        return action.help
    return f"{told} (default {default:g})".strip() if isinstance(default, float) else f"{told} (default {default})".strip()


def _parsers(parser: argparse.ArgumentParser):
    """A parser and those of its commands."""
    yield parser
    for action in parser._actions:
        for one in action.choices.values() if isinstance(action, argparse._SubParsersAction) else ():
            yield from _parsers(one)


NOT_BUILT = "this checkout is not built: bash apps/demo.sh installs what is missing and builds it"
_MISSING = {  # modules whose absence is a first mistake, and what to type next
    "gr_cast.blocks.cast_python": NOT_BUILT,
    "gnuradio": f"no GNU Radio in {sys.executable}: apt-get install gnuradio, and run this with /usr/bin/python3",
}


def _frequency(text: str, least_hz: float, what: str) -> float:
    try:
        return hertz(text, least_hz, what)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def rate(text: str) -> float:
    """A sample rate, argparse's type: `20e6`, `20M`, `30.72MS/s`; some hundred samples a second are questioned."""
    return _frequency(text, LEAST_RATE_HZ, "a rate")


def carrier(text: str) -> float:
    """A carrier, argparse's type: `2.4e9`, `2.4G`, `2400M`; kilohertz are questioned."""
    return _frequency(text, LEAST_CARRIER_HZ, "a carrier")


_begun: dict = {}  # of what progress is shown: (seconds, how much was done) when it was first
_left_told: set = set()  # of what progress has told how long it takes
_told_s = -math.inf  # when progress was last told without a terminal
_shown = False  # whether the last line is one of progress, which the next would go on


def progress(what: str, done: int, total: int) -> None:
    """Show how far it is, and how long the rest takes."""
    left = _left(what, done, total)
    is_news = left != "" and (what, total) not in _left_told  # how long it takes is not waited for a minute
    _left_told.update([(what, total)] if is_news else [])
    show(f"{what}: {done} of {total}{left}", last=done >= total, is_news=is_news)


def patient(what: str, done, total: int):
    """A look that shows progress, `done()` of total, of what takes longer than PATIENCE_S, and nothing of what does not."""
    begun = time.monotonic()

    def look() -> None:
        if time.monotonic() - begun > PATIENCE_S:
            progress(what, min(done(), total), total)

    return look


def _left(what: str, done: int, total: int) -> str:
    """How long the rest takes if it goes on as until now; nothing until that can be told, or where there is no rest."""
    now = time.monotonic()
    begun, before = _begun.setdefault((what, total), (now, done))
    if done >= total or done <= before:
        return ""
    left_s = (now - begun) / (done - before) * (total - done)
    return f", about {left_s / 60:.0f} min left" if left_s >= 90 else f", about {left_s:.0f} s left"


def show(line: str, last: bool = False, is_news: bool = False) -> None:
    """Show a line in the place of the one before, and the last one for good; without a terminal the first one, news, a line a
    minute, and the last one."""
    global _shown, _told_s
    if sys.stderr.isatty():
        _shown = not last
        print(f"\r\x1b[K{line}", end="" if _shown else "\n", file=sys.stderr, flush=True)
    elif last or is_news or time.monotonic() - _told_s >= 60:
        _told_s = time.monotonic()
        print(line, file=sys.stderr, flush=True)


def check_ranges(args, ranges: dict) -> None:
    """Options within what they can mean, {name: (low, high, unit)}; those that were not given pass, NaN does not.

    Raises CastError, a line per option.
    """
    faults = [
        f"--{name.replace('_', '-')}: got {value}, needs {low:g} to {high:g} {unit}".rstrip()
        for name, (low, high, unit) in ranges.items()
        if (value := getattr(args, name, None)) is not None and not low <= value <= high
    ]
    if faults:
        raise CastError(*faults)


def _say(line: str) -> None:
    print("\n" * _shown + line, file=sys.stderr)


def _is_read_no_more() -> bool:
    """Whether the reader of what is printed has left, as `head` does; what is still to be written is then dropped."""
    output = select.poll()
    output.register(1, 0)  # of errors it tells unasked
    if not output.poll(0):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return True


def add_web(command: argparse.ArgumentParser) -> None:
    """`--web [PORT]`: a live page; None without it."""
    from gr_cast.report.live import PORT

    command.add_argument(
        "--web", nargs="?", type=int, const=PORT, metavar="PORT",
        help=f"a live page on this machine alone (default port {PORT}; 0: any that is free); needs Bokeh",
    )  # fmt: skip


@contextlib.contextmanager
def live_page(port: int | None, view, title: str):
    """The page that `add_web` asks for, of what `view()` looks at; none where it was not asked for."""
    if port is None:
        yield
        return
    from gr_cast.report.live import served

    with served(view().look, title, port) as address:
        print(f"live page: {address}", file=sys.stderr)
        yield


def second(text: str) -> int:
    """A second of UTC, as an argument."""
    from gr_cast.blocks.usrp import second_of

    try:
        return second_of(text)
    except CastError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def lost(lines: list[str]) -> int:
    """Say what radios lost while all else went well; returns the status that a program then ends with."""
    for line in lines:
        _say(f"lost: {line}")
    return LOST if lines else 0


def run(main) -> None:
    """Call `main()` and leave with its status: 2 for refused input (a line per fault), LOST where a radio lost samples, 130
    after Ctrl-C, 141 without a word when nobody reads its output any more."""
    is_interrupted = interrupts.second_ends()
    try:
        try:
            status = main()
            print(end="", flush=True)
        finally:
            interrupts.settled()
    except CastError as error:
        _say("\n".join(f"error: {fault}" for fault in error.faults))
        status = 2
    except OSError as error:
        status = 141 if isinstance(error, BrokenPipeError) and _is_read_no_more() else 2
        if status == 2:
            _say(f"error: {error.filename or 'system'}: {error.strerror or error}")
    except ModuleNotFoundError as error:
        hint = _MISSING.get(error.name or "")
        if hint is None:
            raise
        _say(f"error: {hint}")
        status = 2
    except KeyboardInterrupt:
        _say("interrupted")
        status = 130
    except Exception:
        if not is_interrupted():
            raise
        _say("interrupted")
        status = 130
    sys.exit(status)
