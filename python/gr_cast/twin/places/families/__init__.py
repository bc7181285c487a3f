# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics that the twin of a place may leave out, one class each; a new one is a class and its line here."""

from . import additions, mechanisms, nodes, objects, power

FAMILIES = (
    nodes.NodePosition(), nodes.TrackTiming(), nodes.AntennaOrientation(), nodes.AntennaPattern(), nodes.NodeGain(),
    nodes.NodeDelay(), objects.ExtraObject(), objects.ObjectMoved(), objects.Material(), objects.Roughness(),
    mechanisms.MissingReflections(), mechanisms.MissingTransmission(), mechanisms.MissingDiffraction(),
    mechanisms.MissingScattering(), mechanisms.Carrier(), mechanisms.Ground(), mechanisms.ExcessLoss(),
    mechanisms.DistanceLaw(), mechanisms.Attenuation(), additions.MissingObject(), additions.MovingScatterer(),
    power.BodyLoss(), power.SmallScale(), power.MeterLimits(),
)  # fmt: skip
