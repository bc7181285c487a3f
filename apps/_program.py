# SPDX-License-Identifier: GPL-3.0-or-later
"""What every program shares: find gr_cast beside the program, and turn bad input into one line and exit status 2."""

import sys
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
# A built checkout first, then the plain sources, then the prefix that this program is installed in.
_PLACES = [_HERE.parent / "build" / "python", _HERE.parent / "python"] + [
    _HERE.parents[2] / "lib" / _PYTHON / folder for folder in ("dist-packages", "site-packages")
]
sys.path[:0] = [str(place) for place in _PLACES if (place / "gr_cast").is_dir()]

from gr_cast.errors import CastError


def run(main) -> None:
    """Call `main()` and leave with its status: 2 for refused input (a line per fault), 130 after Ctrl-C."""
    try:
        status = main()
    except CastError as error:
        print("\n".join(f"error: {fault}" for fault in error.faults), file=sys.stderr)
        status = 2
    except OSError as error:
        print(f"error: {error.filename or 'system'}: {error.strerror or error}", file=sys.stderr)
        status = 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        status = 130
    sys.exit(status)
