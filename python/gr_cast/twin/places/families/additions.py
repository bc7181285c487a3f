# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in the world and not in the mesh: a plane that reflects and shades, something that passes by."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from ....scenario.create.geometry import Solid
from ....scenario.create.media import Medium
from ..passer import CENTRE, HEIGHT_M
from ..world import SLAB_M, Person
from .base import Effect, Family, std_of, value
from .objects import fringes, usual_at

_BOARD = (2.5, 0.03)  # a weak echo in phase explains some of a strong one, and not the other way round
_MADE = ((1.0, 1e7), (6.0, 0.05), _BOARD)  # permittivity and conductivity (S/m) to begin with: metal, stone, board
_DARK = (1.0, 1e-5)  # what shades and sends nothing back
_PERMITTIVITIES = (1.5, 2.0, 2.7, 3.4, 4.2, 5.2, 6.3, 7.5, 10.0, 15.0)  # to begin anew with, once the plane is where it is
_BODY_M = 1.0  # between faces of one thing, or between a face and a way that it blocks
_BEYOND_LIT_M, _LESS_BEYOND_M = 4.0, (2.8, 2.0, 1.4, 1.0, 0.7, 0.5, 0.25, 0.05)  # that a wall goes on beyond what was lit of it
_ADDED = "missing_"  # begins the names of objects that are added
_FLAT_M = 1e-3  # of a box: less is no depth
_FAR_M = 3.0  # that a plane may move from where it was imaged
_QUAD = [[0, 1, 2], [0, 2, 3]]
_BOX = [
    *_QUAD,
    [4, 6, 5],
    [4, 7, 6],
    *(part for i in range(4) for part in ([i, i + 4, (i + 1) % 4], [(i + 1) % 4, i + 4, (i + 1) % 4 + 4])),
]
_DEPTHS_M = np.array([0.3, 0.6, 1.2, 2.4, 4.8])
_SIDE_M, _MOST_FINE = 0.6, 40  # within which a side that reflects is looked for, and in how many steps either way
_TOPS_M = (-0.1, -0.03, 0.03, 0.1)  # by which a box may be higher in another well of its phase
_STEPS_M, _LEAST_M = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0), 0.05
_TURNS_RAD = np.radians([-45, -25, -12, -5, 5, 12, 25, 45, 90])
_COARSE, _BETWEEN = 10, 9  # steps to a wavelength in which a plane is looked for, in how many then
_FINE = 8  # steps to a wavelength in which a box's side is
_BESIDE = 32  # steps to a wavelength, of which a box may be half a one beside itself where nothing lights its sides
_LONE = 3  # planes that are looked at which one link alone sees
_ENDED, _WALLS = 3, 3  # planes whose ends are looked for: where echoes have them, where other things end
_WELLS, _BOX_WELLS = 3, 6  # of the phase of an echo, either way
_FAINT_M2 = 0.05  # of an echo that is not known
_AREAS_M2 = (1.0, 8.0)  # of one of whom is known how late echoes are and no more
_GOES = (2, 3)  # the places of a passer's velocity among his numbers
_STANDS = 3  # places of his way where he may as well have stood still
_WIDER = 1.03 ** np.concatenate([np.arange(-12, 0), np.arange(1, 13)])  # than the radius that was found
_AGAIN = (1 / 1.25, 1.0, 1.25)  # times the radius that was found, with which a way is looked for again
_RADII_M = (0.4, 0.2, 0.9)  # of a person or a vehicle: how wide a shadow is


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A rectangle: `origin_m` on the plane, `normal`, and along unit `u` and `v` from low to high (m). With `depth_m`, along the
    normal, the face of a box. It is made of slabs of some thickness."""

    origin_m: tuple[float, float, float]
    normal: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    depth_m: float = 0.0
    thickness_m: float = SLAB_M

    @classmethod
    def about(cls, points_m: np.ndarray, normal: np.ndarray, thickness_m: float = SLAB_M) -> "Sheet":
        """The smallest rectangle with a normal, or box behind it, that holds some points (n, 3)."""
        u, v = across(normal)
        frame = np.stack([normal, u, v], axis=1)
        low, high = np.min(points_m @ frame, axis=0), np.max(points_m @ frame, axis=0)
        middle_m, half_m, deep_m = frame @ np.append(low[0], (low + high)[1:] / 2), (high - low)[1:] / 2, high[0] - low[0]
        return cls(
            origin_m=tuple(middle_m), normal=tuple(normal), u=tuple(u), v=tuple(v), low_m=tuple(-half_m), high_m=tuple(half_m),
            depth_m=float(deep_m) if deep_m > _FLAT_M else 0.0, thickness_m=thickness_m,
        )  # fmt: skip

    def frame(self, shift_m: float = 0.0, turn_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Origin (m), u and v, shifted along the normal and turned about v."""
        normal, u = np.array(self.normal), np.array(self.u)
        turned = np.cos(turn_rad) * u + np.sin(turn_rad) * normal
        return np.array(self.origin_m) + shift_m * normal, turned, np.array(self.v)

    def corners_m(self, shift_m: float = 0.0, turn_rad: float = 0.0) -> np.ndarray:
        """(4, 3), shifted along the normal and turned about v."""
        origin, u, v = self.frame(shift_m, turn_rad)
        (u0, v0), (u1, v1) = self.low_m, self.high_m
        return origin + np.array([[u0], [u1], [u1], [u0]]) * u + np.array([[v0], [v0], [v1], [v1]]) * v

    def through(self, low_m: np.ndarray, high_m: np.ndarray) -> "Sheet":
        """As far as a box between two corners goes, and no less far than it went."""
        corners_m = np.array(list(itertools.product(*np.array([low_m, high_m]).T))) - self.origin_m
        at_m = np.concatenate([corners_m @ np.array([self.u, self.v]).T, [self.low_m, self.high_m]])
        return replace(self, low_m=tuple(at_m.min(axis=0)), high_m=tuple(at_m.max(axis=0)))

    def normal_at(self, turn_rad: float) -> np.ndarray:
        return np.cos(turn_rad) * np.array(self.normal) - np.sin(turn_rad) * np.array(self.u)

    def solid(self, name: str, shift_m: float, turn_rad: float) -> Solid:
        near_m = self.corners_m(shift_m, turn_rad)
        if not self.depth_m:
            return Solid(name=name, vertices_m=near_m, faces=_QUAD)
        return Solid(name=name, vertices_m=np.concatenate([near_m, near_m + self.depth_m * self.normal_at(turn_rad)]), faces=_BOX)

    def reshaped(self, axis: int, fine_m: np.ndarray) -> list["Sheet"]:
        """The same with another end: low and high along u, along v; with its back or its face elsewhere; all of it elsewhere
        along normal and u; turned.
        Sides that reflect are looked for in steps `fine_m` as well."""
        low, high, steps_m = np.array(self.low_m), np.array(self.high_m), np.array([*_STEPS_M, *(-m for m in _STEPS_M)])
        sides_m = np.concatenate([steps_m, fine_m]) if self.depth_m else steps_m
        if axis < 4:
            way = np.eye(2)[axis // 2]
            moves_m = sides_m if axis < 2 else steps_m
            ends = [(low + m * way, high) if axis % 2 == 0 else (low, high + m * way) for m in moves_m]
            return [replace(self, low_m=tuple(a), high_m=tuple(b)) for a, b in ends if (b - a).min() > _LEAST_M]
        if axis == 4:
            depths_m = self.depth_m + sides_m if self.depth_m else np.concatenate([_DEPTHS_M, -_DEPTHS_M])
            depths_m = depths_m[depths_m * (self.depth_m or depths_m) > 0]
            behind = [replace(self, depth_m=float(m)) for m in (0.0, *depths_m)]
            return behind + [self.nearer(float(m - self.depth_m)) for m in depths_m if self.depth_m]
        if axis < 7:
            way = np.array((self.normal, self.u)[axis - 5])
            return [replace(self, origin_m=tuple(np.array(self.origin_m) + m * way)) for m in steps_m]
        return [self.turned(angle_rad) for angle_rad in _TURNS_RAD]

    def nearer(self, more_m: float) -> "Sheet":
        """A box whose face is elsewhere, and its back where it was."""
        origin_m = np.array(self.origin_m) - more_m * np.array(self.normal)
        return replace(self, origin_m=tuple(origin_m), depth_m=self.depth_m + more_m)

    def around(self, lit_m: np.ndarray, beyond_m: float) -> "Sheet":
        """The same about points (n, 3) on it and somewhat beyond."""
        along = (lit_m - np.array(self.origin_m)) @ np.array([self.u, self.v]).T
        return replace(self, low_m=tuple(along.min(axis=0) - beyond_m), high_m=tuple(along.max(axis=0) + beyond_m))

    def turned(self, angle_rad: float) -> "Sheet":
        """About v, at its middle."""
        normal, u = np.array(self.normal), np.array(self.u)
        middle = (self.low_m[0] + self.high_m[0]) / 2 * u + self.depth_m / 2 * normal
        turned_u, turned_normal = (np.cos(angle_rad) * a + np.sin(angle_rad) * b for a, b in ((u, normal), (normal, -u)))
        half = (self.high_m[0] - self.low_m[0]) / 2
        origin_m = np.array(self.origin_m) + middle - self.depth_m / 2 * turned_normal
        return replace(
            self, origin_m=tuple(origin_m), normal=tuple(turned_normal), u=tuple(turned_u),
            low_m=(-half, self.low_m[1]), high_m=(half, self.high_m[1]),
        )  # fmt: skip


def across(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions of a plane, square to each other, the second one upright where it can be."""
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.5 else np.array([0.0, 1.0, 0.0])
    v = up - (up @ normal) * normal
    v /= np.linalg.norm(v)
    return np.cross(v, normal), v


def _fine_m(world, to_a_wave: float) -> np.ndarray:
    """Steps in which the phase of an echo turns little."""
    step_m = world.wavelength_m / to_a_wave
    many = min(int(_SIDE_M / step_m), _MOST_FINE)
    return step_m * np.arange(-many, many + 1)


def _is_dark(effect: Effect) -> bool:
    """Whether an added object sends nothing back: then its place has no phase, and what it is made of is all one."""
    return effect.values[2] <= 0.1 and effect.values[3] < 0.0


class MissingObject(Family):
    name = "missing_object"
    is_wide = True
    order = 1
    shape_axes = 8
    price_nats = 12.0  # of where it ends, and of all planes that were looked at
    ranks_unfitted = False  # how strong an echo is, and its last centimetre, are found by the fit

    def told_numbers(self, effect):
        return 0 if _is_dark(effect) else len(effect.values)  # beside its shape

    def owners(self, view):
        return ["place"] if view.has_responses else []

    def starts(self, view, owner):
        def begun(sheet, made, shift_m=0.0):
            return Effect(family=self, owner=owner, values=np.array([shift_m, 0.0, *np.log(made)]), choice=sheet)

        sheets = view.sheets()
        found = [self._in_phase(view, begun, sheet) for sheet in sheets]
        found = [view.ended(one) for one in view.row_by_row(found)[:_ENDED]] + found
        found += [begun(sheet, one) for sheet in sheets for one in _MADE]
        best = {}
        for one in view.row_by_row([begun(sheet, one) for sheet in view.gaps() for one in usual_at(view.world.carrier_hz)]):
            best.setdefault(id(one.choice), one)
        walls = [*best.values()][:_WALLS]
        dark = [begun(box, _DARK) for box in view.shades()]
        sides = [begun(*box) for effect in dark[:1] if view.explains_much(effect) for box in view.sided(effect)]
        return [*walls, *(view.ended(one) for one in walls), *found, *dark, *sides, *self._lone(view, begun)]

    def _lone(self, view, begun) -> list[Effect]:
        """What one link alone tells of, where nothing stands in the way of its echo."""
        sheets, view = view.lone_sheets()
        found = [begun(sheet, _BOARD) for sheet in sheets]
        found = [self._in_phase(view, begun, one.choice) for one in found if view.beside(one).lit(one)[0] is not None]
        return view.ranked(found)[:_LONE]

    def _in_phase(self, view, begun, sheet) -> Effect:
        """A plane where its echoes come in phase: the twin, fitted without, hides part of them. Rows where it ends otherwise than
        it was told to have no say."""
        coarse_m, fine_m = _fine_m(view.world, _COARSE), view.world.wavelength_m / _COARSE * np.linspace(-1, 1, _BETWEEN)
        shift_m = view.shift_in_phase_m(begun(sheet, _BOARD), np.array(sheet.normal), coarse_m)
        return view.row_by_row([begun(sheet, one, shift_m + m) for m in fine_m for one in _MADE])[0]

    def restarts(self, world, effect):
        made = [(1.0, 1e7), _DARK, *((permittivity, 0.03) for permittivity in _PERMITTIVITIES)]
        many = _BOX_WELLS if effect.choice.depth_m else _WELLS
        wells_m = effect.values[0] + world.wavelength_m / 4 * np.arange(-many, many + 1)
        if effect.choice.depth_m:  # the sides of boxes are looked for when these are shaped as well
            sheet, tops_m = effect.choice, effect.choice.high_m[1] + np.array(_TOPS_M)
            tops = [sheet, *(replace(sheet, high_m=(sheet.high_m[0], float(m))) for m in tops_m if m > sheet.low_m[1] + _LEAST_M)]
            elsewhere = [replace(effect, choice=top, values=np.array([m, *effect.values[1:]])) for m in wells_m for top in tops]
            return elsewhere + [effect.moved(np.array([*effect.values[:2], *np.log(one)])) for one in made]
        made = [effect.moved(np.array([m, effect.values[1], *np.log(one)])) for m in wells_m for one in made]
        return made + [
            effect.moved(np.array([*effect.values[:2], *one]))
            for one in fringes(*effect.values[2:], world, effect.choice.thickness_m)
        ]

    def beside(self, world, effect):
        sheet = effect.choice
        if not sheet.depth_m:
            return []
        steps_m = world.wavelength_m / _BESIDE * np.arange(-_BESIDE // 2, _BESIDE // 2 + 1)
        ways = np.array([sheet.u, sheet.normal])
        return [replace(effect, choice=replace(sheet, origin_m=tuple(sheet.origin_m + m * way))) for way in ways for m in steps_m]

    def ended(self, view, effect):
        return effect if effect.choice.depth_m else view.ended(effect)

    def reshaped(self, world, effect, axis):
        if axis < 4 and not effect.choice.depth_m:
            return []  # all ends of a plane are looked for at once
        fine_m = np.zeros(0) if _is_dark(effect) else _fine_m(world, _FINE)
        return [replace(effect, choice=one) for one in effect.choice.reshaped(axis, fine_m)]

    def smaller(self, view, effect, axis):
        sheet = effect.choice
        if axis > 3 or sheet.depth_m or (lit_m := view.lit(effect)[0]) is None:
            return []
        out = []
        for beyond_m in (_BEYOND_LIT_M, *_LESS_BEYOND_M):
            wide, ends = sheet.around(lit_m, beyond_m), np.array([sheet.low_m, sheet.high_m])
            low, high = np.maximum(ends[0], wide.low_m), np.minimum(ends[1], wide.high_m)
            ends[axis % 2, axis // 2] = (low, high)[axis % 2][axis // 2]
            less = replace(sheet, low_m=tuple(ends[0]), high_m=tuple(ends[1]))
            out.append(effect if less == sheet else replace(effect, choice=less))
        return out

    def sizes(self, view, effect):
        if effect.choice.depth_m or (lit_m := view.lit(effect)[0]) is None:
            return effect, effect
        return tuple(replace(effect, choice=effect.choice.around(lit_m, beyond_m)) for beyond_m in (_LEAST_M, _BEYOND_LIT_M))

    def apply(self, world, effect):
        shift_m, turn_rad, permittivity, conductivity = *effect.values[:2], *np.exp(effect.values[2:])
        name = next(name for name in (f"{_ADDED}{number}" for number in itertools.count(1)) if name not in world.mesh.names)
        solid = effect.choice.solid(name, shift_m, turn_rad)
        own = float(permittivity), float(conductivity), effect.choice.thickness_m
        medium = Medium(own_permittivity=own[0], own_conductivity_s_per_m=own[1], thickness_m=own[2])
        made = world.with_object(solid, permittivity=own[0], conductivity=own[1], thickness_m=own[2])
        return replace(made, media={**world.media, name: medium})

    @staticmethod
    def adds(name: str) -> bool:
        """Whether an object may be one that an effect adds."""
        return name.startswith(_ADDED)

    def steps(self, world, effect):
        return np.array([world.wavelength_m * 1e-3, 1e-5, 1e-4, 1e-3])

    def bounded(self, values):
        low, high = [-_FAR_M, -0.3, 0.0, np.log(1e-5)], [_FAR_M, 0.3, np.log(50), np.log(1e7)]
        return np.clip(values, low, high)

    def told(self, view, effect, covariance):
        shift_m, turn_rad = effect.values[:2]
        normal = effect.choice.normal_at(turn_rad)
        corners = effect.choice.corners_m(shift_m, turn_rad)
        lit_m, reflection_db = view.lit(effect)
        point = corners.mean(axis=0) if lit_m is None else lit_m.mean(axis=0)
        arm = float((point - np.array(effect.choice.origin_m)) @ np.array(effect.choice.u))
        slope = np.array([1.0, arm])
        std = float(np.sqrt(max(slope @ covariance[:2, :2] @ slope, 0.0)))
        seen = {} if lit_m is None else {"reflection_db": value(reflection_db, 1.0)}
        return {
            "point_m": value(point, np.maximum(std * np.abs(normal), 1e-6)),
            "normal": value(normal, [std_of(covariance, 1)] * 3),
        } | seen

    def extent_m(self, view, effect) -> list[list[float]]:
        lit_m, _ = view.lit(effect)
        points = effect.choice.corners_m(*effect.values[:2]) if lit_m is None else lit_m
        return [points.min(axis=0).tolist(), points.max(axis=0).tolist()]

    def is_one_with(self, view, effect, other):
        if other.family.name != self.name:
            return False
        boxes = [np.array(self.extent_m(view, one)) for one in (effect, other) if self.is_telling(view, one)]
        if len(boxes) == 2:  # two faces of a body: hardly apart
            (low, high), (other_low, other_high) = boxes
            return bool(np.linalg.norm(np.maximum(0, np.maximum(low - other_high, other_low - high))) < _BODY_M)
        ways = [view.shaded(one) for one in (effect, other) if not self.is_telling(view, one)]
        if not boxes:
            return bool(np.linalg.norm(ways[0][:, None] - ways[1][None], axis=2).min(initial=np.inf) < _BODY_M)
        return bool(np.linalg.norm(ways[0] - np.clip(ways[0], *boxes[0]), axis=1).min(initial=np.inf) < _BODY_M)

    def is_telling(self, view, effect):
        return view.lit(effect)[0] is not None

    def sentence(self, effect, told):
        x, y, z = told["point_m"]["value"]
        if "reflection_db" not in told:
            return (
                f"Something that the mesh leaves out stands in the way at ({x:.2f}, {y:.2f}, {z:.2f}) m and sends nothing back."
            )
        return (
            f"Something that the mesh leaves out reflects at ({x:.2f}, {y:.2f}, {z:.2f}) m, "
            f"{told['reflection_db']['value']:.1f} dB, normal ({', '.join(f'{n:.2f}' for n in told['normal']['value'])})."
        )


class MovingScatterer(Family):
    name = "moving_scatterer"
    is_wide = True
    is_in_spec = lasts = False
    has_ways = True
    order = 4
    price_nats = 12.0

    def owners(self, view):
        return ["place"] if view.world.person is None and view.has_responses else []

    def starts(self, view, owner):
        # A shadow may hide where its echoes come from, and echoes fill a shadow: both together, and each alone.
        dark = view.eclipses()
        ways, late = view.passers(CENTRE * HEIGHT_M, dark)
        return [
            *(self._of(owner, way.place_m, way.velocity, way.radius_m, way.area_m2) for way in ways),
            *(self._of(owner, *one, _FAINT_M2) for one in dark),
            *(self._of(owner, *one, _RADII_M[0], area_m2) for one in late for area_m2 in _AREAS_M2),
        ]

    def again(self, view, effect):
        (place_m, velocity, _), (radius_m, keeps) = np.split(effect.values, [2, 4]), effect.choice
        ways = view.passers_again(CENTRE * HEIGHT_M, place_m, velocity, [radius_m * one for one in _AGAIN])
        found = [self._of(effect.owner, way.place_m, way.velocity, way.radius_m, way.area_m2) for way in ways]
        return [replace(one, choice=(one.choice[0], keeps)) for one in found]

    def _of(self, owner, place_m, velocity, radius_m, area_m2) -> Effect:
        values = np.array([*place_m, *velocity, np.log(area_m2), HEIGHT_M])
        return Effect(family=self, owner=owner, values=values, choice=(radius_m, False))

    def plainer(self, span_s, effect):
        place_m, velocity, others = np.split(effect.values, [2, 4])
        at_s = np.linspace(*span_s, _STANDS)
        return [replace(effect, family=_STANDING, values=np.array([*place_m + velocity * s, *others])) for s in at_s]

    def restarts(self, world, effect):
        step_m = world.wavelength_m / 3  # the next wells of its phase
        wells = [(a, b) for a in range(-_WELLS, _WELLS + 1) for b in range(-_WELLS, _WELLS + 1) if a or b]
        return [effect.moved(effect.values + step_m * np.array([a, b, 0, 0, 0, 0])) for a, b in wells]

    def is_same_way(self, world, effect, other, span_s):
        place_m, velocity = np.split((effect.values - other.values)[:4], 2)
        return all(np.abs(place_m + velocity * at_s).max() < world.wavelength_m / 4 for at_s in span_s)

    def choices(self, world, effect):
        radii_m = {*_RADII_M, *(effect.choice[0] * _WIDER)} - {effect.choice[0]}
        bodies = [(float(radius_m), keeps) for radius_m in sorted(radii_m) for keeps in (False, True)]
        return [replace(effect, choice=body) for body in [(effect.choice[0], not effect.choice[1]), *bodies]]

    def apply(self, world, effect):
        x, y, vx, vy, area, height_m = effect.values
        person = Person(
            position_m=(x, y, 0.0), velocity_m_per_s=(vx, vy, 0.0), cross_section_m2=float(np.exp(area)),
            radius_m=effect.choice[0], height_m=float(height_m), keeps_polarisation=effect.choice[1],
        )  # fmt: skip
        return replace(world, person=person)

    def steps(self, world, effect):
        step = world.wavelength_m * 1e-3
        return np.array([step, step, step, step, 1e-4, step])

    def bounded(self, values):
        low, high = [-1e4, -1e4, -50, -50, np.log(1e-3), 0.5], [1e4, 1e4, 50, 50, np.log(1e4), 4.5]
        return np.clip(values, low, high)

    def besides(self, view, effect):
        # Of the many ways along which echoes are in phase it may be another one: delays tell as much as the band resolves.
        apart_m, lasts_s = view.resolution_m / np.sqrt(12), max(view.lasts_s, 1e-9)
        return np.diag([apart_m, apart_m, 2 * apart_m / lasts_s, 2 * apart_m / lasts_s, 0.0, 0.0]) ** 2

    def told(self, view, effect, covariance):
        std = np.sqrt(np.maximum(np.diag(covariance), 0))
        floor_m, floor_m_per_s = view.world.wavelength_m / 4, view.world.wavelength_m / 8
        return {
            "position_m": value([*effect.values[:2], 0.0], [*np.maximum(std[:2], floor_m), 1.0]),
            "velocity_m_per_s": value([*effect.values[2:4], 0.0], [*np.maximum(std[2:4], floor_m_per_s), 1.0]),
        }

    def sentence(self, effect, told):
        x, y, vx, vy = effect.values[:4]
        return f"Something passes by: at ({x:.2f}, {y:.2f}) m at the beginning, {np.hypot(vx, vy):.2f} m/s."


class _Standing(MovingScatterer):
    """Something that could have passed by and does not move."""

    def apply(self, world, effect):
        return super().apply(world, replace(effect, values=np.insert(effect.values, 2, [0.0, 0.0])))

    def steps(self, world, effect):
        return np.delete(super().steps(world, effect), _GOES)

    def bounded(self, values):
        return np.delete(super().bounded(np.insert(values, 2, [0.0, 0.0])), _GOES)


_STANDING = _Standing()
