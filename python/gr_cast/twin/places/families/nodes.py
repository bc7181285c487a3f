# SPDX-License-Identifier: GPL-3.0-or-later
"""What may be wrong at a node: where it is, how its antenna looks and where, its cable, its timing on the track."""

import itertools
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from ....scenario.create.nodes import ANTENNAS
from .base import SURVEYED_M, Effect, Family, std_of, value

_FAR_M = 0.7  # farthest offset that is looked for on the grid
_FARTHEST_M = 10.0  # that a fit may go
_GRID = 90  # points of the grid across, at most
_COARSE_M = (-0.45, -0.15, 0.15, 0.45)  # offsets about the best of which, by no phase, is looked again,
_COARSE_UP_M = (-0.4, -0.2, 0.0, 0.2, 0.4)  # and upwards
_STAGES, _AT_FIRST, _ELSEWHERE = 3, 8, 2  # of looking about the best, so many of them at first and later
_SHARPENED = 8  # of what is found there, whose bottoms are looked for
_ONE_WELL = 0.05  # wavelengths between places of one well
_BEST = 4  # maxima of a grid that are fitted
_FAR_UP_M = 0.4  # farthest up that is looked at: floors and ceilings show it,
_LEVEL, _LEVELS = 1 / 3, (4, 25)  # in levels so many wavelengths apart, so many either way
_WELLS = 10  # minima of a grid of places that are fitted: a deep well is narrow, and lies between two points of the grid
_FAR_WELLS = 16  # quarters of a wave, along an axis, within which other wells are looked for
_YAWS_RAD = np.linspace(-np.pi, np.pi, 24, endpoint=False)
_PITCHES_RAD = (-0.6, -0.25, 0.0, 0.25, 0.6)
_FACTOR_STEP, _OFFSET_STEP_S = 0.02, 0.1
_SPEED_FACTORS = np.arange(0.8, 1.2001, _FACTOR_STEP)
_TIME_OFFSETS_S = np.arange(-0.8, 0.8001, _OFFSET_STEP_S)
_LATE_S, _FASTER = 0.8, 0.2  # that a track is looked for late or early, faster or slower
_LATE = 2  # of those that are late alone, or faster alone, that are fitted
_STRIP = 8  # steps of a strip of such timings, either way: within a wavelength phases turn evenly
_ASIDE_SHARE = 0.05  # of a displacement that is no move along the track
_FINE = 30, 12  # steps of the fine grid of speeds, and of its times, either way, at most
_COARSE_FACTORS, _COARSE_OFFSETS_S = (0.87, 1.0, 1.13), (-0.4, 0.0, 0.4)  # where power alone is known


class _OfNode(Family):
    level = "node"

    def owners(self, view):
        return view.nodes


class NodePosition(_OfNode):
    name = "node_position"
    is_wide = True
    order = 2
    ranks_unfitted = False

    def is_negligible(self, effect):
        return float(np.linalg.norm(effect.values)) < SURVEYED_M

    def owners(self, view):
        return view.nodes if view.has_responses else []

    def starts(self, view, owner):
        zero = Effect(family=self, owner=owner, values=np.zeros(3))
        if view.is_quiet:
            return [zero]
        if not _holds_most(view, owner):
            return [zero, *self._about(view, zero, _LEVELS[0])]
        coarse = [zero.moved(np.array(at_m)) for at_m in itertools.product(_COARSE_M, _COARSE_M, _COARSE_UP_M)]
        levels = int(np.clip(np.ceil(_FAR_UP_M / (view.world.wavelength_m * _LEVEL)), *_LEVELS))
        found, middles = [], [zero, *view.promising(coarse)[:_AT_FIRST]]
        for _ in range(_STAGES):  # paths have other directions there
            found = view.ranked(found + [one for begun in middles for one in self._about(view, begun, levels)])[:_SHARPENED]
            found = _apart(view.sharpened(found), _ONE_WELL * view.world.wavelength_m)
            middles = found[:_ELSEWHERE]
        return [zero, *found]

    def _about(self, view, begun: Effect, levels: int) -> list[Effect]:
        """Places about one that would explain best, by phases that turn evenly from there on; so many levels up and down."""
        step_m = view.world.wavelength_m / 5
        reach = min(_GRID // 2, int(np.ceil(_FAR_M / step_m)))
        up_m = view.world.wavelength_m * _LEVEL * np.arange(-levels, levels + 1)
        grid_m = step_m * np.arange(-reach, reach + 1)
        found = (view.beside(begun) if begun.values.any() else view).scan_node(begun.owner, grid_m, up_m, best=_WELLS)
        return [begun.moved(begun.values + np.array(offset_m)) for offset_m in found]

    def images_moved_m(self, effect):
        return -effect.values  # against what stays

    def moving_images(self, view, shift_m):
        return [Effect(family=self, owner=name, values=-shift_m) for name in self.owners(view)]

    def restarts(self, world, effect):
        # The next wells of its phase, higher and lower too than the scan looked.
        steps = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]
        return [effect.moved(effect.values + world.wavelength_m / 2 * np.array(step)) for step in steps]

    def wells(self, world, effect):
        # Across a lone link, and upwards between a floor and a ceiling, they are waves apart.
        far_m = world.wavelength_m / 4 * np.concatenate([np.arange(-_FAR_WELLS, -2), np.arange(3, _FAR_WELLS + 1)])
        along = [effect.moved(effect.values + m * axis) for axis in np.eye(3) for m in far_m]
        return [*self.restarts(world, effect), *along]

    def apply(self, world, effect):
        offset_m = np.array(world.radios[effect.owner].offset_m) + effect.values
        return world.with_radio(effect.owner, offset_m=tuple(offset_m))

    def steps(self, world, effect):
        return np.full(3, world.wavelength_m * 1e-3)

    def bounded(self, values):
        return np.clip(values, -_FARTHEST_M, _FARTHEST_M)

    def besides(self, view, effect):
        # Phases that another cause spoils may lead to any well about as far off.
        return np.eye(3) * (np.linalg.norm(effect.values) / ndtri(0.975)) ** 2

    def told(self, view, effect, covariance):
        return {"offset_m": value(effect.values, np.sqrt(np.maximum(np.diag(covariance), 0)))}

    def sentence(self, effect, told):
        return f"{effect.owner} is {np.linalg.norm(effect.values):.3g} m away from where the twin has it."


class NodeGain(_OfNode):
    name = "node_gain"
    shows_in_power = True
    is_in_spec = False

    def owners(self, view):
        return view.nodes if view.gain != "node" else []

    def starts(self, view, owner):
        return [Effect(family=self, owner=owner, values=np.zeros(1))]

    def apply(self, world, effect):
        return world.with_radio(effect.owner, gain_db=world.radios[effect.owner].gain_db + effect.values[0])

    def bounded(self, values):
        return np.clip(values, -60, 60)

    def told(self, view, effect, covariance):
        return {"error_db": value(effect.values[0], std_of(covariance, 0))}

    def sentence(self, effect, told):
        return f"All that {effect.owner} sends and hears is {effect.values[0]:+.2f} dB against the twin: its cable or amplifier."


class NodeDelay(_OfNode):
    name = "node_delay"
    is_in_spec = False

    def owners(self, view):
        return view.nodes if view.delay == "none" and view.has_responses else []

    def starts(self, view, owner):
        zero = Effect(family=self, owner=owner, values=np.zeros(1))
        return [zero, Effect(family=self, owner=owner, values=np.array([view.delay_of_node(owner)]))]

    def apply(self, world, effect):
        return world.with_radio(effect.owner, delay_s=world.radios[effect.owner].delay_s + effect.values[0])

    def steps(self, world, effect):
        return np.array([1e-13])

    def told(self, view, effect, covariance):
        return {"error_s": value(effect.values[0], std_of(covariance, 0))}

    def sentence(self, effect, told):
        return f"All that {effect.owner} sends and hears comes {effect.values[0] * 1e9:+.2f} ns late: its cable or clock."


class AntennaOrientation(_OfNode):
    name = "antenna_orientation"
    shows_in_power = True

    def owners(self, view):
        return [name for name in view.nodes if view.world.radios[name].node.antenna != "iso" and view.looks_around(name)]

    def starts(self, view, owner):
        round_ = view.world.radios[owner].node.antenna != "tr38901"
        yaws = _YAWS_RAD[::4] if round_ else _YAWS_RAD
        pitches = [p for p in _PITCHES_RAD if p or not round_]
        return [Effect(family=self, owner=owner, values=np.array([yaw, pitch])) for yaw in yaws for pitch in pitches] + (
            [Effect(family=self, owner=owner, values=np.array([0.0, 0.02]))]
        )

    def apply(self, world, effect):
        node = world.radios[effect.owner].node
        yaw, pitch, roll = node.orientation_rad
        turned = (float(yaw + effect.values[0]), float(pitch + effect.values[1]), roll)
        return world.with_radio(effect.owner, node=replace(node, orientation_rad=turned))

    def bounded(self, values):
        return np.array([(values[0] + np.pi) % (2 * np.pi) - np.pi, np.clip(values[1], -np.pi, np.pi)])

    def told(self, view, effect, covariance):
        return {
            "yaw_rad": value(effect.values[0], std_of(covariance, 0)),
            "pitch_rad": value(effect.values[1], std_of(covariance, 1)),
        }

    def sentence(self, effect, told):
        yaw, pitch = np.degrees(effect.values)
        return f"The antenna of {effect.owner} looks {yaw:+.1f}° aside and {pitch:+.1f}° down against the twin."


class AntennaPattern(_OfNode):
    name = "antenna_pattern"
    shows_in_power = True
    price_nats = float(np.log(3))

    def starts(self, view, owner):
        own = view.world.radios[owner].node.antenna
        return [Effect(family=self, owner=owner, values=np.zeros(0), choice=kind) for kind in ANTENNAS if kind != own]

    def apply(self, world, effect):
        return world.with_radio(effect.owner, node=replace(world.radios[effect.owner].node, antenna=effect.choice))

    def told(self, view, effect, covariance):
        return {"pattern": effect.choice}

    def sentence(self, effect, told):
        return f"The antenna of {effect.owner} is rather a {effect.choice} than what the twin says."


def _apart(effects: list[Effect], least_m: float) -> list[Effect]:
    """The first of those that are nearer than that to each other."""
    out: list[Effect] = []
    for one in effects:
        if all(np.linalg.norm(one.values - other.values) > least_m for other in out):
            out.append(one)
    return out


def _holds_most(view, owner: str) -> bool:
    """Whether links of a node hold most of what is left above noise: where it is leaves nothing on others, which go first."""
    left = view.left_alone
    return sum(nats for link, nats in left if owner in link) > 0.5 * sum(nats for _, nats in left)


class TrackTiming(_OfNode):
    """Late or early on the track, `values` [seconds], or also faster or slower, [seconds, factor]."""

    name = "track_timing"
    is_in_spec = False
    order = 2

    def owners(self, view):
        return [name for name in view.nodes if view.world.radios[name].node.is_moving and name not in view.tracked]

    def starts(self, view, owner):
        wrong = lambda offset_s, *factor: Effect(family=self, owner=owner, values=np.array([offset_s, *factor]))  # noqa: E731
        if not view.has_responses:
            return [wrong(offset_s, factor) for factor in _COARSE_FACTORS for offset_s in _COARSE_OFFSETS_S]
        near = [wrong(offset_s, 1.0 + step) for step in (-0.003, 0.003) for offset_s in (-0.01, 0.01)]
        if view.is_quiet or not _holds_most(view, owner):
            return near
        still = np.zeros(1)
        step_s = view.world.wavelength_m / 8 / view.world.radios[owner].node.speed_m_per_s
        step = step_s / view.last_s  # of the factor: at the end of the soundings a step as long
        late = [wrong(s) for s in _middles(_LATE_S, step_s, _STRIP)]
        faster = [wrong(0.0, 1.0 + one) for one in _middles(_FASTER, step, _STRIP)]
        strip = np.arange(-_STRIP, _STRIP + 1)
        out = view.ranked([one for begun in late for one in self._beside(view, begun, step_s * strip, still, 1)])[:_LATE]
        out += view.ranked([one for begun in faster for one in self._beside(view, begun, still, step * strip, 1)])[:_LATE]
        coarse = [wrong(offset_s, factor) for factor in _SPEED_FACTORS for offset_s in _TIME_OFFSETS_S]
        grids = _up_to(_OFFSET_STEP_S / 2, step_s, _FINE[1]), _up_to(_FACTOR_STEP / 2, step, _FINE[0])
        for begun in view.promising(coarse)[:_BEST]:
            out += view.ranked(self._beside(view, begun, *grids, _BEST))[:1]
        return [*out, *near]

    def _beside(self, view, begun: Effect, later_s: np.ndarray, faster: np.ndarray, best: int) -> list[Effect]:
        """Timings on a grid about one that would explain best; the middle of the track stays while the speed is another."""
        offset_s, factor = _timing(begun)
        middle_s = view.last_s / 2 if len(later_s) > 1 else 0.0
        found = view.beside(begun).scan_timing(begun.owner, middle_s, later_s, faster, best)
        if len(begun.values) == 1:
            return [begun.moved(np.array([offset_s + s])) for s, _ in found]
        ahead_s = (middle_s + offset_s) * factor
        return [begun.moved(np.array([(ahead_s + factor * s) / (factor + more) - middle_s, factor + more])) for s, more in found]

    def restarts(self, world, effect):
        # The next wells of its phase.
        well_s = world.wavelength_m / 2 / max(world.radios[effect.owner].node.speed_m_per_s, 1e-3)
        wells = [step * well_s for step in range(-_WELLS, _WELLS + 1) if step]
        return [effect.moved(np.array([effect.values[0] + shift_s, *effect.values[1:]])) for shift_s in wells]

    def covers(self, world, effect, rival):
        # Moved along its own track by chance: not as long as that it is late says the same with one number.
        if not isinstance(rival.family, NodePosition) or rival.owner != effect.owner:
            return super().covers(world, effect, rival)
        waypoints_m = world.radios[effect.owner].node.waypoints_m
        ahead = (waypoints_m[1] - waypoints_m[0]) / np.linalg.norm(waypoints_m[1] - waypoints_m[0])
        aside_m = rival.values - rival.values @ ahead * ahead
        return len(effect.values) == 1 and np.linalg.norm(aside_m) < _ASIDE_SHARE * np.linalg.norm(rival.values)

    def apply(self, world, effect):
        offset_s, factor = _timing(effect)
        return world.with_radio(effect.owner, speed_factor=factor, time_offset_s=offset_s)

    def steps(self, world, effect):
        return np.full(len(effect.values), 1e-5)

    def bounded(self, values):
        return np.clip(values, [-5, 0.2][: len(values)], [5, 5][: len(values)])

    def told(self, view, effect, covariance):
        offset_s, factor = _timing(effect)
        return {
            "speed_factor": value(factor, std_of(covariance, 1)) if len(effect.values) > 1 else value(factor),
            "time_offset_s": value(offset_s, std_of(covariance, 0)),
        }

    def sentence(self, effect, told):
        offset_s, factor = _timing(effect)
        return f"{effect.owner} goes {factor:.3f} times as fast as in the twin and is {offset_s:+.3f} s ahead on its track."


def _middles(reach: float, step: float, half: int) -> np.ndarray:
    """Middles of strips of so many steps either way, from −reach to reach."""
    return _up_to(reach, 2 * half * step, int(reach / step))


def _up_to(reach: float, step: float, most: int) -> np.ndarray:
    """From −reach to reach in steps, no more than so many either way."""
    many = min(int(np.ceil(reach / step)), most)
    return step * np.arange(-many, many + 1)


def _timing(effect: Effect) -> tuple[float, float]:
    """Seconds ahead, and speed over the twin's."""
    return float(effect.values[0]), float(effect.values[1]) if len(effect.values) > 1 else 1.0
