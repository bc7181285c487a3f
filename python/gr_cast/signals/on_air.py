# SPDX-License-Identifier: GPL-3.0-or-later
"""What a recording says of who was on the air: `cast:transmitter` with `cast:waveform`, or, of several, `cast:transmitters`.

A waveform's entry is that of a twin: `{code: NAME, …}` of a built-in code, `{file: STEM, repeat: true}` of a SigMF file.
"""

from ..core.documents import Reader
from ..core.errors import CastError


def fields(sent: dict[str, dict | None]) -> dict:
    """The metadata that say so: transmitter to the entry of its waveform, None where nobody knows it."""
    if len(sent) != 1:
        return {"cast:transmitters": sent} if sent else {}
    ((node, entry),) = sent.items()
    return {"cast:transmitter": node} | ({"cast:waveform": entry} if entry else {})


def sent(metadata: dict, where: str) -> dict[str, dict | None]:
    """`fields`, read back. Empty where the recording does not tell. Raises CastError where it tells what cannot be."""
    get = Reader(where)
    node, entry = metadata.get("cast:transmitter"), metadata.get("cast:waveform")
    found = metadata.get("cast:transmitters", {} if node in (None, "") else {node: entry})
    for name, waveform in get.mapping(found, "cast:transmitters").items():
        get.name(name, "cast:transmitter")
        if waveform is not None:
            get.mapping(waveform, f"cast:waveform of {name}")
    get.faults.raise_if_any()
    return found


def only_waveform(metadata: dict, where: str) -> dict:
    """The entry of the one waveform in a recording. Raises CastError, saying what to type, where there is none or several."""
    entry = metadata.get("cast:waveform")  # known, though not always whose it is
    if isinstance(entry, dict):
        return entry
    several = [f"{node} ({'unknown' if one is None else _short(one)})" for node, one in sent(metadata, where).items()]
    if len(several) > 1:
        raise CastError(f"{where}: {', '.join(several)} send at once: name the waveform to sound, such as --code glfsr:10")
    raise CastError(
        f"{where}: does not name its waveform (cast:waveform): add --code, such as --code glfsr:8 or --code file:STEM"
    )


def _short(entry: dict) -> str:
    if "file" in entry:
        return f"file:{entry['file']}"
    return ":".join(str(value) for key, value in entry.items() if key != "samples_per_chip")
