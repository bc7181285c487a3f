# SPDX-License-Identifier: GPL-3.0-or-later
"""gr-cast: create, emulate, sound and diagnose wireless digital twins.

The package reads as the data flows: `signals`, `scenario`, `emulation`, `sounding`, `comparing`, `twin`, `diagnose`,
`experiments`, `report`; no room imports a later one.
Only `gr_cast.blocks` needs GNU Radio; everything else needs NumPy and SciPy alone.

What a notebook wants is here, and loaded when it is first asked for:

    sent = gr_cast.Recording(samples=…, sample_rate_hz=50e6)
    heard = gr_cast.emulate(gr_cast.scenario.load("four_tap"), {"1": sent})["2"]
    found = gr_cast.sound(heard, gr_cast.waveform("glfsr:9"))
"""

import importlib

__version__ = "0.2.0"

_PLACES = {  # name here → (room or module, name there; None: the module itself)
    "Recording": ("signals.recording", "Recording"),
    "read": ("signals.recording", "read"),
    "write": ("signals.recording", "write_recording"),
    "waveform": ("signals.waveform", "waveform_from_text"),
    "scenario": ("scenario", None),
    "emulate": ("emulation.network", "emulate_network"),
    "SoundingOptions": ("sounding.sound", "SoundingOptions"),
    "sound": ("sounding.sound", "sound"),
    "Series": ("comparing.series", "Series"),
    "compare": ("comparing.similarity", "compare"),
    "read_case": ("twin.document", "read_case"),
    "diagnose": ("diagnose", None),
}
__all__ = list(_PLACES)


def __getattr__(name: str):
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACES[name]
    found = importlib.import_module(f"{__name__}.{module}")
    return found if attribute is None else getattr(found, attribute)


def __dir__():
    return sorted({*globals(), *__all__})
