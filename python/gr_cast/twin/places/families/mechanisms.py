# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tracer had switched off, or was told wrongly of the whole place."""

from dataclasses import replace

import numpy as np

from ....core.units import SPEED_OF_LIGHT_M_PER_S
from ....scenario.create import fields
from ....scenario.create.geometry import Solid
from ....scenario.create.media import Medium
from .base import Effect, Family, OfThings, std_of, value

_WIDE_M = 3000.0  # of a ground
_GROUND_CONDUCTIVITY = 0.01  # S/m, where it cannot be told
_SHARPENED = 40  # wells whose bottoms are compared
_HEIGHTS = 14  # other heights about one that was found, either way
_ASKED = 12  # objects that are asked whether they scatter
_OCTAVES, _CARRIERS = 1.3, 200  # that a carrier may be off, up or down; wells that are tried within
_BEST = 3
_BEAT_M, _WELLS = 40.0, 30  # between paths: whose beats are tried about a carrier that was found, so many either way
_SCATTERED = [step / 20 for step in range(2, 16)]  # that surfaces may: walls were measured at 0.2 to 0.6 (Degli-Esposti et al.
# 2007); more would be a way to take reflections away


class MissingReflections(Family):
    name = "missing_reflections"
    order = 3

    def owners(self, view):
        return ["place"] if view.world.max_depth < 4 else []

    def starts(self, view, owner):
        depth = view.world.max_depth
        return [
            Effect(family=self, owner=owner, values=np.zeros(0), choice=order) for order in (depth + 1, depth + 2) if order <= 3
        ]

    def apply(self, world, effect):
        return replace(world, max_depth=effect.choice)

    def told(self, view, effect, covariance):
        return {"order": value(effect.choice)}

    def sentence(self, effect, told):
        return f"Paths over {effect.choice} faces are in the world; the twin's tracer stops before."


class MissingTransmission(OfThings):
    name = "missing_transmission"
    order = 3

    def owners(self, view):
        return [] if view.world.is_clear else ["place", *view.blocking_objects]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(0))]

    def apply(self, world, effect):
        return world.with_surface(world.made_of(effect.owner), clear=True)

    def told(self, view, effect, covariance):
        return {"loss_db": value(view.transmission_loss_db(effect), 1.0)}

    def sentence(self, effect, told):
        through = "objects" if effect.owner == "place" else effect.owner
        return f"Legs go through {through}; in the twin they are blocked."


class MissingDiffraction(Family):
    name = "missing_diffraction"
    order = 3

    def owners(self, view):
        return [] if view.world.diffraction else ["place"]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(0))]

    def apply(self, world, effect):
        return replace(world, diffraction=True)

    def told(self, view, effect, covariance):
        return {"gain_db": value(view.diffraction_gain_db(effect), 2.0)}

    def sentence(self, effect, told):
        return "Rays bend round edges; the twin's tracer leaves diffraction out."


class MissingScattering(OfThings):
    name = "missing_scattering"
    is_flexible = True
    order = 6
    price_nats = 25.0  # of its coefficient, which is named, and of a law that is near to what patches do, not what they do

    def owners(self, view):
        if not view.has_responses or (view.world.surface.scattering > 0).any():
            return []
        return ["place", *view.shared_materials(view.scatterers), *view.scatterers[:_ASKED]]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(0), choice=share) for share in _SCATTERED[1::2]]

    def choices(self, world, effect):
        return [replace(effect, choice=share) for share in _SCATTERED if share != effect.choice]

    def apply(self, world, effect):
        return world.with_surface(world.made_of(effect.owner), scattering=effect.choice)

    def told(self, view, effect, covariance):
        return {"scattering_coefficient": value(effect.choice, 0.05)}

    def sentence(self, effect, told):
        of = "Surfaces scatter" if effect.owner == "place" else f"{effect.owner} scatters"
        return f"{of} a share of {effect.choice:.2f} of what they reflect; the twin's tracer leaves scattering out."


class Carrier(Family):
    name = "carrier"
    order = 1

    def owners(self, view):
        return ["place"] if view.has_responses else []

    def starts(self, view, owner):
        def sounded(hz):
            return Effect(family=self, owner=owner, values=np.array([np.log(hz)]))

        # What else is missing spoils the wells: the deepest is seldom the scan's first. The best by either measure is begun from.
        near = view.ranked([sounded(hz) for hz in view.scan_carrier(_OCTAVES, best=_CARRIERS)])[:_SHARPENED]
        return [sounded(view.world.carrier_hz), *view.sharpened(near)[:2]]

    def restarts(self, world, effect):
        # Paths beat against each other every few megahertz: the next wells.
        here_hz, step_hz = float(np.exp(effect.values[0])), SPEED_OF_LIGHT_M_PER_S / _BEAT_M
        near = [here_hz + step * step_hz for step in range(-_WELLS, _WELLS + 1) if step]
        return [effect.moved(np.log([hz])) for hz in near if hz > 0]

    def apply(self, world, effect):
        carrier_hz = float(np.exp(effect.values[0]))
        own = [world.media[name] for name in world.mesh.names]
        at = fields.surface_of(own, carrier_hz)
        surface = replace(world.surface, permittivity=at.permittivity, conductivity=at.conductivity)
        return replace(world, carrier_hz=carrier_hz, surface=surface)

    def steps(self, world, effect):
        return np.array([1e-6])

    def bounded(self, values):
        return np.clip(values, np.log(1e8), np.log(1e11))

    def told(self, view, effect, covariance):
        carrier_hz = float(np.exp(effect.values[0]))
        return {"carrier_hz": value(carrier_hz, carrier_hz * std_of(covariance, 0))}

    def sentence(self, effect, told):
        return f"The place was sounded at {np.exp(effect.values[0]) / 1e9:.4g} GHz, another carrier than the twin was traced at."


class Ground(Family):
    name = "ground"
    is_like_wide = True  # a level object
    shows_in_power = True
    is_in_spec = False
    order = 1
    price_nats = float(np.log(3))

    def owners(self, view):
        return ["place"] if view.lacks_ground else []

    def starts(self, view, owner):
        def ground(height_m, permittivity):
            return Effect(family=self, owner=owner, values=np.array([height_m, np.log(permittivity)]))

        guesses = [ground(*guess) for guess in view.scan_ground()]
        if not view.has_responses:
            return self._one_of_each_well(view, guesses)
        return view.sharpened(self._one_of_each_well(view, view.ranked(guesses)))[:_BEST]

    def _one_of_each_well(self, view, begun: list[Effect]) -> list[Effect]:
        out: list[Effect] = []
        for one in begun:
            if all(abs(one.values[0] - other.values[0]) > view.world.wavelength_m / 4 for other in out):
                out.append(one)
        return out[:_SHARPENED]

    def restarts(self, world, effect):
        # The next wells of its phase.
        steps_m = world.wavelength_m / 8 * np.arange(-_HEIGHTS, _HEIGHTS + 1)
        return [effect.moved(effect.values + [step_m, 0.0]) for step_m in steps_m if step_m]

    def apply(self, world, effect):
        height_m, permittivity = effect.values[0], float(np.exp(effect.values[1]))
        corners = [[x, y, height_m] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] * np.array([_WIDE_M, _WIDE_M, 1.0])
        solid = Solid(name="ground", vertices_m=corners, faces=[[0, 1, 2], [0, 2, 3]])
        medium = Medium(own_permittivity=permittivity, own_conductivity_s_per_m=_GROUND_CONDUCTIVITY)
        made = world.with_object(solid, permittivity=permittivity, conductivity=_GROUND_CONDUCTIVITY, thickness_m=np.inf)
        return replace(made, media={**world.media, "ground": medium})

    def steps(self, world, effect):
        return np.array([world.wavelength_m * 1e-3, 1e-4])

    def bounded(self, values):
        return np.clip(values, [-100.0, np.log(1.2)], [100.0, np.log(80.0)])

    def told(self, view, effect, covariance):
        permittivity = float(np.exp(effect.values[1]))
        return {
            "height_m": value(effect.values[0], std_of(covariance, 0)),
            "permittivity": value(permittivity, permittivity * std_of(covariance, 1)),
            "point_m": value([*view.centre_m[:2], effect.values[0]], [std_of(covariance, 0)] * 3),
            "normal": value([0.0, 0.0, 1.0]),
        }

    def sentence(self, effect, told):
        return f"A ground at {effect.values[0]:.2f} m that the mesh leaves out, of permittivity {np.exp(effect.values[1]):.1f}."


class ExcessLoss(Family):
    """Of one link."""

    name = "excess_loss"
    shows_in_power = True
    is_in_spec = False
    level = "link"

    def owners(self, view):
        return [f"{a}>{b}" for a, b in view.links]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(1))]

    def apply(self, world, effect):
        link = tuple(effect.owner.split(">"))
        return replace(world, link_loss_db={**world.link_loss_db, link: world.link_loss_db.get(link, 0.0) + effect.values[0]})

    def bounded(self, values):
        return np.clip(values, -60, 90)

    def told(self, view, effect, covariance):
        return {"loss_db": value(effect.values[0], std_of(covariance, 0))}

    def sentence(self, effect, told):
        loss_db = effect.values[0]
        return f"{effect.owner} loses {abs(loss_db):.2f} dB {'more' if loss_db > 0 else 'less'} than in the twin."


class DistanceLaw(Family):
    """Of the whole place: loss goes with another power of the distance, from end to end or along each path."""

    name = "excess_loss"
    shows_in_power = True
    is_in_spec = False
    price_nats = float(np.log(2))

    def owners(self, view):
        return ["place"]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.array([2.0]), choice=of) for of in ("link", "path")]

    def apply(self, world, effect):
        return replace(world, exponent=float(effect.values[0]), exponent_of=effect.choice)

    def bounded(self, values):
        return np.clip(values, 0.5, 8)

    def told(self, view, effect, covariance):
        return {"exponent": value(effect.values[0], std_of(covariance, 0)), "distance": effect.choice}

    def sentence(self, effect, told):
        return f"Power falls with the {effect.values[0]:.2f}th power of the distance, in the twin with the second."


class Attenuation(Family):
    """Of the whole place: what lies along the way, leaves or rain, takes its part of every metre."""

    name = "excess_loss"
    shows_in_power = True
    is_in_spec = False

    def owners(self, view):
        return ["place"]

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(1))]

    def apply(self, world, effect):
        return replace(world, loss_db_per_m=float(effect.values[0]))

    def bounded(self, values):
        return np.clip(values, 0, 20)  # nothing on the way gives power

    def told(self, view, effect, covariance):
        return {"db_per_m": value(effect.values[0], std_of(covariance, 0))}

    def sentence(self, effect, told):
        return f"Every metre of the way takes {effect.values[0]:.3g} dB more than in the twin."
