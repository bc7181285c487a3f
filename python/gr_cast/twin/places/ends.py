# SPDX-License-Identifier: GPL-3.0-or-later
"""Both ends of a sounding's links, worked out once for all worlds that have the same radios."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .remembered import remembered
from .world import Radio, interned


@dataclass(frozen=True, eq=False, kw_only=True)
class Ends:
    """Of `links` (tx, rx names) between `radios` at `time_s` (T,) and `frequency_hz` (K,); nodes that were `tracked`,
    name → (T, 3), are there and not where their SPEC has them. Places of nodes that are `known` are not worked out again."""

    radios: Mapping[str, Radio]
    links: Sequence[tuple[str, str]]
    time_s: np.ndarray
    frequency_hz: np.ndarray
    tracked: Mapping[str, np.ndarray]
    known: OrderedDict

    @cached_property
    def track_keys(self) -> list[int]:
        """Of each link: which one it is, and where its ends are over time."""
        return [interned((index, *(one.track_key for one in pair))) for index, pair in enumerate(self._pairs)]

    @cached_property
    def keys(self) -> list[int]:
        """Of each link: which one it is, and what paths' gains depend on at its ends."""
        return [interned((index, *(one.end_key for one in pair))) for index, pair in enumerate(self._pairs)]

    @cached_property
    def _pairs(self) -> list[tuple[Radio, Radio]]:
        return [(self.radios[tx], self.radios[rx]) for tx, rx in self.links]

    @cached_property
    def at_m(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Both ends (P, 3) of each link at all instants, or at one where nothing moves."""
        names = sorted({name for link in self.links for name in link})
        keys = [(name, self.radios[name].track_key) for name in names]
        places_m = remembered(self.known, keys, lambda missing: [self._node_m(self.radios[names[one]]) for one in missing])
        nodes = dict(zip(names, places_m, strict=True))
        many = [max(len(nodes[name]) for name in link) for link in self.links]
        return [tuple(_at_each(nodes[name], n) for name in link) for n, link in zip(many, self.links, strict=True)]

    @cached_property
    def at_each_m(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Both ends (T, 3) of each link."""
        return [tuple(_at_each(end_m, len(self.time_s)) for end_m in pair) for pair in self.at_m]

    def at_all_instants_m(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Both ends (n, 3) of links one after the other, at all instants of each."""
        return tuple(np.concatenate([self.at_each_m[index][side] for index in which]) for side in (0, 1))

    def _node_m(self, radio: Radio) -> np.ndarray:
        if radio.node.name in self.tracked:
            return self.tracked[radio.node.name] + np.array(radio.offset_m)
        return radio.position_m(self.time_s)

    def joined_m(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray, list[int]]:
        """Ends (P, 3) of links one after the other, and how many pairs each has."""
        if list(which) == list(range(len(self.links))):
            return self._all_m
        return self._joined_m(which)

    @cached_property
    def _all_m(self) -> tuple[np.ndarray, np.ndarray, list[int]]:
        return self._joined_m(range(len(self.links)))

    def _joined_m(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray, list[int]]:
        tx_m, rx_m = (np.concatenate([self.at_m[index][side] for index in which]) for side in (0, 1))
        return tx_m, rx_m, [len(self.at_m[index][0]) for index in which]

    @cached_property
    def gains_db(self) -> np.ndarray:
        """(L,) of both ends of each link."""
        return np.array([tx.gain_db + rx.gain_db for tx, rx in self._pairs])

    @cached_property
    def cables(self) -> np.ndarray:
        """(L, K) what both ends' cables do to a response, its strength aside."""
        delays_s = np.array([tx.delay_s + rx.delay_s for tx, rx in self._pairs])
        return np.exp(-2j * np.pi * self.frequency_hz * delays_s[:, None])


def _at_each(place_m: np.ndarray, instants: int) -> np.ndarray:
    return place_m if len(place_m) == instants else np.broadcast_to(place_m, (instants, 3))
