# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths left out, gone, elsewhere, moving or fading. Each cause: (link, rng, aim of λ) → Found."""

import math

import numpy as np
from scipy import interpolate, special

from . import strength
from .scene import Redraw, db, power
from .strength import scaled
from .truth import Found, told

TURN = 2 * np.pi


def free_delay(link, rng):
    apart = max(2.2, 1.6 / link.traits["bw"]) / link.rate
    for _ in range(60):
        d = rng.uniform(apart, max(link.spread_s, 3 * apart))
        if all(abs(d - t["delay_s"]) > apart for t in link.taps):
            return d
    raise Redraw("no room")


def some_tap(link, rng, least=3):
    if len(link.taps) < least:
        raise Redraw("taps")
    return int(rng.integers(1, len(link.taps)))


def extra_path(link, rng, aim):
    d, phase = free_delay(link, rng), rng.uniform(-np.pi, np.pi)
    doppler = 0.0 if rng.random() < 0.55 else float(rng.choice([-1, 1]) * rng.uniform(0.3, 6) / link.duration)
    doppler = float(np.clip(doppler, -3e-7 * link.carrier, 3e-7 * link.carrier))
    if abs(doppler) / link.carrier * link.n > 0.15:  # samples that the path slides by
        doppler = 0.0
    make = lambda s: dict(gain=s * np.exp(1j * phase), delay_s=d, doppler_hz=doppler)  # noqa: E731
    spec, lam = scaled(link, "extra_path", make, 0.05, 1e-6, 0.8, aim)
    p = dict(
        delay_s=told(d, True),
        gain_db=told(20 * math.log10(abs(spec["gain"])), True),
        phase_rad=told(phase),
        doppler_hz=told(doppler, bool(doppler)),
    )
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]))


def missing_path(link, rng, aim):
    """The twin's own tap is made as strong as the aim asks."""
    i = link.gone = some_tap(link, rng, 2)
    for _ in range(3):
        lam = strength.energy(link, {"missing_path": {}})
        if abs(math.log(max(lam, 1e-9) / aim)) < 0.35:
            break
        level = link.taps[i]["gain_db"] + db(aim / max(lam, 1e-9))
        link.taps[i]["gain_db"] = round(float(np.clip(level, -50, -1)), 3)
        link.settle()
    else:
        lam = strength.energy(link, {"missing_path": {}})
    if lam < strength.LEAST:
        raise Redraw("missing path does not show")
    d = link.taps[i]["delay_s"]
    return Found(spec={"tap": i}, lam=lam, parameters=dict(delay_s=told(d)), where=dict(delay_s=[d, d]))


def tap_gain(link, rng, aim):
    i, turn = some_tap(link, rng), rng.choice([0.0, rng.uniform(-1, 1), math.pi / 2 * rng.choice([-1, 1])])
    make = lambda s: dict(tap=i, log=s * np.exp(1j * turn), factor=np.exp(s * np.exp(1j * turn)))  # noqa: E731
    spec, lam = scaled(link, "tap_gain_error", make, 0.05, 1e-5, 0.9, aim)
    d, e = link.taps[i]["delay_s"], spec["log"]
    p = dict(delay_s=told(d), error_db=told(e.real * 20 / math.log(10), True), error_rad=told(e.imag, True))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]))


def tap_delay(link, rng, aim):
    i, sign = some_tap(link, rng), rng.choice([-1, 1])
    make = lambda s: dict(tap=i, later_s=sign * s / link.rate)  # noqa: E731
    spec, lam = scaled(link, "tap_delay_error", make, 0.1, 1e-5, 1.6, aim)
    d = link.taps[i]["delay_s"]
    if d + spec["later_s"] < 0.5 / link.rate:
        raise Redraw("order of the paths")
    p = dict(delay_s=told(d, also=[d + spec["later_s"]]), error_s=told(spec["later_s"], True))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]))


def tap_doppler(link, rng, aim):
    i, sign = some_tap(link, rng, 2), rng.choice([-1, 1])
    hi = min(3e-7 * link.carrier, 0.12 * link.carrier / link.n, 25 / link.duration)
    make = lambda s: dict(tap=i, doppler_hz=sign * s)  # noqa: E731
    spec, lam = scaled(link, "tap_doppler", make, min(hi, 0.1 / link.duration), 1e-9, hi, aim)
    d, nu = link.taps[i]["delay_s"], spec["doppler_hz"]
    p = dict(delay_s=told(d), doppler_hz=told(nu, True, [nu + link.taps[i]["doppler_hz"]]))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]), same_as=["extra_path_at_tap"])


# Shares of the scattered power below a Doppler, re the largest.
SPECTRA = {
    "jakes": lambda u: 0.5 + np.arcsin(np.clip(u, -1, 1)) / np.pi,
    "gaussian": lambda u: np.where(u >= 1, 1.0, np.where(u <= -1, 0.0, special.ndtr(3 * u))),
    "even": lambda u: np.clip(0.5 + u / 2, 0, 1),
}


def tap_fading(link, rng, aim):
    """Forty rays; the steady part is the twin's tap, the scattered part has no mean of its own in the recording."""
    i, form, rays = int(rng.integers(0, len(link.taps))), str(rng.choice(list(SPECTRA))), 40
    largest = 10 ** rng.uniform(np.log10(2.5), np.log10(40)) / link.duration
    if form == "jakes":
        nu = largest * np.cos(rng.uniform(0, TURN, rays))
    elif form == "gaussian":
        nu = np.clip(rng.standard_normal(rays) * largest / 3, -largest, largest)
    else:
        nu = rng.uniform(-largest, largest, rays)
    a = (rng.standard_normal(rays) + 1j * rng.standard_normal(rays)) / math.sqrt(2 * rays)
    early, late = -1000 / link.rate, (link.n + link.spare + 1000) / link.rate
    knots = np.linspace(early, late, max(600, int(24 * largest * (late - early))))
    spline = interpolate.CubicSpline(knots, np.exp(1j * TURN * np.outer(knots, nu)) @ a)
    inside = spline(np.linspace(0, link.duration, 3000))
    mean, rms = np.mean(inside), np.std(inside)

    def make(s):
        return dict(tap=i, s=s, course=lambda t: 1 + s * (spline(np.clip(t, early, late)) - mean) / rms)

    first, last = link.on_air
    on = (last - first) / link.rate
    edges = (np.arange(-math.ceil(largest * on), math.ceil(largest * on) + 2) - 0.5) / on
    shares = np.diff(SPECTRA[form](edges / largest))
    shares[len(shares) // 2] = 0  # its mean is taken out
    sent = power(link.x) * abs(link.gain) ** 2 * link.amplitude**2 * 10 ** (link.taps[i]["gain_db"] / 10)
    full = sent * (last - first) / link.noise
    total = int(link.mask.sum())
    measure = lambda spec: strength.modes(total, spec["s"] ** 2 * full * shares / shares.sum())  # noqa: E731
    spec, lam = scaled(link, "tap_fading", make, 0.05, 1e-5, 0.7, aim, measure)
    d = link.taps[i]["delay_s"]
    top, spread = float(np.max(np.abs(nu))), math.sqrt(float(np.sum(np.abs(a) ** 2 * nu**2) / np.sum(np.abs(a) ** 2)))
    p = dict(
        delay_s=told(d),
        k_factor_db=told(-20 * math.log10(spec["s"]), form == "jakes" and largest * link.duration > 20 and link.repeat),
        doppler_spread_hz=told(top, also=[largest, spread * math.sqrt(2), 2 * spread, spread, 2 * top]),
    )
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[d, d]))


def tail(link, rng, aim):
    """Dense echoes, echoes at random, or clusters of them, of exponentially falling power."""
    bw, rate = link.traits["bw"], link.rate
    decay = min(rng.uniform(max(2.0, 1 / bw), 14 / max(bw, 0.25)) / rate, link.spread_s / 3.2)
    start, form = rng.uniform(0.3, 3) / rate, rng.choice(["dense", "random", "clusters"])
    late, d = [], start
    while d < start + 6 * decay:
        late.append(d)
        d += (rng.exponential(0.6) if form == "random" else 0.37) / rate
    late = np.array(late)
    size = np.exp(-(late - start) / 2 / decay)
    if form == "clusters":
        first = [start, start + decay * rng.uniform(0.6, 1.2), start + decay * rng.uniform(1.4, 2.4)]
        size *= np.sqrt(0.4 + 0.6 * sum(np.where(late >= c, np.exp(-(late - c) / (decay * 0.4)), 0) for c in first))
    a = size * (rng.standard_normal(len(late)) + 1j * rng.standard_normal(len(late)))
    a /= math.sqrt(np.sum(np.abs(a) ** 2))
    make = lambda s: dict(rays=list(zip(s * a, late, strict=True)), s=s)  # noqa: E731
    spec, lam = scaled(link, "diffuse_tail", make, 0.05, 1e-6, 0.6, aim)
    f = np.linspace(-0.5, 0.5, 801) * rate * min(1, bw)  # closer than a sample they add up within the band
    heard = power(sum(g * np.exp(-1j * TURN * f * d) for g, d in spec["rays"]))
    p = dict(decay_s=told(decay, also=[2 * decay]), power_db=told(db(heard), also=[20 * math.log10(spec["s"])]))
    return Found(spec=spec, lam=lam, parameters=p, where=dict(delay_s=[start, start + 3 * decay]))
