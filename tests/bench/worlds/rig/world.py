# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn alike in both worlds: owners, the forms that have but one law, and how a scene is put together."""

import numpy as np

from . import causes as c
from . import files
from .scene import Recording, Scene
from .waves import Wave


def pick(rng, options):
    return options[int(rng.integers(len(options)))]


def log(rng, lo, hi):
    return float(10 ** rng.uniform(np.log10(lo), np.log10(hi)))


def sign(rng):
    return float(rng.choice([-1.0, 1.0]))


def ends(rng, scene, levels=("tx", "rx")):
    """(level, name) of one node."""
    level = pick(rng, levels)
    return level, pick(rng, list(scene.transmitters) if level == "tx" else scene.receivers)


def slot(level, part):
    return f"{level}_{part}"


def link_of(rng, scene):
    return pick(rng, list(scene.links))


def offset_known(scene):
    """Carrier offset that the twin knows; of several transmitters' the least."""
    told = [k.signed for k in scene.known if k.family == "carrier_frequency_offset"]
    return min(told, key=abs) if told else 0.0


def resolved(scene, link, tap):
    """A tap apart from its neighbours by more than the waveform resolves."""
    taps = scene.links[link]
    lo, hi = scene.wave(link[0]).band(10)
    width = 1 / ((hi - lo) * scene.rate)
    return all(abs(t["delay_s"] - taps[tap]["delay_s"]) > 0.9 * width for k, t in enumerate(taps) if k != tap)


def some_tap(rng, scene, least, weakest_db=-22.0):
    """(link, tap) of a link with so many taps."""
    links = [k for k, t in scene.links.items() if len(t) >= least]
    if not links:
        return None
    link = pick(rng, links)
    good = [k for k, t in enumerate(scene.links[link]) if t["gain_db"] > weakest_db and resolved(scene, link, k)]
    return (link, pick(rng, good)) if good else None


class World:
    """menu: {family: [builder(rng, scene) → Cause or None]}."""

    name = ""
    bundle = None
    outside = ()
    ambiguous = ()
    absent = ()
    network_families = (
        "carrier_frequency_offset",
        "sample_clock_offset",
        "phase_noise",
        "iq_imbalance",
        "dc_offset",
        "lo_leakage",
        "pa_nonlinearity",
        "adc_clipping",
        "quantization",
        "gain_step",
        "power_supply_hum",
        "front_end_filter",
        "extra_path",
        "tap_doppler",
        "tone_interference",
        "noise_floor",
        "spectral_inversion",
    )

    def __init__(self):
        self.menu = {
            "carrier_frequency_offset": [self.offset_small, self.offset_small, self.offset_wide, self.offset_drifting],
            "sample_clock_offset": [self.clock, self.clock_wide],
            "phase_noise": [self.phase_noise],
            "iq_imbalance": [self.imbalance],
            "dc_offset": [self.direct_current, self.direct_current_decaying],
            "lo_leakage": [self.leakage],
            "pa_nonlinearity": [self.amplifier],
            "adc_clipping": [self.clipping],
            "quantization": [self.quantizer],
            "gain_step": [self.gain_step],
            "gain_drift": [self.gain_drift],
            "power_supply_hum": [self.hum],
            "front_end_filter": [self.filter],
            "extra_path": [self.extra_path, self.extra_path, self.extra_path_moving, self.extra_path_close],
            "missing_path": [self.missing_path],
            "tap_gain_error": [self.tap_gain],
            "tap_delay_error": [self.tap_delay],
            "tap_doppler": [self.tap_doppler],
            "tap_fading": [self.tap_fading],
            "diffuse_tail": [self.tail],
            "second_transmitter": [self.second],
            "tone_interference": [self.tone],
            "narrowband_interference": [self.narrowband],
            "pulsed_interference": [self.pulsed],
            "impulsive_noise": [self.impulses],
            "noise_floor": [self.noise_floor],
            "signal_dependent_noise": [self.signal_noise],
            "sample_loss": [self.sample_loss],
            "spectral_inversion": [self.inversion],
        }

    def cause(self, rng, family, scene):
        made = pick(rng, self.menu[family])(rng, scene)
        if made is not None:
            made.seed = int(rng.integers(2**31))
        return made

    def after(self, rng, scene, cause):
        """A last touch on a case of one cause."""
        if cause.family == "adc_clipping" and scene.datatype in ("ci16_le", "cf32_le") and rng.random() < 0.4:
            rail = cause.rail(c.scene.Context(scene, scene.recordings[0]))
            full = 32767 / 32768 if scene.datatype == "ci16_le" else 1.0
            rescale(scene, full / rail)
            cause.rails, cause.form = True, "rails at full scale"

    # ------------------------------------------------------------ oscillators, clocks
    def offset_small(self, rng, scene):
        level, name = ends(rng, scene)
        hz = 0.3 / scene.duration
        hi = 0.004 * scene.rate
        return c.CarrierOffset(
            slot=slot(level, "lo"), level=level, name=name, knob=hz, lo=1e-3 * hz, hi=hi, sign=sign(rng), form="small"
        )

    def offset_wide(self, rng, scene):
        room = []
        for tx in scene.transmitters:
            lo, hi = scene.wave(tx).band(45)
            room.append(min(0.5 - hi, 0.5 + lo) if scene.wave(tx).limited else 0.0)
        room = min(0.1, min(room) - 0.01) - abs(offset_known(scene)) / scene.rate
        if room < 0.01 or scene.tell_noise is None:
            return None
        level, name = ends(rng, scene)
        hz = log(rng, 0.005, room) * scene.rate
        return c.CarrierOffset(slot=slot(level, "lo"), level=level, name=name, knob=hz, fixed=True, sign=sign(rng), form="wide")

    def offset_drifting(self, rng, scene):
        made = self.offset_small(rng, scene)
        made.drift_ratio = sign(rng) * log(rng, 0.2, 5.0)
        made.form = "drifting"
        return made

    def clock(self, rng, scene):
        level, name = ends(rng, scene)
        ppm = 0.02 / scene.count * 1e6
        return c.ClockOffset(
            slot=slot(level, "clock"), level=level, name=name, knob=ppm, lo=1e-6, hi=200.0, sign=sign(rng), form="tuned"
        )

    def clock_wide(self, rng, scene):
        made = self.clock(rng, scene)
        made.knob, made.fixed, made.form = log(rng, 5.0, 200.0), True, "wide"
        return made

    # ------------------------------------------------------------ mixers
    def imbalance(self, rng, scene):
        if any(scene.wave(tx).real for tx in scene.transmitters):
            return None
        level, name = ends(rng, scene)
        turn, both = rng.uniform(0, 2 * np.pi), bool(rng.random() < 0.5)
        return c.Imbalance(
            slot=slot(level, "iq"),
            level=level,
            name=name,
            knob=0.003,
            lo=2e-4,
            hi=0.12,
            turn=turn,
            both=both,
            form="both arms" if both else "one arm",
        )

    def apart(self, scene):
        """The receiver's zero and the transmitter's carrier are apart in the recording."""
        return abs(offset_known(scene)) * scene.duration > 8

    def direct_current(self, rng, scene):
        if not self.apart(scene):
            return None
        _, name = ends(rng, scene, ("rx",))
        return c.DirectCurrent(level="rx", name=name, knob=0.02, lo=1e-5, hi=0.7, angle=rng.uniform(0, 2 * np.pi), form="steady")

    def direct_current_decaying(self, rng, scene):
        made = self.direct_current(rng, scene) if self.apart(scene) else None
        if scene.network:
            return made
        _, name = ends(rng, scene, ("rx",))
        decay = scene.duration * log(rng, 0.04, 0.4)
        angle = rng.uniform(0, 2 * np.pi)
        return c.DirectCurrent(level="rx", name=name, knob=0.02, lo=1e-5, hi=1.0, angle=angle, decay_s=decay, form="decaying")

    def leakage(self, rng, scene):
        if not self.apart(scene):
            return None
        _, name = ends(rng, scene, ("tx",))
        return c.Leakage(level="tx", name=name, knob=0.02, lo=1e-5, hi=0.5, angle=rng.uniform(0, 2 * np.pi), form="carrier")

    def inversion(self, rng, scene):
        if any(scene.wave(tx).real for tx in scene.transmitters) or scene.known:
            return None
        _, name = ends(rng, scene, ("rx",))
        return c.Inversion(level="rx", name=name, knob=1.0, form="high-side mixing")

    # ------------------------------------------------------------ gains
    def gain_slot(self, rng, level):
        return "tx_gain" if level == "tx" else pick(rng, ["rx_front", "rx_gain"])

    def span(self, scene):
        """Seconds in which a burst is on, of the recording; the whole of it where the waveform repeats."""
        r = scene.recordings[0]
        w = scene.wave(r.transmitters[0])
        if w.repeat:
            return 0.0, scene.duration
        return r.delay / scene.rate, min(scene.duration, (r.delay + len(w.samples)) / scene.rate)

    def gain_step(self, rng, scene):
        level, name = ends(rng, scene)
        a, b = self.span(scene)
        n = round((a + (b - a) * (rng.uniform(0.004, 0.996) if not scene.network else rng.uniform(0.1, 0.9))) * scene.rate)
        return c.Gain(
            family="gain_step",
            slot=self.gain_slot(rng, level),
            level=level,
            name=name,
            knob=0.1,
            lo=1e-4,
            hi=10.0,
            sign=sign(rng),
            where_s=n / scene.rate,
            form="step",
        )

    def gain_drift(self, rng, scene):
        level, name = ends(rng, scene)
        relaxing = rng.random() < 0.5
        tau = scene.duration * log(rng, 0.08, 0.6) if relaxing else 0.0
        return c.Gain(
            family="gain_drift",
            slot=self.gain_slot(rng, level),
            level=level,
            name=name,
            knob=0.1,
            lo=1e-4,
            hi=4.0,
            sign=sign(rng),
            time_constant_s=tau,
            form="relaxation" if relaxing else "linear",
        )

    def hum(self, rng, scene):
        level, name = ends(rng, scene)
        options = [f for f in self.hums(rng, scene) if 2.0 / scene.duration < f < scene.rate / 50]
        if not options:
            return None
        rich = rng.random() < 0.4
        harmonics = [(2, rng.uniform(0.1, 0.4), rng.uniform(0, 6.28)), (3, rng.uniform(0.03, 0.2), rng.uniform(0, 6.28))]
        return c.Gain(
            family="power_supply_hum",
            slot=self.gain_slot(rng, level),
            level=level,
            name=name,
            knob=0.01,
            lo=1e-5,
            hi=0.4,
            frequency_hz=pick(rng, options),
            phase=rng.uniform(0, 6.28),
            harmonics=harmonics if rich else [],
            form="with harmonics" if rich else "sine",
        )

    # ------------------------------------------------------------ paths
    def room(self, scene, link):
        """(least, largest) delay of an echo that a search by the period can tell."""
        w = scene.wave(link[0])
        lo, hi = w.band(10)
        longest = min(len(w.samples) / 3, 400) if w.repeat else 400
        return 1.3 / ((hi - lo) * scene.rate), longest / scene.rate

    def extra_path(self, rng, scene):
        link = link_of(rng, scene)
        least, longest = self.room(scene, link)
        taps = [t["delay_s"] for t in scene.links[link]]
        for _ in range(30):
            d = taps[0] + log(rng, least, longest)
            if all(abs(d - t) > least for t in taps):
                return c.ExtraPath(
                    name=">".join(link),
                    knob=0.05,
                    lo=1e-4,
                    hi=0.9,
                    delay_s=round(d, 12),
                    phase=rng.uniform(-np.pi, np.pi),
                    form="still",
                )
        return None

    def extra_path_moving(self, rng, scene):
        made = self.extra_path(rng, scene)
        if made is not None:
            made.doppler_hz = sign(rng) * min(log(rng, 0.7, 30) / scene.duration, 1e-6 * scene.carrier)
            made.form = "moving"
        return made

    def extra_path_close(self, rng, scene):
        """Within a sample of the direct path: a filter to the recording."""
        link = link_of(rng, scene)
        d = round(scene.links[link][0]["delay_s"] + rng.uniform(0.4, 0.95) / scene.rate, 12)
        return c.ExtraPath(
            name=">".join(link),
            knob=0.05,
            lo=1e-4,
            hi=0.6,
            delay_s=d,
            phase=rng.uniform(-np.pi, np.pi),
            form="close",
            same_as=["front_end_filter"],
        )

    def missing_path(self, rng, scene):
        found = some_tap(rng, scene, 3)
        return found and c.MissingPath(name=">".join(found[0]), tap=found[1], knob=1.0, form="gone")

    def tap_gain(self, rng, scene):
        found = some_tap(rng, scene, 3)
        return found and c.TapError(
            family="tap_gain_error",
            name=">".join(found[0]),
            tap=found[1],
            knob=0.05,
            lo=1e-4,
            hi=0.7,
            turn=rng.uniform(0, 2 * np.pi),
            form="gain and phase",
        )

    def tap_delay(self, rng, scene):
        found = some_tap(rng, scene, 3)
        return found and c.TapError(
            family="tap_delay_error",
            name=">".join(found[0]),
            tap=found[1],
            knob=0.02 / scene.rate,
            lo=1e-5 / scene.rate,
            hi=1.5 / scene.rate,
            sign=sign(rng),
            form="shifted",
        )

    def tap_doppler(self, rng, scene):
        found = some_tap(rng, scene, 2)
        if not found:
            return None
        hi = min(40 / scene.duration, 1e-6 * scene.carrier)
        return c.TapError(
            family="tap_doppler",
            name=">".join(found[0]),
            tap=found[1],
            knob=min(hi, 0.1 / scene.duration),
            lo=1e-3 / scene.duration,
            hi=hi,
            sign=sign(rng),
            form="moving",
        )

    def tap_fading(self, rng, scene):
        if scene.network:
            return None
        found = some_tap(rng, scene, 1)
        if not found:
            return None
        process, spread, form = self.fadings(rng, scene)
        return c.TapFading(
            name=">".join(found[0]), tap=found[1], knob=0.1, lo=1e-3, hi=1.5, process=process, spread_hz=spread, form=form
        )

    def tail(self, rng, scene):
        link = link_of(rng, scene)
        w = scene.wave(link[0])
        limit = len(w.samples) / 10 if w.repeat else 200
        samples = log(rng, 3.0, min(40.0, limit))  # 7 e-folds: short, and longer than 64 samples
        start = scene.links[link][-1]["delay_s"] if rng.random() < 0.3 else scene.links[link][0]["delay_s"]
        rice = bool(rng.random() < 0.5)
        return c.Tail(
            name=">".join(link),
            knob=0.05,
            lo=1e-3,
            hi=0.7,
            start_s=start + 1 / scene.rate,
            decay_s=samples / scene.rate,
            spacing_s=1 / scene.rate,
            rice=rice,
            form=("rice" if rice else "complex Gaussian") + (", long" if 5 * samples > 64 else ""),
        )

    # ------------------------------------------------------------ environment
    def second(self, rng, scene):
        wave = scene.waves.get("w9") or self.neighbour(rng, scene)
        if wave is None:
            return None
        scene.waves["w9"] = wave
        delay = rng.uniform(0, len(wave.samples))
        return c.SecondTransmitter(wave="w9", knob=0.05, lo=1e-4, hi=0.9, delay=delay, form=wave.name)

    def tone(self, rng, scene):
        r = scene.rate
        f = sign(rng) * rng.uniform(0.01, 0.45) * r
        if abs(f - offset_known(scene)) < 20 / scene.duration:
            return None
        return c.Tone(knob=0.03, lo=1e-5, hi=1.5, frequency_hz=f, form="tone")

    def noise_floor(self, rng, scene):
        if not scene.tell_noise or scene.datatype in ("ci8", "cu8"):
            return None
        _, name = ends(rng, scene, ("rx",))
        s = 1.0 if rng.random() < 0.8 else -1.0
        return c.NoiseFloor(
            name=name, knob=0.3, lo=1e-3, hi=12.0 if s > 0 else 3.0, sign=s, form="louder" if s > 0 else "quieter"
        )

    def signal_noise(self, rng, scene):
        tx = next(iter(scene.transmitters))
        if scene.wave(tx).variation < 0.25 and len(scene.links[(tx, scene.receivers[0])]) < 2:
            return None
        if not scene.wave(tx).repeat and scene.wave(tx).variation < 0.1:
            return None
        _, name = ends(rng, scene, ("rx",))
        smooth = pick(rng, [1, 1, 4])
        return c.SignalNoise(name=name, knob=0.5, lo=1e-2, hi=8.0, smooth=smooth, form="instant" if smooth == 1 else "smoothed")

    # ------------------------------------------------------------ converters
    def clipping(self, rng, scene):
        _, name = ends(rng, scene, ("rx",))
        return c.Clipping(name=name, knob=0.7, lo=0.2, hi=1.7, form="rails below full scale")

    def quantizer(self, rng, scene):
        if scene.datatype in ("ci8", "cu8"):
            return None
        _, name = ends(rng, scene, ("rx",))
        sigma = np.sqrt(scene.noise[name])
        grid = 1 / 32768 if scene.datatype == "ci16_le" else 0.0
        rise = bool(rng.random() < 0.4) and not grid
        dither = pick(rng, [0, 0, 1, 2])
        rms = np.sqrt(scene.noise[name]) + max(np.sqrt(c._wanted(scene, r)) for r in scene.recordings)
        return c.Quantizer(
            name=name,
            knob=sigma,
            lo=max(0.05 * sigma, 2 * grid),
            hi=1.2 * rms,
            rise=rise,
            dither=dither,
            grid=grid,
            form=("mid-rise" if rise else "mid-tread") + (", dithered" if dither else ""),
        )

    def sample_loss(self, rng, scene):
        _, name = ends(rng, scene, ("rx",))
        a, b = self.span(scene)
        u = pick(rng, [rng.uniform(0.002, 0.01), rng.uniform(0.99, 0.998), *rng.uniform(0.01, 0.99, 4)])
        place = int((a + (b - a) * u) * scene.rate)
        k = int(round(log(rng, 1, 1200)))
        periods = [len(scene.wave(tx).samples) for tx in scene.transmitters]
        if any(k % p == 0 for p in periods):
            return None
        lost = rng.random() < 0.65
        fill = pick(rng, ["zeros", "repeat"])
        return c.SampleLoss(
            name=name,
            knob=1.0,
            place=place,
            samples=k if lost else -k,
            fill=fill,
            form="lost" if lost else f"inserted, {fill}",
        )


# ---------------------------------------------------------------- scenes
def rescale(scene, factor):
    for r in scene.recordings:
        r.gain = r.gain * factor
    scene.noise = {k: v * factor**2 for k, v in scene.noise.items()}
    scene.cache.clear()


def round_tap(delay_s, gain_db, phase, doppler=0.0):
    return {
        "delay_s": round(float(delay_s), 13),
        "gain_db": round(float(gain_db), 3),
        "phase_rad": round(float(phase), 4),
        "doppler_hz": round(float(doppler), 3),
    }


def length(rng, wave):
    """Mostly 20 000 to 150 000 samples, a tenth longer; a burst fits into it."""
    n = int(log(rng, 150_000, 300_000) if rng.random() < 0.1 else log(rng, 20_000, 150_000))
    if not wave.repeat:
        n = max(n, int(len(wave.samples) * rng.uniform(1.1, 1.6)) + 800)
        n = min(n, int(len(wave.samples) * 2.5) + 2000)
    return max(n, 4 * len(wave.samples)) if wave.repeat and len(wave.samples) < 30_000 else n


def single_link(rng, *, wave, rate, carrier, count, taps, snr_db, datatype, amplitude=1.0, tell_noise=None):
    """One transmitter, one receiver, one recording, with levels that the converter can hold."""
    delay = float(rng.uniform(0, len(wave.samples)))
    if rng.random() < 0.25:
        delay = float(np.floor(delay))
    if not wave.repeat:
        spare = count - len(wave.samples) - max(t["delay_s"] for t in taps) * rate - 200
        delay = float(rng.uniform(60, max(spare, 61)))
    scene = Scene(
        rate=rate,
        carrier=carrier,
        count=count,
        waves={"w1": wave},
        transmitters={"tx1": ("w1", amplitude)},
        receivers=["rx1"],
        links={("tx1", "rx1"): taps},
        noise={"rx1": 1e-9},
        datatype=datatype,
        seed=int(rng.integers(2**31)),
        recordings=[Recording(name="recording", receiver="rx1", transmitters=["tx1"], gain=1.0, delay=delay, index=0)],
        tell_noise=bool(rng.random() < 0.6) if tell_noise is None else tell_noise,
    )
    level(rng, scene, snr_db)
    return scene


def level(rng, scene, snr_db):
    """Gains and noise, such that a file's integers neither clip nor coarsen."""
    small = scene.datatype in ("ci8", "cu8")
    for r in scene.recordings:
        scene.noise[r.receiver] = 1e-9
        scene.cache.clear()
        power = c._wanted(scene, r)
        y = np.abs(c.scene.baseline(scene, r)).max()
        crest = y / np.sqrt(power)
        rms = rng.uniform(0.5, 0.75) / crest if small else min(log(rng, 0.01, 0.2), 0.6 / crest)
        r.gain = rms / np.sqrt(power) * np.exp(1j * rng.uniform(-np.pi, np.pi))
        sigma2 = rms**2 / 10 ** (snr_db / 10)
        scene.noise[r.receiver] = max(sigma2, 2 * (1.3 / 128) ** 2) if small else max(sigma2, 2 * (3 / 32768) ** 2)
    scene.cache.clear()


def know_offset(rng, scene, hz, *, refined=False, level="rx"):
    """The twin lists a carrier offset: fixed, or to be refined within its std. Over several paths it is the receiver's, which
    turns them all alike."""
    level = "rx" if len(scene.links[("tx1", "rx1")]) > 1 else level
    name = scene.receivers[0] if level == "rx" else next(iter(scene.transmitters))
    std = float(log(rng, 0.5, 3.0) / scene.duration) if refined else 0.0
    told = round(float(hz + std * rng.standard_normal()), 3)
    scene.known.append(
        c.CarrierOffset(slot=slot(level, "lo"), level=level, name=name, knob=abs(hz if refined else told), sign=np.sign(hz))
    )
    p = {"offset_hz": {"value": told, "std": std}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
    scene.twin_effects.append(_entry("carrier_frequency_offset", level, name, p))
    scene.cache.clear()


def _entry(family, level, name, parameters):
    return {"family": family, "owner": {"level": level, "name": name}, "parameters": files.plain(parameters)}


def know_clock(rng, scene, ppm, *, refined=False):
    std = 0.02 / scene.count * 1e6 if refined else 0.0
    told = round(float(ppm + std * rng.standard_normal()), 5)
    true = ppm if refined else told
    scene.known.append(c.ClockOffset(slot="tx_clock", level="tx", name="tx1", knob=abs(true), sign=np.sign(true)))
    scene.twin_effects.append(_entry("sample_clock_offset", "tx", "tx1", {"offset_ppm": {"value": told, "std": std}}))
    scene.cache.clear()


def know_step(rng, scene, step_db):
    place = round(rng.uniform(0.1, 0.9) * scene.count) / scene.rate
    made = c.Gain(
        family="gain_step", slot="tx_gain", level="tx", name="tx1", knob=abs(step_db), sign=np.sign(step_db), where_s=place
    )
    scene.known.append(made)
    p = {"time_s": {"value": place, "std": 0.0}, "step_db": {"value": float(step_db), "std": 0.0}}
    scene.twin_effects.append(_entry("gain_step", "tx", "tx1", p))
    scene.cache.clear()


def know_path(rng, scene, delay_s, gain_db, phase):
    gain_db, phase, delay_s = round(gain_db, 3), round(phase, 4), round(delay_s, 12)
    scene.known.append(c.ExtraPath(name="tx1>rx1", knob=10 ** (gain_db / 20), delay_s=delay_s, phase=phase))
    told = {"delay_s": delay_s, "gain_db": gain_db, "phase_rad": phase, "doppler_hz": 0.0}
    p = {k: {"value": float(v), "std": 0.0} for k, v in told.items()}
    scene.twin_effects.append(_entry("extra_path", "link", "tx1>rx1", p))
    scene.cache.clear()


def grid_network(
    rng, *, make_wave, make_taps, rate, carrier, count, snr_db, transmitters, receivers, offset_hz=0.0, together=False
):
    """Every transmitter to every receiver, one recording each, one after the other; or all on the air together, one recording
    per receiver, every link with a gain and phase that the twin does not claim."""
    txs = [f"tx{k + 1}" for k in range(transmitters)]
    rxs = [f"rx{k + 1}" for k in range(receivers)]
    waves = {}
    for k in range(transmitters):
        waves[f"w{k + 1}"] = make_wave(k)
    scene = Scene(
        rate=rate,
        carrier=carrier,
        count=count,
        waves=waves,
        receivers=rxs,
        datatype=pick(rng, ["cf32_le", "ci16_le"]),
        transmitters={tx: (f"w{k + 1}", float(pick(rng, [1.0, 0.8]))) for k, tx in enumerate(txs)},
        links={(tx, rx): make_taps(k) for k, tx in enumerate(txs) for rx in rxs},
        recordings=[],
        noise={rx: 1e-9 for rx in rxs},
        seed=int(rng.integers(2**31)),
        tell_noise=True,
    )
    if together:
        scene.link_unknown = {k: ["gain", "phase"] for k in scene.links}
        scene.link_turn = {k: 10 ** (rng.uniform(-5, 0) / 20) * np.exp(1j * rng.uniform(-np.pi, np.pi)) for k in scene.links}
        for n, rx in enumerate(rxs):
            delay = float(rng.uniform(0, len(waves["w1"].samples)))
            scene.recordings.append(Recording(name=f"rec_{rx}", receiver=rx, transmitters=txs, gain=1.0, delay=delay, index=n))
    for n, (tx, rx) in enumerate(scene.links if not together else []):
        delay = float(rng.uniform(0, len(scene.wave(tx).samples)))
        scene.recordings.append(Recording(name=f"rec_{tx}_{rx}", receiver=rx, transmitters=[tx], gain=1.0, delay=delay, index=n))
    for rx in rxs:
        mine = [r for r in scene.recordings if r.receiver == rx]
        rms = log(rng, 0.03, 0.15)
        sigma2 = rms**2 / 10 ** ((snr_db + rng.uniform(-2, 2)) / 10)
        for r in mine:
            scene.cache.clear()
            power = c._wanted(scene, r)
            r.gain = rms * 10 ** (rng.uniform(-4, 0) / 20) / np.sqrt(power) * np.exp(1j * rng.uniform(-np.pi, np.pi))
        scene.noise[rx] = sigma2
    scene.cache.clear()
    for rx in rxs if offset_hz else []:
        hz = round(offset_hz * sign(rng) * rng.uniform(0.7, 1.3), 3)
        scene.known.append(c.CarrierOffset(slot="rx_lo", level="rx", name=rx, knob=abs(hz), sign=np.sign(hz)))
        p = {"offset_hz": {"value": hz, "std": 0.0}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
        scene.twin_effects.append(_entry("carrier_frequency_offset", "rx", rx, p))
    scene.cache.clear()
    return scene


def hide(rng, wave, fractions=(0.5, 0.85), stretches=(4, 12)):
    """Hides stretches of the reference: data between pilots. What is sent stays as it is."""
    n = len(wave.samples)
    known = np.zeros(n, bool)
    count = int(rng.integers(*stretches))
    share = rng.uniform(*fractions)
    for k in range(count):
        a = int((k + 0.5 * rng.uniform()) * n / count)
        known[a : a + int(share * n / count)] = True
    return Wave(**{**wave.__dict__, "known": known, "name": wave.name + "+unknown"})
