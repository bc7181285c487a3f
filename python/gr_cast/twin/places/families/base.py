# SPDX-License-Identifier: GPL-3.0-or-later
"""What the engine may ask of a family of place effects. A family is one class."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..world import World


@dataclass(frozen=True, eq=False, kw_only=True)
class Effect:
    """A family's physics with its numbers: `owner` is a name of its level, `choice` what it names (a pattern, a geometry)."""

    family: "Family"
    owner: str
    values: np.ndarray
    choice: object = None

    def moved(self, values: np.ndarray) -> "Effect":
        values = self.family.bounded(np.asarray(values, float))
        return Effect(family=self.family, owner=self.owner, values=values, choice=self.choice)

    @property
    def key(self) -> tuple:
        return self.family.name, self.owner


class Family:
    """Base of all families."""

    name = ""
    level = "place"
    order = 5  # of application: lower first
    price_nats = 0.0  # of what it may name beside its numbers
    is_flexible = False  # explains much that it is not: asked only where nothing else explains a good part
    is_wide = False  # looked for all over the place, which takes most of the time
    is_like_wide = False  # of a place, and still what is wide may look like it
    ranks_unfitted = True  # its first guesses are near enough to be told apart before they are fitted
    shows_in_power = False  # also where received power is all there is
    shape_axes = 0  # along which it is looked for what its numbers do not say
    lasts = True  # what it changes is there on another day, at another position
    has_ways = False  # of many to go, of which others explain nearly as much as the right one
    is_in_spec = True  # a SPEC has keys for it; what has none stands in its `effects`

    def told_numbers(self, effect: Effect) -> int:
        """How many of an effect's numbers soundings say anything of."""
        return len(effect.values)

    def is_negligible(self, effect: Effect) -> bool:
        """Whether it is less than any twin claims to know: what explains something by so little is no cause."""
        return False

    def owners(self, view) -> Sequence[str]:
        """Names that may have it, those that the soundings can see alone."""
        raise NotImplementedError

    def starts(self, view, owner: str) -> list[Effect]:
        """First guesses, few; the engine compares their energies and fits the best."""
        raise NotImplementedError

    def restarts(self, world: World, effect: Effect) -> list[Effect]:
        """Other beginnings once an effect is fitted, where one number decides which minimum another falls into."""
        return []

    def again(self, view, effect: Effect) -> list[Effect]:
        """Of a family that `has_ways`, others than an effect of the model goes, as they look with what is unknown fitted beside
        it; none of them fitted."""
        return []

    def wells(self, world: World, effect: Effect) -> list[Effect]:
        """Beginnings in the next wells of its phase, and in those behind them."""
        return self.restarts(world, effect)

    def is_same_way(self, world: World, effect: Effect, other: Effect, span_s: tuple[float, float]) -> bool:
        """Whether two effects of a family that `has_ways` go the same one from the first to the last of these times."""
        raise NotImplementedError

    def kin(self, world: World, effect: Effect) -> list[Effect]:
        """The same of what its owner is a part of, and of that one's parts."""
        return []

    def choices(self, world: World, effect: Effect) -> list[Effect]:
        """The same numbers, what none of them says chosen otherwise, where energy goes in steps: many, none of them fitted."""
        return []

    def ended(self, view, effect: Effect) -> Effect:
        """An effect of the model with what it adds no larger and no smaller than explains most."""
        return effect

    def reshaped(self, world: World, effect: Effect, axis: int) -> list[Effect]:
        """The same with another shape along one of its `shape_axes`."""
        return []

    def smaller(self, view, effect: Effect, axis: int) -> list[Effect]:
        """The same no larger along an axis than the soundings lit it and what such a thing may be beyond; then less and less."""
        return []

    def sizes(self, view, effect: Effect) -> tuple[Effect, Effect]:
        """The same as small, and as large, as the soundings leave it open to be."""
        return effect, effect

    def covers(self, world: World, effect: Effect, rival: Effect) -> bool:
        """Whether a rival says by more numbers what this effect says, and would be no more than chance: an object that is gone,
        moved out of sight or as rough or as thin as air."""
        same = rival.owner == effect.owner or effect.owner in [world.mesh.names[one] for one in world.made_of(rival.owner)]
        return same and not len(effect.values) and len(rival.values) > 0

    def beside(self, world: World, effect: Effect) -> list[Effect]:
        """The same a little beside where it is, along what none of its numbers says: soundings may not tell of that."""
        return []

    def images_moved_m(self, effect: Effect) -> np.ndarray | None:
        """(3,) by which it moves the mirror images of nodes, where it moves any: all that moves these alike looks the same where
        nothing but one mirror's echoes are heard."""
        return None

    def moving_images(self, view, shift_m: np.ndarray) -> list[Effect]:
        """Effects of this family that move mirror images by (3,)."""
        return []

    def plainer(self, span_s: tuple[float, float], effect: Effect) -> list[Effect]:
        """The same without what sets the family apart, from several beginnings, heard over `span_s`: what any of
        these explains is not its own."""
        return []

    def apply(self, world: World, effect: Effect) -> World:
        raise NotImplementedError

    def steps(self, world: World, effect: Effect) -> np.ndarray:
        """Steps of numerical derivatives, one per number."""
        return np.full(len(effect.values), 1e-6)

    def bounded(self, values: np.ndarray) -> np.ndarray:
        return values

    def besides(self, view, effect: Effect) -> np.ndarray:
        """Covariance of what more is open of its numbers where something is left that nobody named, another way does too, or the
        vault speaks against the way it goes."""
        return np.zeros((len(effect.values),) * 2)

    def told(self, view, effect: Effect, covariance: np.ndarray) -> dict:
        """`parameters` of the contract: name → {value, std}; `view` has the world with all effects."""
        raise NotImplementedError

    def level_of(self, world: World, owner: str) -> str:
        """The contract's word for what kind of thing the owner is."""
        return self.level

    def extent_m(self, view, effect: Effect) -> list | None:
        """[[lo], [hi]] of the box that holds it, where it has a place of its own."""
        return None

    def is_one_with(self, view, effect: Effect, other: Effect) -> bool:
        """Whether both are of one thing that was found in pieces."""
        return False

    def is_telling(self, view, effect: Effect) -> bool:
        """Whether the numbers of this piece say where the thing is."""
        return True

    def sentence(self, effect: Effect, told: dict) -> str:
        raise NotImplementedError


SURVEYED_M = 2e-4  # within which no mesh is drawn and no node surveyed


class OfThings(Family):
    """Of an object, of all of a material, or of all in the place."""

    def level_of(self, world, owner):
        return world.level_of(owner)


def value(number, std=None) -> dict:
    """One parameter of the contract, a number or three."""
    plain = lambda v: [float(x) for x in v] if np.ndim(v) else float(v)  # noqa: E731
    return {"value": plain(number)} | ({} if std is None else {"std": plain(std)})


def std_of(covariance: np.ndarray, number: int) -> float:
    return float(np.sqrt(max(covariance[number, number], 0.0)))
