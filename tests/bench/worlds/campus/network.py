# SPDX-License-Identifier: GPL-3.0-or-later
"""Two or three transmitters, each heard by as many receivers, one link at a time: a cause's owner is seen in several."""

import math

import numpy as np

from . import causes_receiver, channel, menu, scene, strength, truth, waveforms
from .scene import Redraw, db
from .truth import told

TURN = 2 * np.pi
ENDS = {
    "carrier_frequency_offset": "tx",
    "sample_clock_offset": "both",
    "iq_imbalance": "both",
    "pa_nonlinearity": "tx",
    "front_end_filter": "both",
    "dc_offset": "rx",
    "lo_leakage": "tx",
    "power_supply_hum": "both",
    "phase_noise": "both",
    "adc_clipping": "rx",
    "tone_interference": "environment",
}


def links_of(rng, count):
    rate, carrier = float(rng.choice(scene.RATES[3:])), float(rng.choice(scene.CARRIERS))
    n, tells = int(rng.uniform(8000, 24000)), bool(rng.random() < 0.7)
    links = {}
    for i in range(count):
        while True:
            wave = waveforms.wave(rng, n, ["qam", "ofdm", "dsss"])
            if wave[2]:
                break
        for j in range(count):
            more = dict(wave=wave, rate=rate, carrier=carrier, n=n, amplitude=1.0, taps=int(rng.integers(1, 4)))
            snr = rng.uniform(15, 35)
            made = scene.link(rng, **more, offset=0.0, doppler=0.15, tells_noise=tells, snr_db=snr, network=True)
            links[f"tx{i + 1}", f"rx{j + 1}"] = made
    if len({link.n for link in links.values()}) > 1:
        raise Redraw("lengths")
    for rx in {rx for _, rx in links}:  # a receiver has one noise
        mine = [link for (_, b), link in links.items() if b == rx]
        level = float(np.mean([db(link.noise) for link in mine]))
        for link in mine:
            link.noise = 10 ** (level / 10)
            link.noisy = channel.received(link, {}, link.unit)
            if db(link.wanted / link.noise) < 4:
                raise Redraw("too weak beside the others")
    return links


def tone(rng, links):
    """Heard by all at levels of their own."""
    first = next(iter(links.values()))
    f = float(rng.uniform(-0.4, 0.4) * first.rate)
    if abs(f) < 30 / first.duration:
        raise Redraw("tone at zero")
    amplitude = math.sqrt(np.mean([link.noise for link in links.values()]) * 10 ** rng.uniform(-1.7, 0.5))
    specs, levels = {}, []
    for key, link in links.items():
        phase, a = rng.uniform(-3, 3), amplitude * rng.uniform(0.7, 1.4)
        specs[key] = dict(signal=lambda t, a=a, p=phase: a * np.exp(1j * (TURN * f * t + p)))
        levels.append(db(a * a / link.wanted))
    p = dict(frequency_hz=told(f, True), power_dbc=told(np.mean(levels), also=levels))
    return specs, truth.Found(spec={}, lam=0.0, parameters=p, where=dict(frequency_hz=[f, f]))


def owned(rng, links, family, level, mine):
    """{link: spec} and the Found of a node's cause."""
    first = links[mine[0]]
    for link in links.values():
        link.end = level
    found = menu.FAMILIES[family][0](first, rng, 10 ** rng.uniform(2, 4.3))
    specs = {}
    for k, key in enumerate(mine):
        spec = dict(found.spec)
        if family == "phase_noise" and k:  # the same oscillator, another time
            spec["phase"] = spec["phase"][::-1] if k == 1 else -spec["phase"]
        elif family == "power_supply_hum" and k:
            late = rng.uniform(0, 1)
            spec["gain"] = lambda t, g=spec["gain"], late=late: g(t + late)
        specs[key] = spec
    p = found.parameters
    if family == "dc_offset":
        levels = [p["level_dbc"]["value"] + db(first.wanted / links[key].wanted) for key in mine]
        p["level_dbc"] = told(np.mean(levels), also=levels)
    for name in ("rms_rad", "level", "depth", "level_dbc"):  # one number for several recordings
        if name in p and len(mine) > 1:
            p[name]["z"] = False
    return specs, found


def shown(links, family, key, spec, found):
    if family == "adc_clipping":
        return causes_receiver.clipping_energy(links[key], spec["level"])
    if family == "phase_noise":
        return found.lam
    return strength.energy(links[key], {family: spec})


def draw(rng, folder):
    count = int(rng.choice([2, 2, 3]))
    names = [str(f) for f in rng.choice(list(ENDS), int(rng.choice([1, 2])), replace=False)]
    if not menu.compatible(names):
        raise Redraw("company")
    links = links_of(rng, count)
    causes, effects = {key: {} for key in links}, []
    for family in names:
        level = ENDS[family] if ENDS[family] != "both" else str(rng.choice(["tx", "rx"]))
        who = "environment" if level == "environment" else f"{level}{int(rng.integers(1, count + 1))}"
        mine = [key for key in links if level == "environment" or who in key]
        specs, found = tone(rng, links) if level == "environment" else owned(rng, links, family, level, mine)
        lams = [shown(links, family, key, specs[key], found) for key in mine]
        if sorted(lams)[-2] < strength.LEAST:  # the owner is seen where two recordings show the cause
            raise Redraw("no owner shows")
        for key in mine:
            causes[key][family] = specs[key]
        found.lam = sum(lams)
        effects.append(truth.effect(family, level, found, [f"rec_{a}_{b}" for a, b in mine], only=who))
    heard = {key: channel.received(link, causes[key], link.unit) for key, link in links.items()}
    loudest = max(np.max(np.abs([y.real, y.imag])) for y in heard.values())
    kind = "ci16_le" if loudest < 0.98 and rng.random() < 0.6 else "cf32_le"
    samples, fits = {}, []
    for (a, b), link in links.items():
        name = f"rec_{a}_{b}"
        samples[name] = truth.stored(heard[a, b], kind)
        fits.append(truth.fit(link, name, samples[name], channel.received(link, causes[a, b])))
    truth.write(folder, links, samples, kind)
    return truth.of("network", list(links.values()), effects, fits, "identified")
