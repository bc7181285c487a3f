# SPDX-License-Identifier: GPL-3.0-or-later
"""What is measured stays as it was: values of these rooms are frozen, and made by names, so that none takes another's place."""

import dataclasses
import importlib
import pkgutil

import pytest


def dataclasses_of(room):
    names = [f"gr_cast.{room}"]
    package = importlib.import_module(names[0])
    if hasattr(package, "__path__"):
        names += [module.name for module in pkgutil.walk_packages(package.__path__, f"{names[0]}.")]
    for name in names:
        for found in vars(importlib.import_module(name)).values():
            if dataclasses.is_dataclass(found) and isinstance(found, type) and found.__module__ == name:
                yield found


@pytest.mark.parametrize("room", ["signals", "scenario", "emulation", "sounding", "comparing", "twin.playback"])
def test_values_are_frozen_and_made_by_names(room):
    found = list(dataclasses_of(room))
    assert found
    for made in found:
        assert made.__dataclass_params__.frozen, made
        assert all(field.kw_only for field in dataclasses.fields(made)), made
