# SPDX-License-Identifier: GPL-3.0-or-later
"""The law of the noise: what every noise family says of the residual of a fit."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from ..twin.effects import FAMILIES, Role, is_coarse
from ..twin.effects.base import around_circle
from ..twin.effects.noise_family import NoiseView
from ..twin.model import predict
from .fit import in_band, off_the_rails, rounding_of_grids, shape_of_receiver, solve, with_noise
from .policy import BAND_OVER_SIGNAL, BESIDE_NOISE, BLUR_DOUBT, CLEAR_NATS, DRAWS, LEAST_APART, PASSBAND, RINGS, ROUNDED

TESTED = tuple(f.name for f in FAMILIES.values() if f.noise_like and f.role is not Role.FLOOR)  # laws of the noise, not its level
LAWS = {FAMILIES[name].told for name in TESTED}


def view_of(fit, but=None, inside=None) -> NoiseView:
    """The residual where it is the noise's, off the rails or at the samples `inside` (n,) bool, evened by every law of the noise
    that is a cause `but` one. A loud band, which knows nothing of time, has next to no say. Energies are as of circular noise,
    the spectrum is as it is."""
    shape, spread = shape_of_receiver(fit, fit.model), fit.data.scene.spread
    inside = off_the_rails(fit) if inside is None else inside
    residual, variance, told = fit.residual, 1.0 if shape is None else shape, _by_others(fit, but)
    if told is not None:
        variance = variance * (1.0 if told.variance is None else told.variance)
    if told is not None and told.spectrum is not None:
        residual = told.even(told.even(residual, inside), inside) / np.sqrt(np.mean(1 / told.spectrum))
    return NoiseView(
        use=spread(inside),
        energy=spread(np.abs(circular(residual, inside)) ** 2 / variance),
        wanted_power=spread(np.abs(fit.chain.wanted) ** 2),
        weighted=spread(residual * fit.data.root**2 * inside),
    )


def _off_impulses(fit, view: NoiseView) -> NoiseView:
    """What of a view no impulse is near, for what rings on is a band only while it does; all of it where too little is left."""
    if fit.data.impulses is None:
        return view
    loud = fit.data.scene.spread((fit.data.use > 0) & (fit.data.impulses[1] < 0.5))
    use = view.use & ~ndimage.binary_dilation(loud, iterations=RINGS)
    return replace(view, use=use, weighted=view.weighted * use) if use.sum() > LEAST_APART * view.use.sum() else view


def circular(residual: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """A residual (n,) with as much of its mirror image taken off as makes it circular over the samples `inside` (n,) bool, as
    loud as it was: noise that passes a receiver's unequal gains has energies that are spread more, told or not. A few loud
    samples have little say."""
    power = np.abs(residual) ** 2
    if not inside.any():
        return residual
    weight = inside / np.maximum(power, 4 * np.median(power[inside]) + 1e-300)
    lean = (residual**2 * weight).sum() / max((power * weight).sum(), 1e-300)
    out = residual - lean / (1 + np.sqrt(max(1 - abs(lean) ** 2, 0.0))) * np.conj(residual)
    return out * np.sqrt(power[inside].sum() / max((np.abs(out[inside]) ** 2).sum(), 1e-300))


def found_again(fit, effect):
    """A law of the noise as what the others leave tells it now, None where it is not there. Its strength is over the floor; of
    single samples and of a band over `floor_of`."""
    view = view_of(fit, but=effect)
    _, found = FAMILIES[effect.family].find(view, near=effect) if view.use.any() else (0.0, None)
    if found is None:
        return None
    if not _stands_alone(effect):
        found = found.moved(np.append(found.p[0] + np.log(_beside(fit, effect)), found.p[1:]))
    return replace(found, trials=effect.trials, key=effect.key)


def floor_of(fit, effect) -> float:
    """Power of the noise over which the strength of a law is told."""
    return fit.sigma2 * (_beside(fit, effect) if _stands_alone(effect) else 1.0)


def _stands_alone(effect) -> bool:
    """Whether a law is told over the noise that is beside it, for it changes no variance of even noise that others add to."""
    return FAMILIES[effect.family].scattered or FAMILIES[effect.family].band(effect) is not None


def _beside(fit, effect) -> float:
    """Power over the floor of the noise over which a law is found where all others are evened."""
    told, family = _by_others(fit, effect), FAMILIES[effect.family]
    if told is None:
        return 1.0
    weight = np.ones(1) if told.variance is None else 1 / told.variance
    beside = np.mean(weight) / np.mean(weight**2) if family.band(effect) else 1 / np.mean(weight)
    return float(beside / np.mean(1 / told.spectrum)) if family.scattered and told.spectrum is not None else float(beside)


def _by_others(fit, but):
    """The data with the noise's shape by every law that is a cause `but` one, None without any. What samples hold impulses was
    told beside all of them."""
    others = tuple(e for e in laws(fit.model) if e is not but)
    if not others:
        return None
    single, known = [e for e in others if FAMILIES[e.family].scattered], fit.data.impulses
    if not single or known is None:
        return with_noise(fit, replace(fit.model, effects=others))
    told = with_noise(fit, replace(fit.model, effects=tuple(e for e in others if e not in single)))
    return replace(told, variance=(1.0 if told.variance is None else told.variance) / known[1])


def laws(model) -> list:
    """The effects of a model that are laws of the noise, and causes."""
    return [e for e in model.effects if e.family in TESTED and not FAMILIES[e.family].beyond]


def with_blur(fit):
    """The fit with noise that follows the signal told against what the wanted power is expected to be: where the signal is faint
    the fit's own errors are most of it, and would be taken for the floor."""
    at = fit.model.index_of(Role.FOLLOWING, found=True)
    if at is None or not len(fit.model.vector()):
        return fit
    effect, view = fit.model.effects[at], view_of(fit)
    blur = _blur(fit)
    blur /= 1 + np.exp(effect.p[0]) * blur / np.mean(view.wanted_power[view.use])  # errors shrink with the floor that they raise
    near = replace(effect, aux={**effect.aux, "_blur": (blur, BLUR_DOUBT * blur)})
    fit = replace(fit, model=fit.model.replacing(at, near))
    model = fit.model.replacing(at, found_again(fit, near) or near)
    return solve(with_noise(fit, model), model)


def _blur(fit) -> float:
    """Power of the wanted signal's errors where it has none of its own, from draws of what the fit leaves open: errors of a gain
    or a phase follow the signal, those of an echo do not."""
    scene, vector, power = fit.data.scene, fit.model.vector(), np.abs(fit.chain.wanted) ** 2
    used = fit.data.use > 0
    values, vectors = np.linalg.eigh(fit.covariance)
    root, rng = vectors * np.sqrt(np.maximum(values, 0.0)), np.random.default_rng(0)
    with_signal = np.stack([np.ones(used.sum()), power[used]]).T
    faint = []
    for _ in range(DRAWS):
        error = root @ rng.standard_normal(len(vector))
        both = (np.abs(predict(scene, fit.model.at(vector + way * error)).wanted) ** 2 for way in (1, -1))
        faint.append(np.linalg.lstsq(with_signal, (sum(both) / 2 - power)[used], rcond=None)[0][0])
    return max(float(np.mean(faint)), 0.0)


def starts(fit, promised: float = 0.0):
    """[(net gain in nats, effect)] of every law of the noise that may be added, or take the place of one that is no cause; beside
    one that is, those that explain a good part of what it does. Where the signal has `promised` too much for what is left to be
    the noise's, none, unless it is louder for a while, or in a band: a law that is no cause holds that apart, and if it tells
    more than the signal all others may tell still more."""
    fit = of_noise(fit)
    families = [FAMILIES[e.family] for e in fit.model.effects]
    have, told = [f for f in families if f.told in LAWS], {f.told for f in families}
    if any(is_coarse(e) for e in fit.model.effects) or rounding_of_grids(fit) > ROUNDED * fit.sigma2:
        return []  # behind a coarse quantiser the noise has no law of its own, nor where a dither hides how coarse it is
    view = view_of(fit)
    others = [f for f in map(FAMILIES.get, TESTED) if not f.beyond and f.told not in told]
    if not view.use.any():  # rails that noise reaches everywhere leave a loud band what it is
        view, others = view_of(fit, inside=fit.data.use > 0), [f for f in others if f.fills_bands]
        return [s for f in others for s in _found(fit, view, f) if s[0] > BAND_OVER_SIGNAL * max(promised, CLEAR_NATS)]
    if any(not f.beyond for f in have):
        if promised > CLEAR_NATS:
            return []
        loudest = max((FAMILIES[e.family].find(view_of(fit, but=e), near=e)[0] for e in laws(fit.model)), default=0.0)
        return [s for f in others for s in _found(fit, view, f) if s[0] > BESIDE_NOISE * loudest]
    apart = [s for f in FAMILIES.values() if f.noise_like and f.beyond for s in _found(fit, view, f)]
    most = max((net for net, _ in apart), default=0.0)
    if promised > CLEAR_NATS and most < promised:  # but a band that is not the signal's own is no misfit of it
        return [s for f in others if f.fills_bands for s in _found(fit, view, f) if s[0] > BAND_OVER_SIGNAL * promised]
    rest = [s for f in others for s in _found(fit, view, f)]
    return [(net - most, effect) for net, effect in rest] if have else apart + rest


def along(fit):
    """A fit with what of its residual is along the wanted signal, and across it noise as the model has it, which has its place: a
    wander too fast to be followed is there, of any colour."""
    way = fit.chain.wanted / np.maximum(np.abs(fit.chain.wanted), 1e-300)
    kept = (fit.residual * np.conj(way)).real
    level = np.sqrt(np.mean(kept[fit.data.use > 0] ** 2))
    shape = 1.0 if fit.data.variance is None else np.sqrt(fit.data.variance)
    other = level * shape * np.random.default_rng(5).standard_normal(len(kept))
    return replace(fit, residual=(kept + 1j * other) * way, sigma2=float(2 * level**2), notes={})


def of_noise(fit):
    """A fit with what of its residual can only be noise."""
    return fit if fit.model.index_of(Role.WANDER, found=True) is None else along(fit)


def _found(fit, view, family) -> list[tuple[float, object]]:
    """[(net gain in nats over an even floor, effect)] of a law of the noise, or []."""
    gain, effect = family.find(view)
    if effect is None or _is_passband(fit, effect):
        return []
    if family.band(effect):
        gain = min(gain, family.find(_off_impulses(fit, view))[0])
    return [(gain - 0.5 * family.hidden(effect) * np.log(view.use.sum()) - np.log(effect.trials), effect)]


def _is_passband(fit, effect) -> bool:
    """Whether a band of noise is just the signal's: what a receiver's filter leaves of all noise, and no interference."""
    filled = FAMILIES[effect.family].band(effect)
    if filled is None:
        return False
    middle, width = filled
    signal = in_band(fit, len(fit.data.scene.occupied))
    f = np.arange(len(signal)) / len(signal)
    band = around_circle(f, middle) < width / 2
    return (band & signal).sum() > PASSBAND * (band | signal).sum()
