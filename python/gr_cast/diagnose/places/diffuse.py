# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering leaves a residual that is noise with a delay profile: circular Gaussian, frequencies correlated as the profile's
transform says. What is resolved to few bins of delay is few numbers, however many bins it leaks to."""

import functools
from collections.abc import Iterator
from functools import partial

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields, patches
from . import likelihood

_FINER = 8  # delays per bin of the band
_COSINES = np.linspace(0, 1, 25)  # of incidence, between which reflections are interpolated
_COARSE_M = 0.1  # of positions: patches are half a metre wide
_INSTANTS = 6  # of a moving link at which its profile is computed
_FAINT = 1e-10  # of the strongest mode: less is none
_HEARD, _FEW = 3.0, 12  # times the noise: modes that tell what fills them; fewer of these tell nothing
_MODES_KEPT = 1024  # of 150 kB at most each
_PHASED_NATS = 4.0  # of a snapshot's prediction: less tells no phase
_SPREADS = np.geomspace(1e-3, 1, 25)  # of gains that wander
_LARGEST = 2.0**15  # of a half-precision number, to its smallest: 90 dB


def gain(ear, fit, world) -> tuple[float, float, float]:
    """(nats, energy, count): what the profile that `world` scatters is worth against white noise on this fit's residual, how much
    less energy the residual has when it is whitened by it, and how many numbers are scattered rather than noise. Static links
    count once: patches keep their phases."""
    nats = saved = scattered = 0.0
    cost = _turns_nats(ear, fit, world)
    for index, noise, power, strength in _along_modes(ear, fit, world):
        share = strength / (noise + strength)
        explained = (power * share).sum() / noise
        more = float(explained - len(power) * np.log1p(strength / noise).sum())
        nats += more - min(cost.get(index, 0.0), max(more, 0.0))  # turned or not, it is no likelier without the field
        saved += float(explained)
        scattered += float(len(power) * share.sum())
    return nats, saved, scattered


def _along_modes(ear, fit, world):
    """Of each link and each step of its way: its number, the noise, what the residual has (instants, modes) along the modes of
    the field that `world` scatters, and the power of each mode."""
    if not _scatters(ear, world):
        return
    unit = _unit(ear, fit, world)
    for index, noise, fields_, is_still in _fields(ear, fit, world):
        rows = np.where(ear.heard.known[index], fit.residual[index] * unit[index].conj(), 0)
        if is_still:  # all instants say the same
            rows = rows.sum(axis=0, keepdims=True) / np.sqrt(max(len(rows), 1))
        for which, strength, modes in fields_:
            yield index, noise, np.abs(rows[which] @ modes.conj()) ** 2, strength


def unevenness(ears, fits, world) -> float:
    """By how many standard deviations what modes have over what they should have is spread more than a random field's, which is
    exponential: its logarithm has the variance π²/6 and the kurtosis 5.4. What is none fills a few modes, and others not."""
    over = [np.zeros(0)]
    for ear, fit in zip(ears, fits, strict=True):
        for _, noise, power, strength in _along_modes(ear, fit, world):
            over.append((power / (noise + strength))[:, strength > _HEARD * noise].ravel())
    logs = np.log(np.maximum(np.concatenate(over), 1e-12))
    if len(logs) < _FEW:
        return 0.0
    return float((logs.var() / (np.pi**2 / 6) - 1) * np.sqrt(len(logs) / 4.4))


def wander_nats(ear, fit) -> float:
    """Nats by which gains that wander from one response to the next explain what a fit leaves, as Gaussian factors with the
    spread that explains most: what is scattered comes by other ways, and later. Each costs what a mode of a field does, though of
    a response whose phase is unknown only its size tells: where a band resolves no delays both are the same."""
    weight = ear.heard.weight
    loud = (np.abs(fit.model) ** 2 * weight).sum(axis=2)
    along = (fit.model.conj() * fit.residual * weight).sum(axis=2)[loud > 0]
    loud = loud[loud > 0]
    heard = (along.real**2 if ear.heard.phase == "snapshot" else np.abs(along) ** 2) / loud
    over = loud * _SPREADS[:, None] ** 2
    return max(0.0, float((heard * over / (1 + over) - np.log1p(over)).sum(axis=1).max()))


def whitened(ear, fit, world, rows: np.ndarray) -> np.ndarray:
    """Rows (n, numbers of the residual) of a linear problem, over what noise and scattered field together may be: where the world
    scatters, what lies along a mode of the field says less."""
    if not _scatters(ear, world):
        return rows
    half = rows.shape[1] // 2
    unit = _unit(ear, fit, world)
    turned = (rows[:, :half] + 1j * rows[:, half:]).reshape(len(rows), *fit.residual.shape) * unit.conj()
    for index, noise, fields_, is_still in _fields(ear, fit, world):
        for which, strength, modes in fields_:
            part = turned[:, index].mean(axis=1, keepdims=True) if is_still else turned[:, index, which]
            less = ((part @ modes.conj()) * (1 - np.sqrt(noise / (noise + strength)))) @ modes.T
            turned[:, index, slice(None) if is_still else which] -= less
    flat = turned.reshape(len(rows), -1)
    return np.concatenate([flat.real, flat.imag], axis=1)


def left(ear, fit, world) -> np.ndarray:
    """(L,) energy of each link over what noise and scattered field together may be."""
    if not _scatters(ear, world):
        return ear.left(fit)
    row = whitened(ear, fit, world, ear.rows(fit)[None])
    return (row.reshape(2, len(ear.heard.links), -1) ** 2).sum(axis=(0, 2))


def _heard_of(ear, world):
    """The world whose scattered field an ear hears."""
    return ear.field_of or world


def _scatters(ear, world) -> bool:
    return bool(ear.has_responses and _heard_of(ear, world).surface.scatters)


def _unphased(ear, fit, world) -> list[int]:
    """Links without movement of which the twin predicts too little to tell the phases of their snapshots, where these are
    unknown."""
    if ear.heard.phase != "snapshot":
        return []
    many = np.maximum((ear.heard.weight > 0).any(axis=2).sum(axis=1), 1)
    told = (np.abs(fit.model) ** 2 * ear.heard.weight).sum(axis=(1, 2)) / many
    moves = [any(world.radios[name].node.is_moving for name in link) for link in ear.predictor.links]
    return [index for index, (nats, moving) in enumerate(zip(told, moves, strict=True)) if nats < _PHASED_NATS and not moving]


def _unit(ear, fit, world) -> np.ndarray:
    """(L, T, K) phases of snapshots: of what the twin predicts or, where that tells none, those in which they are most alike,
    and as late as suits what is scattered, where delays are unknown."""
    unit = fit.factor / np.maximum(np.abs(fit.factor), 1e-300)
    count = len(ear.heard.frequency_hz)
    for index in _unphased(ear, fit, world):
        strength, field = _alike(ear, fit, index)
        size = np.abs(strength)[:, None]
        unit[index] = np.where(size > 0, strength[:, None] / np.maximum(size, 1e-300), 1)
        if ear.heard.delay != "none":
            profile = profiles(_heard_of(ear, world), ear.predictor, index, count, ear.heard.spacing_hz)[0].sum(axis=0)
            heard = np.abs(np.fft.ifft(field, count * _FINER)) ** 2
            late = int(np.argmax(np.fft.ifft(np.fft.fft(heard) * np.fft.fft(profile).conj()).real))
            unit[index] = unit[index] * np.exp(-2j * np.pi * late / (count * _FINER) * np.arange(count))
    return unit


def _turns_nats(ear, fit, world) -> dict[int, float]:
    """What the phases took in which a link's snapshots are most alike: −ln p is of the mean over all that they may be. All but
    one: a random field has a phase of its own."""
    if not _scatters(ear, world):
        return {}
    out = {}
    for index in _unphased(ear, fit, world):
        weight = ear.heard.weight[index]
        many = int((weight > 0).any(axis=1).sum())
        size = np.abs(_alike(ear, fit, index)[0])
        if many > 1:
            cross = size * size.sum() / many * weight[weight > 0].mean()
            out[index] = likelihood.turns_nats(cross) * (many - 1) / many
    return out


def _alike(ear, fit, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Strengths (T,) of the field (K,), of unit energy, that a link's snapshots have most in common."""
    rows = np.where(ear.heard.weight[index] > 0, fit.residual[index], 0)
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    return left[:, 0] * size[0], right[0]


def _fields(ear, fit, world) -> Iterator[tuple[int, float, list[tuple], bool]]:
    """Of each link that is heard: its number, noise, modes of what is scattered to it as (instants, power of each mode, modes
    (K, modes)), and whether patches keep their phases: then it is of the sum of all instants over the root of their number."""
    heard, made_of = ear.heard, _heard_of(ear, world)
    law = made_of.mesh.coarse.key, made_of.surface.key, made_of.is_clear, made_of.carrier_hz
    loud = (np.abs(fit.factor) ** 2).mean(axis=(1, 2)) * heard.share
    for index in np.flatnonzero(heard.share):
        key = "shapes", ear.predictor.ends_key(made_of, index), law
        is_still, shapes = ear.predictor.remembered(key, partial(_shapes, made_of, ear.predictor, index, heard))
        scale = loud[index] * (heard.y.shape[1] if is_still else 1)
        told = [(which, scale * most, *_modes(rounded, len(heard.frequency_hz))) for which, most, rounded in shapes]
        yield index, heard.noise[index], [(which, most * strength, modes) for which, most, strength, modes in told], is_still


def _shapes(world, predictor, index: int, heard: likelihood.Heard) -> tuple[bool, list[tuple]]:
    """Whether nothing moves; of each step of a link's way to which anything is scattered its instants, the strongest cell and all
    over that, rounded."""
    power, step = profiles(world, predictor, index, len(heard.frequency_hz), heard.spacing_hz)
    loud = [(number, row, row.max()) for number, row in enumerate(power) if row.any()]
    return len(step) == 1, [(np.flatnonzero(step == number), most, _rounded(row / most)) for number, row, most in loud]


def _rounded(row: np.ndarray) -> bytes:
    """A profile to three digits: what changes it by less shares its modes."""
    return (row * _LARGEST).astype(np.float16).tobytes()


@functools.lru_cache(maxsize=_MODES_KEPT)
def _modes(rounded: bytes, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Powers, and modes (count, modes) along frequency, of a random field with a delay profile of `_FINER` cells per bin: the
    eigenvectors of its covariance."""
    power = np.frombuffer(rounded, np.float16).astype(float) / _LARGEST
    cells = np.flatnonzero(power)
    steer = np.exp(-2j * np.pi * np.outer(np.arange(count), cells) / (count * _FINER)) * np.sqrt(power[cells])
    if len(cells) < count:
        strength, inner = np.linalg.eigh(steer.conj().T @ steer)
        modes = steer @ (inner / np.sqrt(np.maximum(strength, _FAINT * strength[-1])))
    else:
        strength, modes = np.linalg.eigh(steer @ steer.conj().T)
    keep = strength > _FAINT * strength[-1]
    return strength[keep], modes[:, keep]


def profiles(world, predictor, index: int, count: int, spacing_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Scattered power (steps, cells) of a link by delay, of unit transmitted power, `_FINER` cells per bin; and the step of each
    instant, one where nothing moves."""
    kept = predictor.remembered(("reflected", world.carrier_hz, world.surface.key), lambda: _kept(world))
    steps, number = _steps(world, predictor, index, count, spacing_hz)
    power = [np.bincount(place, kept[cell] * mirrored, minlength=count * _FINER) for cell, place, mirrored in steps]
    return np.array(power), number


def scatterers(ears, fits, world) -> np.ndarray:
    """(O,) nats of what would be heard of each object if it scattered all that it reflects."""
    rough = world.with_surface(np.arange(len(world.mesh.names)), scattering=1.0)
    kept, nats = _kept(rough), np.zeros(len(world.mesh.names))
    for ear, fit in zip(ears, fits, strict=True):
        for index, weight in enumerate(ear.heard.weight if ear.has_responses else ()):
            steps, _ = _steps(rough, ear.predictor, index, len(ear.heard.frequency_hz), ear.heard.spacing_hz)
            loud = (np.abs(fit.factor[index]) ** 2 * weight).sum() / len(steps)
            for cell, _, mirrored in steps:
                nats += loud * np.bincount(cell // len(_COSINES), kept[cell] * mirrored, minlength=len(nats))
    return nats


def _steps(world, predictor, index: int, count: int, spacing_hz: float) -> tuple[list, np.ndarray]:
    """Of each step of a link's way, powers of perfect mirrors (see `_mirrors`); and the step of each instant."""
    tx_m, rx_m = predictor.ends_m(world, index)
    tx, rx = (world.radios[name] for name in predictor.links[index])
    static = not (tx.node.is_moving or rx.node.is_moving)
    every = max(1, -(-len(tx_m) // _INSTANTS))
    number = np.zeros(1, int) if static else np.arange(len(tx_m)) // every
    made = world.mesh.coarse.key, world.surface.standing
    tx_m, rx_m = (np.round(end_m / _COARSE_M) * _COARSE_M for end_m in (tx_m, rx_m))
    out = []
    for step in np.unique(number) * every:
        key = made, tx_m[step].tobytes(), rx_m[step].tobytes()
        lit = predictor.remembered(("lit", key), partial(_lit, world, tx_m[step], rx_m[step]))
        key = "mirrors", key, tx.antenna, rx.antenna
        out.append(predictor.remembered(key, partial(_mirrors, lit, tx.antenna, rx.antenna, count, spacing_hz)))
    return out, number


def _kept(world) -> np.ndarray:
    """Share of the power that objects scatter at each of the cosines: (λ/4π)²·S² of what they reflect."""
    owner, cosine = (grid.ravel() for grid in np.meshgrid(np.arange(len(world.mesh.solids)), _COSINES, indexing="ij"))
    share = (world.wavelength_m / (4 * np.pi)) ** 2 * world.surface.scattering[owner] ** 2
    return share * patches.reflected(world.surface, world.carrier_hz, owner, cosine)


def _lit(world, tx_m, rx_m) -> patches.Seen:
    mesh = world.mesh.coarse
    return patches.seen(mesh.patches, mesh.thick if world.is_clear else mesh.thin, world.surface, tx_m, rx_m)


def _mirrors(lit: patches.Seen, tx, rx, count: int, spacing_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where there is any, power of perfect mirrors between two antennas: number of object and cosine, delay bin, power."""
    antennas = (fields.far_field(tx, lit.first) ** 2).sum(axis=1) * (fields.far_field(rx, -lit.second) ** 2).sum(axis=1)
    many = count * _FINER
    place = np.round(lit.length_m / SPEED_OF_LIGHT_M_PER_S * many * spacing_hz).astype(int) % many
    at = lit.cos_in * (len(_COSINES) - 1)
    low = np.minimum(at.astype(int), len(_COSINES) - 2)
    cells = [(lit.owner * len(_COSINES) + low + more) * many + place for more in (0, 1)]
    shares = [lit.power * antennas * (1 - (at - low)), lit.power * antennas * (at - low)]
    total = np.bincount(np.concatenate(cells), np.concatenate(shares))
    used = np.flatnonzero(total)
    return used // many, used % many, total[used]
