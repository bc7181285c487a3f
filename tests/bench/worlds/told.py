# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth of a case, as all worlds tell it."""


def truth(kind, verdicts, effects, fits, taps, conditions, *, network, case="", tolerated=(), ambiguous=None, **more):
    """`more` stands last; a world's seal holds the order."""
    return {
        "kind": kind,
        "verdicts_ok": list(verdicts),
        "ambiguous": ambiguous,
        "tolerated": list(tolerated),
        "harmless": [],
        "never_claim": [],
        "case": case,
        "effects": effects,
        "fit": fits,
        "tap_delays_s": [t["delay_s"] for t in taps],
        "network": network,
        "conditions": conditions,
        **more,
    }
