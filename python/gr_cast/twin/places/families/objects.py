# SPDX-License-Identifier: GPL-3.0-or-later
"""What may be wrong with an object of the mesh: that it is there, where it is, what it is made of, how rough it is."""

from dataclasses import replace
from functools import partial

import numpy as np

from ....core.units import db_from_amplitude
from ....scenario.create.media import ITU, Medium
from .base import SURVEYED_M, Effect, OfThings, std_of, value

_FAR_M = 3.0  # farthest move that is looked for
_NEAR_M, _STRIP_M, _PER_STRIP = 0.6, 0.1, 3  # within which wells are looked for strip by strip; of each
_ALONG_M = (-0.4, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.4)  # moves of an object along what is seen of it
_ALONG = 0.95  # of a shift that lies along a normal
_BEST = 3  # maxima of a scan that are fitted
_WELLS = 8  # of the phase, either way, that are tried beside one that was found
_LITTLE_M, _MOST_STEPS = 0.25, 150  # by which most that moved did; 16ths of a wave, either way, that are tried of these
_PERMITTIVITIES, _CONDUCTIVITIES = np.geomspace(1.15, 30, 14), (0.003, 0.05, 0.5)  # relative; S/m
_FRINGES, _DENSEST = 10, 6.0  # either way, of a slab that holds many waves; refractive index
_STRONGEST_FIRST = "metal", "glass", "concrete", "brick", "plasterboard", "wood"
_USUAL_HZ = (1e9, 1e11)  # for which all usual materials are known
_ROUGH = (1 / 60, 1 / 25, 1 / 12, 1 / 6)  # of a wavelength: first guesses of the roughness


class _OfObject(OfThings):
    level = "object"

    def owners(self, view):
        return view.seen_objects


class _OfMaterial(_OfObject):
    """Of an object, or of all that are made of the same."""

    def owners(self, view):
        return [*view.seen_objects, *view.shared_materials(view.seen_objects)]

    def kin(self, world, effect):
        material = world.media[world.mesh.names[world.made_of(effect.owner)[0]]].material
        has_name = material and material not in world.mesh.names
        alike = [world.mesh.names[one] for one in world.made_of(material)] if has_name else []
        names = [material, *alike] if len(alike) > 1 else []
        return [replace(effect, owner=name) for name in names if name != effect.owner]


class ExtraObject(_OfObject):
    name = "extra_object"

    def owners(self, view):
        return view.near_objects

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(0))]

    def apply(self, world, effect):
        return world.with_surface(world.mesh.index(effect.owner), present=False)

    def told(self, view, effect, covariance):
        return {}

    def sentence(self, effect, told):
        return f"{effect.owner} stands in the mesh and not in the world."


class ObjectMoved(_OfObject):
    name = "object_moved"
    is_wide = True
    order = 1
    price_nats = float(np.log(3))  # axes

    def is_negligible(self, effect):
        return abs(effect.values[0]) < SURVEYED_M

    def owners(self, view):
        return view.near_objects if view.has_responses else []  # what stands in the way may stand in another

    def starts(self, view, owner):
        def moved(shift_m, normal):
            return Effect(family=self, owner=owner, values=np.array([shift_m]), choice=tuple(normal))

        strip_m = max(_STRIP_M, view.world.wavelength_m / 2)
        middles_m = np.arange(-_NEAR_M, _NEAR_M + strip_m / 2, strip_m)
        out = []
        for normal in view.axes(owner):
            far_m, near_m = view.scan_object(owner, normal, view.moves_m(_FAR_M), best=_BEST), []
            if far_m:
                at_m = partial(moved, normal=normal)
                near_m = view.scan_strips(at_m, middles_m, strip_m, owner, normal, best=_PER_STRIP)
            # along what is seen of it, its ends meet other paths and few phases turn
            out += [moved(shift_m, normal) for shift_m in (0.0, *_ALONG_M, *far_m, *near_m)]
        return out

    def images_moved_m(self, effect):
        return 2 * effect.values[0] * np.array(effect.choice)

    def moving_images(self, view, shift_m):
        ways = [(owner, normal, float(shift_m @ normal)) for owner in view.near_objects for normal in view.axes(owner)]
        return [
            Effect(family=self, owner=owner, values=np.array([along_m / 2]), choice=tuple(normal))
            for owner, normal, along_m in ways
            if abs(along_m) > _ALONG * np.linalg.norm(shift_m)
        ]

    def restarts(self, world, effect):
        # The next wells of its phase, a quarter of a wave apart, and all about where the mesh has it: some are narrow, for what
        # is seen of it changes.
        quarter_m = world.wavelength_m / 4
        wells_m = [effect.values[0] + quarter_m * step for step in range(-_WELLS, _WELLS + 1) if step]
        steps = min(int(_LITTLE_M / quarter_m * 4), _MOST_STEPS)
        return [effect.moved(np.array([m])) for m in (*wells_m, *(quarter_m / 4 * np.arange(-steps, steps + 1)))]

    def apply(self, world, effect):
        return replace(world, mesh=world.mesh.moved(effect.owner, effect.values[0] * np.array(effect.choice)))

    def steps(self, world, effect):
        return np.array([world.wavelength_m * 1e-3])

    def bounded(self, values):
        return np.clip(values, -5, 5)

    def told(self, view, effect, covariance):
        normal = np.array(effect.choice)
        std = std_of(covariance, 0)
        return {
            "offset_m": value(effect.values[0] * normal, np.maximum(std * np.abs(normal), std * 1e-3)),
            "normal": value(normal),
        }

    def sentence(self, effect, told):
        return f"{effect.owner} stands {abs(effect.values[0]):.3g} m away from where the mesh has it."


class Material(_OfMaterial):
    name = "material"
    price_nats = float(np.log(3))

    def starts(self, view, owner):
        out = []
        for name in known_at(view.world.carrier_hz):
            if name != "metal":
                permittivity, conductivity = numbers_of(name, view.world.carrier_hz)
                out.append(Effect(family=self, owner=owner, values=np.log([permittivity, max(conductivity, 1e-6)])))
        for permittivity in _PERMITTIVITIES:
            for conductivity in _CONDUCTIVITIES:
                out.append(Effect(family=self, owner=owner, values=np.log([permittivity, conductivity])))
        return [*out, Effect(family=self, owner=owner, values=np.log([1.0, 1e7]))]

    def restarts(self, world, effect):
        thickness_m = world.surface.thickness_m[world.made_of(effect.owner)].min()
        return [effect.moved(np.array(one)) for one in fringes(*effect.values, world, thickness_m)]

    def apply(self, world, effect):
        permittivity, conductivity = np.exp(effect.values)
        return world.with_surface(world.made_of(effect.owner), permittivity=permittivity, conductivity=conductivity)

    def steps(self, world, effect):
        return np.array([1e-5, 1e-4])

    def bounded(self, values):
        return np.array([np.clip(values[0], 0, np.log(100)), np.clip(values[1], np.log(1e-7), np.log(1e7))])

    def told(self, view, effect, covariance):
        permittivity, conductivity = np.exp(effect.values)
        return {
            "permittivity": value(permittivity, permittivity * std_of(covariance, 0)),
            "conductivity": value(conductivity, conductivity * min(std_of(covariance, 1), 10.0)),
            "reflection_error_db": value(*view.reflection_error_db(effect, view.world.made_of(effect.owner), covariance)),
            "nearest": nearest(permittivity, conductivity, view.world.carrier_hz),
        }

    def sentence(self, effect, told):
        error_db, rather = told["reflection_error_db"]["value"], told["nearest"].replace("_", " ")
        return f"{effect.owner} reflects {error_db:+.1f} dB against its material in the twin: rather like {rather}."


def fringes(log_permittivity: float, log_conductivity: float, world, thickness_m: float) -> list[tuple[float, float]]:
    """Logarithms of other permittivities, with several losses, of which a slab reflects alike: it has half a wave more or less in
    it, in the next wells of its refractive index."""
    half_wave = world.wavelength_m / (2 * thickness_m)
    index = np.exp(log_permittivity / 2) + half_wave * np.arange(-_FRINGES, _FRINGES + 1)
    losses = log_conductivity, *np.log(_CONDUCTIVITIES)
    return [(2 * np.log(one), loss) for one in index if 1 < one < _DENSEST for loss in losses]


def nearest(permittivity: float, conductivity: float, carrier_hz: float) -> str:
    """The ITU material whose reflection at normal incidence and at 60° is nearest."""
    angle = np.array([1.0, 0.5])

    def seen(e, s):
        eta = e - 1j * s * 17.975e9 / carrier_hz
        root = np.sqrt(eta - (1 - angle**2))
        return np.concatenate(
            [db_from_amplitude((angle - root) / (angle + root)), [np.log(e), 0.3 * np.log(s / carrier_hz * 1e10 + 1)]]
        )

    own = seen(permittivity, conductivity)
    return min(known_at(carrier_hz), key=lambda name: float(np.abs(seen(*numbers_of(name, carrier_hz)) - own).sum()))


def known_at(carrier_hz: float) -> list[str]:
    """ITU materials whose data reach the carrier."""
    return [name for name in ITU if not Medium(material=name).out_of_band(carrier_hz)]


def numbers_of(name: str, carrier_hz: float) -> tuple[float, float]:
    """Relative permittivity and conductivity (S/m) of an ITU material."""
    medium = Medium(material=name)
    return medium.permittivity(carrier_hz), medium.conductivity(carrier_hz)


def usual_at(carrier_hz: float) -> tuple[tuple[float, float], ...]:
    """Relative permittivity and conductivity (S/m) of what objects are made of more often than not: metal, stone, board, the
    faintest last."""
    return tuple(numbers_of(name, _usual_hz(carrier_hz)) for name in ("metal", "concrete", "wood"))


def made_at(carrier_hz: float) -> tuple[tuple[float, float], ...]:
    """The same of materials from the strongest reflection to the faintest."""
    known = known_at(_usual_hz(carrier_hz))
    return tuple(numbers_of(name, _usual_hz(carrier_hz)) for name in _STRONGEST_FIRST if name in known)


def _usual_hz(carrier_hz: float) -> float:
    """The carrier, or the nearest to it for which usual materials are known."""
    return float(np.clip(carrier_hz, *_USUAL_HZ))


class Roughness(_OfMaterial):
    name = "roughness"

    def owners(self, view):
        return super().owners(view) if view.has_responses else []

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.log([part * view.world.wavelength_m])) for part in _ROUGH]

    def apply(self, world, effect):
        which = world.made_of(effect.owner)
        return world.with_surface(which, height_rms_m=float(np.exp(effect.values[0])))

    def steps(self, world, effect):
        return np.array([1e-4])

    def bounded(self, values):
        return np.clip(values, np.log(1e-6), np.log(0.5))

    def told(self, view, effect, covariance):
        height = float(np.exp(effect.values[0]))
        return {"height_rms_m": value(height, height * std_of(covariance, 0))}

    def sentence(self, effect, told):
        return f"{effect.owner} is rough: {1e3 * np.exp(effect.values[0]):.2g} mm rms weaken its mirror images."
