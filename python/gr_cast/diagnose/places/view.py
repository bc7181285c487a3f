# SPDX-License-Identifier: GPL-3.0-or-later
"""What families ask of the state of a search: who is there, what is seen, where coarse searches point."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, db_from_amplitude
from ...scenario.create import fields
from ...twin.places.carrying import headings
from ...twin.places.families import FAMILIES
from . import diffuse, eclipses, extents, fringes, grounds, imaging, planes, policy, scan, shades, sides, tracks
from .coherent import Phased
from .ears import alone, holding, of_links, thinned_as_fitted, without_phase
from .fit import Model, applied, evaluated, fitted, heard_in, with_effect

_SCANNED_CARRIERS = 100_000
_SOUNDED, _ONE_WELL = 300, 0.05  # wells of a grid of places whose bottoms are looked for; wavelengths between bottoms of one
_AROUND = 0.3  # change of a link's direction, as a share of its length, from which antennas show from several sides


def _order(models: Sequence[Model]) -> list[int]:
    """Numbers of models by what they explain: the best where other causes spoil what they spoil, the best where nothing does, the
    second best, and so on. Guesses that are not fitted leave much of their own, too."""
    keys = (lambda number: models[number].tempered), (lambda number: models[number].energy)
    return scan.by_turns(*(sorted(range(len(models)), key=key) for key in keys))


def _pays(model: Model, before: Model) -> bool:
    return max(before.energy - model.energy, before.tempered - model.tempered) > policy.LEAST_EVIDENCE_NATS


class View:
    """A model among its soundings, as `twin.places.families` look at it."""

    def __init__(self, ears, model, unknown: dict):
        self.ears, self.model, self.world = ears, model, model.world
        self.unknown = unknown
        self.gain, self.delay, self.phase = unknown["gain"], unknown["delay"], unknown["phase"]

    @cached_property
    def thin(self):
        return thinned_as_fitted(self.ears, self.model.fits)

    @property
    def last_s(self) -> float:
        return max(float(ear.predictor.time_s[-1]) for ear in self.ears) or 1.0

    def ranked(self, starts: list) -> list:
        """First guesses by how well they explain a thinned sounding."""
        ears = self._ears_for(starts)
        return [starts[number] for number in _order([with_effect(ears, self._thin_model, start) for start in starts])]

    def sharpened(self, starts: list) -> list:
        """First guesses, each at the bottom of its well on a thinned sounding, the lowest first."""
        number, before, ears = len(self.model.effects), self._thin_model, self._ears_for(starts)
        found = [
            fitted(ears, with_effect(ears, before, start), rounds=policy.SCREEN_ROUNDS, free=[number]) for start in starts
        ]  # fmt: skip
        return [found[number].effects[-1] for number in _order(found)]

    def explains_much(self, start) -> bool:
        """Whether it takes a good part of what is left above noise."""
        here, there = self._thin_model, evaluated(self.thin, self.model.base, (*self.model.effects, start))
        return here.energy - there.energy > policy.STIFF_SHARE * here.left_nats(sum(ear.count for ear in self.thin))

    def row_by_row(self, starts: list) -> list:
        """First guesses by their energy on a thinned sounding each of whose responses may do without."""

        def rows(fits) -> list[np.ndarray]:
            return [ear.row_nats(fit) for ear, fit in zip(self.thin, fits, strict=True) if ear.has_responses]

        here = rows(self._thin_model.fits)

        def energy(start) -> float:
            _, bent = heard_in(self.thin, applied(self.model.base, (*self.model.effects, start)))
            there = rows([fit for fit, _ in bent])
            return sum(float(np.minimum(one, other).sum()) for one, other in zip(here, there, strict=True))

        return sorted(starts, key=energy)

    @cached_property
    def _thinned(self) -> "View":
        return View(self.thin, self._thin_model, self.unknown)

    @cached_property
    def _held(self):
        return holding(self.thin, self.world)

    def _ears_for(self, starts: list):
        """A thinned sounding as is to be heard what first guesses of one family explain of it."""
        return self.thin if any(start.family.is_flexible for start in starts) else self._held

    @cached_property
    def _thin_model(self):
        return evaluated(self.thin, self.model.base, self.model.effects)

    def promising(self, starts: list) -> list:
        """Those of the first guesses that explain something even where no phase is believed, the best first."""
        ears = [without_phase(ear) for ear in self.thin]
        here = evaluated(ears, self.model.base, self.model.effects)
        models = [with_effect(ears, here, start) for start in starts]
        return [starts[number] for number in _order(models) if _pays(models[number], here)]

    @cached_property
    def left_alone(self) -> list[tuple[tuple[str, str], float]]:
        """(link, nats above noise) where each link has a gain and a phase of its own, and a delay where one is unknown:
        a node spoils those that others share with it, and thereby what others leave."""
        out = []
        for ear in (alone(ear) for ear in self.ears):
            fit = evaluated([ear], self.model.base, self.model.effects).fits[0]
            out += zip(ear.predictor.links, (ear.left(fit) - (ear.root > 0).sum(axis=(1, 2))).tolist(), strict=True)
        return out

    @cached_property
    def is_quiet(self) -> bool:
        """Whether so little is left that what moves paths by wavelengths would have shown."""
        return self.model.left_nats(self.count) < policy.QUIET_DEVIATIONS * np.sqrt(self.count)

    @cached_property
    def count(self) -> int:
        """Numbers of all soundings."""
        return sum(ear.count for ear in self.ears)

    @property
    def has_responses(self) -> bool:
        return any(ear.has_responses for ear in self.ears)

    @cached_property
    def links(self):
        return sorted({link for ear in self.ears for link in ear.predictor.links})

    @cached_property
    def nodes(self):
        return sorted({name for link in self.links for name in link})

    @property
    def tracked(self) -> set[str]:
        """Nodes whose positions were recorded along with the soundings."""
        return {name for ear in self.ears for name in ear.predictor.tracked}

    @property
    def families(self):
        """Those that these soundings can show: power alone tells no place of anything."""
        return [family for family in FAMILIES if self.has_responses or family.shows_in_power]

    @cached_property
    def walkers(self) -> list[str]:
        """Nodes that go somewhere while they are sounded."""
        going = set()
        for ear in self.ears:
            for index, link in enumerate(ear.predictor.links):
                ends_m = ear.predictor.ends_m(self.world, index)
                going |= {name for name, end_m in zip(link, ends_m, strict=True) if headings(end_m).any()}
        return sorted(going)

    def looks_around(self, name: str) -> bool:
        """Whether a node's antenna shows a link from several sides: from one it is as good as a gain."""
        if self.has_responses:
            return True
        for ear in self.ears:
            for index, link in enumerate(ear.predictor.links):
                if name in link:
                    tx_m, rx_m = ear.predictor.ends_m(self.world, index)
                    line = (rx_m - tx_m) / np.linalg.norm(rx_m - tx_m, axis=1)[:, None]
                    if np.ptp(line, axis=0).max() > _AROUND:
                        return True
        return False

    @cached_property
    def fading_links(self):
        """Links with power alone whose ends move."""
        found = set()
        for ear in self.ears:
            if not ear.has_responses:
                for index, link in enumerate(ear.predictor.links):
                    if any(np.ptp(end_m, axis=0).any() for end_m in ear.predictor.ends_m(self.world, index)):
                        found.add(link)
        return sorted(found)

    def apart_m(self, name: str) -> float:
        """The way of both ends of a link from one power that is read to the next."""
        steps = [0.0]
        for ear in self.ears:
            for index, link in enumerate(ear.predictor.links):
                if not ear.has_responses and ">".join(link) == name:
                    ends_m = np.concatenate(ear.predictor.ends_m(self.world, index), axis=1)[ear.weight[index, :, 0] > 0]
                    steps += [float(np.median(np.linalg.norm(np.diff(ends_m, axis=0), axis=1)))] if len(ends_m) > 1 else []
        return max(steps)

    def readings_of(self, name: str) -> tuple[np.ndarray, float, tuple[float, float]]:
        """All powers that a node reads, the meter's error, and the limits that it is known to have."""
        readings, std_db, limits = [np.zeros(0)], [0.0], (-np.inf, np.inf)
        for ear in self.ears:
            if ear.has_responses:
                continue
            limits = ear.limits_db or limits
            for index, (_, rx) in enumerate(ear.predictor.links):
                known = ear.weight[index, :, 0] > 0
                if rx == name and known.any():
                    readings.append(ear.power_db[index, known, 0])
                    std_db.append(float(np.sqrt(0.5 / ear.weight[index, known, 0].min())))
        return np.concatenate(readings), max(std_db), limits

    @cached_property
    def centre_m(self):
        return np.mean([radio.node.waypoints_m.mean(axis=0) for radio in self.world.radios.values()], axis=0)

    @cached_property
    def bounds_m(self):
        ends = [radio.node.waypoints_m for radio in self.world.radios.values()]
        corners = [solid.vertices_m for solid in self.world.mesh.solids if np.abs(solid.vertices_m).max() < 2000]
        points = np.concatenate(ends + corners)
        return points.min(axis=0), points.max(axis=0)

    @cached_property
    def _tables(self):
        return [
            (ear.predictor.path_table(self.world, index), ear.predictor.traced(self.world, index))
            for ear in self.ears
            for index in range(len(ear.predictor.links))
        ]

    def _names(self, which) -> list[str]:
        names, own = self.world.mesh.names, self.model.base.mesh.names  # what an effect added is no object of the twin
        return sorted({names[i] for i in which if names[i] in own})

    @cached_property
    def seen_objects(self) -> list[str]:
        """Objects that reflect (or let through) a path that is there."""
        found = set()
        for table, _ in self._tables:
            met = np.concatenate([table.paths.faces[table.paths.faces >= 0], table.paths.crossing_face])
            found |= set(self.world.faces.owner[met].tolist())
        return self._names(found)

    @cached_property
    def near_objects(self) -> list[str]:
        """Objects that reflect a path or stand in the way of one."""
        return self._names({number for _, traced in self._tables for number in traced.touched})

    @cached_property
    def blocking_objects(self) -> list[str]:
        faces = self.world.faces.owner
        return self._names({number for _, traced in self._tables for number in faces[traced.paths.crossing_face].tolist()})

    @cached_property
    def scatterers(self) -> list[str]:
        """Objects that would be heard if they scattered what they reflect, the loudest first."""
        count, part = (sum(ear.count for ear in ears) for ears in (self.ears, self.thin))
        nats = diffuse.scatterers(self.thin, self._thin_model.fits, self.world) * count / max(part, 1)
        names, own = self.world.mesh.names, self.model.base.mesh.names
        loud = [number for number in np.argsort(-nats, kind="stable") if nats[number] > policy.LEAST_EVIDENCE_NATS]
        return [names[number] for number in loud if names[number] in own]

    def shared_materials(self, names: Sequence[str]) -> list[str]:
        """Materials that two or more of some objects are made of."""
        made = [self.world.media[name].material for name in names]
        return sorted({name for name in made if name and made.count(name) > 1 and name not in self.world.mesh.names})

    def axes(self, owner: str) -> list[np.ndarray]:
        """Directions of an object's faces, signs aside."""
        return self.world.axes(self.world.mesh.index(owner))[:4]

    @cached_property
    def lowest_m(self) -> float:
        """Of all nodes that were sounded, at all instants."""
        return min(
            float(end_m[:, 2].min())
            for ear in self.ears
            for index in range(len(ear.predictor.links))
            for end_m in ear.predictor.ends_m(self.world, index)
        )

    @property
    def lacks_ground(self) -> bool:
        """Whether no level face lies under all nodes."""
        faces = self.world.faces
        lowest = self.lowest_m
        low, high = self.bounds_m
        level = (np.abs(faces.normal[:, 2]) > 0.999) & (faces.level_m * faces.normal[:, 2] < lowest)
        for face in np.flatnonzero(level):
            corners = faces.triangles_m[faces.start[face] : faces.start[face + 1]].reshape(-1, 3)
            if np.prod(np.ptp(corners[:, :2], axis=0)) > 0.5 * np.prod((high - low)[:2]):
                return False
        return True

    @cached_property
    def _unturned(self) -> list:
        """Fits whose unknown delays are those of the strengths alone: delays would make up for phases that are wrong."""
        fits = []
        for ear, fit in zip(self.ears, self.model.fits, strict=True):
            if ear.has_responses and self.delay != "none" and self.phase == "none" and len(ear.heard.frequency_hz) > 1:
                free = without_phase(ear).profiled(ear.predicted(self.world)).factor
                step = free[..., 1:2] / free[..., :1]
                steps = (
                    ear.heard.frequency_hz[0] / (ear.heard.frequency_hz[-1] - ear.heard.frequency_hz[0]) * (free.shape[-1] - 1)
                )
                middle = free[..., :1] * np.exp(-1j * np.angle(step) * steps)  # at the carrier
                fit = replace(fit, factor=free / (middle / np.maximum(np.abs(middle), 1e-300)))
            fits.append(fit)
        return fits

    def _scanned(self, rates_of, fits=None, without=None) -> list:
        out = []
        for ear, fit in zip(self.ears, fits or self._unturned, strict=True):
            if ear.has_responses:
                out += scan.rows(ear, fit, self.world, lambda index, ear=ear: rates_of(ear, index), without)
        return out

    def _in_band(self, lengths: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """(axes, n, 2): change of length, and its part that shows in the band where the link's delay is not known."""
        shown = lengths
        if self.delay != "none":
            weight = np.abs(gain) ** 2
            shown = lengths - (lengths * weight).sum(axis=1, keepdims=True) / max(weight.sum(), 1e-300)
        return np.stack([lengths, shown], axis=2)

    def scan_node(self, name: str, grid_m: np.ndarray, up_m: np.ndarray, best: int) -> list[tuple[float, float, float]]:
        """Offsets of a node, on a level grid and some way up, that would explain its links best."""

        def rates(ear, index):
            link = ear.predictor.links[index]
            if name not in link:
                return None
            table = ear.predictor.path_table(self.world, index)
            gain, way = table.gain, table.way
            along = -way.direction[:, 0] if link[0] == name else way.direction[:, -1]
            return self._in_band(along.T, gain)

        rows = self._scanned(rates)
        if not rows:
            return []
        wells = scan.minima_of((grid_m, grid_m, up_m), scan.energy_in_space(rows, grid_m, grid_m, up_m), _SOUNDED)
        at_m, nats = scan.bottoms(rows, np.array(wells), self.world.wavelength_m / 8)
        found = np.zeros((0, 3))
        for number in scan.by_turns(*np.argsort(nats, axis=1).tolist()):
            if (
                len(found) < best
                and np.linalg.norm(found - at_m[number], axis=1).min(initial=np.inf) > _ONE_WELL * self.world.wavelength_m
            ):
                found = np.vstack([found, at_m[number]])
        return [tuple(at_m) for at_m in found.tolist()]

    def scan_timing(
        self, name: str, middle_s: float, later_s: np.ndarray, faster: np.ndarray, best: int
    ) -> list[tuple[float, float]]:
        """How much later, and faster about the middle of its way, on two grids a node would go that explains its links best."""
        radio = self.world.radios[name]

        def rates(ear, index):
            link = ear.predictor.links[index]
            if name not in link:
                return None
            table, time_s = ear.predictor.path_table(self.world, index), ear.predictor.time_s
            along = -table.way.direction[:, 0] if link[0] == name else table.way.direction[:, -1]
            speed = (radio.velocity_m_per_s(time_s)[table.instant] * along).sum(axis=1)
            ahead_s = radio.speed_factor, (time_s - middle_s)[table.instant]
            return self._in_band(np.stack([speed * one for one in ahead_s]), table.gain)

        rows = self._scanned(rates)
        return scan.minima_of((later_s, faster), scan.energy(rows, later_s, faster), best) if rows else []

    def scan_object(self, name: str, normal: np.ndarray, grid_m: np.ndarray, best: int) -> list[float]:
        """Shifts of an object along a normal that would explain best."""
        rows = self._scanned(self._moved_with(self.world.mesh.index(name), normal))
        return scan.wells(rows, grid_m, best) if rows else []

    def shift_in_phase_m(self, effect, normal: np.ndarray, grid_m: np.ndarray) -> float:
        """Shift along a normal at which an object that an effect adds would explain best; each response may do without it."""
        there = self.beside(effect)
        rates = there._moved_with(len(there.world.mesh.names) - 1, normal)
        rows = there._scanned(rates, self._thinned._unturned, self.world)
        return float(grid_m[np.argmin(scan.energy_along(rows, grid_m)[1])]) if rows else 0.0

    def _moved_with(self, number: int, normal: np.ndarray):
        """Change of paths' lengths with an object's place along a normal, of links."""
        faces = self.world.faces

        def rates(ear, index):
            if number not in ear.predictor.traced(self.world, index).touched:
                return None
            table = ear.predictor.path_table(self.world, index)
            gain, way = table.gain, table.way
            paths, change = table.paths, np.zeros(len(gain))
            for bounce in range(paths.faces.shape[1]):
                face = paths.faces[:, bounce]
                own = (face >= 0) & (faces.owner[face] == number)
                plane = faces.normal[face]
                turn = ((way.direction[:, bounce] - way.direction[:, bounce + 1]) * plane).sum(axis=1)
                change += np.where(own, turn * (plane @ normal), 0.0)
            return self._in_band(change[None], gain) if np.any(change[gain != 0]) else None

        return rates

    def moves_m(self, most_m: float) -> np.ndarray:
        """Either way, in steps that turn the phase of an echo by half a turn at most."""
        step_m = self.world.wavelength_m / 8
        return step_m * np.arange(-int(most_m / step_m), int(most_m / step_m) + 1)

    def scan_strips(self, at_m, middles_m, strip_m: float, name: str, normal: np.ndarray, best: int) -> list[float]:
        """The same where moves are so far that they bend lengths: each strip is scanned from the effect `at_m` its middle."""
        grid_m = self.moves_m(strip_m / 2 + self.world.wavelength_m / 4)  # beyond its ends: a well on them is a well
        return [
            middle_m + shift_m
            for middle_m in middles_m
            for shift_m in self.beside(at_m(middle_m)).scan_object(name, normal, grid_m, best)
        ]

    def scan_carrier(self, octaves: float, best: int) -> list[float]:
        """Carriers that would turn the phases of all paths as they are, and weaken them as wavelengths get shorter. A phase that
        is known turns with every wavelength of a path, one that is not with every wavelength between two."""
        here_hz, far_m = self.world.carrier_hz, np.max if self.phase == "none" else np.ptp
        lengths_m = [table.way.length_m for table, _ in self._tables if len(table.gain)]
        above, below = here_hz * (2**octaves - 1), here_hz * (1 - 2**-octaves)
        step_hz = SPEED_OF_LIGHT_M_PER_S / max(max(map(far_m, lengths_m), default=1.0), 1.0) / 8
        grid_hz = np.arange(-below, above, max(step_hz, (above + below) / _SCANNED_CARRIERS))

        def rates(ear, index):
            table = ear.predictor.path_table(self.world, index)
            turned = table.way.length_m[None] / here_hz
            return np.stack([turned, np.zeros_like(turned)], axis=2)

        rows = self._scanned(rates)
        if not rows:
            return []
        scale = here_hz / (here_hz + grid_hz) if self.gain == "none" else None
        return [here_hz + hz for hz in scan.minima(grid_hz, scan.energy_along(rows, grid_hz, scale), best)]

    @cached_property
    def wideband(self) -> list:
        """(ear, fit) of the campaigns whose residual shows delays."""
        pairs = zip(self.ears, self.model.fits, strict=True)
        return [(ear, fit) for ear, fit in pairs if ear.has_responses and len(ear.heard.frequency_hz) > 1]

    @property
    def lasts_s(self) -> float:
        return max(float(np.ptp(ear.predictor.time_s)) for ear in self.ears)

    @cached_property
    def phased(self) -> Phased:
        """Of the first wideband campaign: one points, all are fitted."""
        return Phased.of(*self.wideband[0], self.world)

    @cached_property
    def echoes(self) -> list[imaging.Echoes]:
        return [imaging.echoes(ear, fit, self.world) for ear, fit in self.wideband]

    def beside(self, effect) -> "View":
        """A look at the thinned soundings with this effect among the model's."""
        return View(self.thin, evaluated(self.thin, self.model.base, (*self.model.effects, effect)), self.unknown)

    def among(self, effect) -> "View":
        """The same on all of the soundings."""
        return View(self.ears, with_effect(self.ears, self.model, effect), self.unknown)

    def scan_ground(self) -> list[tuple[float, float]]:
        """Heights under all nodes, and permittivities, of level planes that would explain responses, or powers where these are
        all there is."""
        if self.has_responses:
            return grounds.by_echoes(self.ears, self._unturned, self.world, self.lowest_m)
        return fringes.grounds(self.ears, self.world, self.lowest_m)

    @property
    def resolution_m(self) -> float:
        """Length by which paths differ that the band tells apart."""
        heard = [ear.heard for ear, _ in self.wideband]
        return max((SPEED_OF_LIGHT_M_PER_S / (len(one.frequency_hz) * one.spacing_hz) for one in heard), default=0.0)

    def delay_of_node(self, name: str) -> float:
        """Common delay of what is heard over a node's links against the model, from the phase slopes."""
        top = bottom = 0.0
        for ear, fit in zip(self.ears, self.model.fits, strict=True):
            if not ear.has_responses or len(ear.heard.frequency_hz) < 2:
                continue
            omega = 2 * np.pi * ear.heard.frequency_hz
            for index, link in enumerate(ear.heard.links):
                if name in link:
                    cross = fit.model[index].conj() * ear.heard.y[index] * ear.heard.weight[index]
                    turned = cross[:, 1:] * cross[:, :-1].conj()
                    size = np.abs(turned).sum()
                    top += -np.angle(turned.sum()) / (omega[1] - omega[0]) * size
                    bottom += size
        return top / max(bottom, 1e-300)

    def reflection_error_db(self, effect, which, covariance) -> tuple[float, float]:
        """Mean over the paths that an object reflects: gain in this world over that without the effect, and its deviation."""

        def mean(world):
            found = []
            for ear in self.ears:
                for index in range(len(ear.predictor.links)):
                    table, plain = (ear.predictor.path_table(one, index) for one in (world, self.without(effect)))
                    paths, gain, plain = table.paths, table.gain, plain.gain
                    met = np.isin(self.world.faces.owner[paths.faces], which) & (paths.faces >= 0)
                    use = (met.sum(axis=1) == 1) & (gain != 0) & (plain != 0)
                    found.append(db_from_amplitude(gain[use]) - db_from_amplitude(plain[use]))
            found = np.concatenate(found)
            found = found[np.isfinite(found)]
            return float(found.mean()) if len(found) else 0.0

        here, slope = mean(self.world), []
        for number, step in enumerate(effect.family.steps(self.world, effect)):
            values = np.array(effect.values)
            values[number] += step
            slope.append((mean(effect.family.apply(self.world, effect.moved(values))) - here) / step)
        slope = np.array(slope)
        return here, float(np.sqrt(max(slope @ covariance @ slope, 0.0)) + 0.01)

    def without(self, effect):
        return applied(self.model.base, [other for other in self.model.effects if other is not effect])

    def transmission_loss_db(self, effect) -> float:
        """Mean over straight legs that go through the object: free space over what comes."""
        found = []
        for ear in self.ears:
            for index in range(len(ear.predictor.links)):
                table = ear.predictor.path_table(self.world, index)
                paths, gain, way = table.paths, table.gain, table.way
                straight = (paths.faces < 0).all(axis=1) & (gain != 0)
                straight &= np.isin(np.arange(len(gain)), paths.crossing_path)
                ends = (self.world.radios[name].antenna for name in ear.predictor.links[index])
                free = fields.free_space(way, straight, *ends, self.world.carrier_hz)
                found.append(db_from_amplitude(free) - db_from_amplitude(gain[straight]))
        found = np.concatenate(found) if found else np.zeros(0)
        return float(np.mean(found[np.isfinite(found)])) if np.isfinite(found).any() else 0.0

    def diffraction_gain_db(self, effect) -> float:
        """The strongest diffracted path over free space of the same length."""
        best = -200.0
        for ear in self.ears:
            for index in range(len(ear.predictor.links)):
                bent = ear.predictor.bent(self.world, index)
                if len(bent.gain):
                    free = self.world.wavelength_m / (4 * np.pi * bent.length_m)
                    best = max(best, float(db_from_amplitude(np.abs(bent.gain) / free).max()))
        return best

    def sheets(self):
        return planes.sheets(self)

    def gaps(self):
        return planes.gaps(self)

    def ended(self, effect):
        """An added plane with the ends that explain most: the model's own, or one more on thinned soundings."""
        own = self.model.effects
        ears, effects = (self.ears, own) if effect in own else (self.thin, (*own, effect))
        return extents.ended(ears, self.model.base, effects, effects.index(effect), self.bounds_m)

    def lone_sheets(self):
        """Planes that one link alone tells of, and a look at that link."""
        link, sheets = planes.lone(self)
        ears = [of_links(self.wideband[0][0], (link,))] if sheets else []
        return sheets, View(ears, evaluated(ears, self.model.base, self.model.effects), self.unknown)

    @cached_property
    def legs(self):
        return shades.legs(self)

    def shades(self):
        return shades.shades(self)

    def sided(self, effect):
        """Boxes that block what one that sends nothing back blocks, with sides where echoes have them, and what they are made
        of."""
        return sides.sides(self.among(effect), effect.choice, shades.Ways.of(self))

    def shaded(self, effect) -> np.ndarray:
        """Points (n, 3) on the legs that an added object stands in the way of."""
        return shades.shaded(self, effect)

    def passers(self, height_m: float, hiding):
        return tracks.passers(self, height_m, hiding)

    def passers_again(self, height_m: float, place_m: np.ndarray, velocity: np.ndarray, radii_m):
        return tracks.again(self, height_m, place_m, velocity, radii_m)

    def eclipses(self):
        """Lines of bodies that hide what is missing."""
        return eclipses.lines(eclipses.Hidden.of(self))

    def lit(self, effect):
        return planes.lit(self, effect)
