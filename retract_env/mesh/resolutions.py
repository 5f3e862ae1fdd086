"""How fine the finite elements are, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Resolution:
    """Sizes of the elements, as fractions of what they resolve."""

    name: str
    patch: int
    """elements along a jaw patch"""
    edge: float
    """size of the elements at the patch's ends, where stress is singular, over the patch's width"""
    growth: float
    """how fast elements grow away from the patches, per unit length"""
    bulk: float
    """largest element over the flap's height"""
    bed: float = 5.0
    """stiffness of the bed per area, in E / h of the tissue: a soft one is found sooner, and strain and
    friction stay the same in five digits from 0.3 to 50"""
    layers: float = 0.8
    """layers over the depth of a deep flap under narrow jaws, for each height of depth; half as many where
    the jaws hold the whole depth"""
    vein_corners: int | None = None
    """corners at most of a vein away from the jaws, whose edges decide how many elements there are; None: as
    drawn"""
    true_veins: float = -math.inf
    """how far from the jaws veins are as drawn, over the flap's height; -inf: not even between them"""
    followed: float = math.inf
    """how far from the jaws elements follow veins, over the flap's height; others are averages in them"""


RESOLUTIONS = {
    "coarse": Resolution(
        "coarse", patch=2, edge=0.2, growth=0.7, bulk=1.0, bed=0.3, layers=0.4, vein_corners=4, followed=0.0
    ),
    "medium": Resolution(
        "medium",
        patch=4,
        edge=0.15,
        growth=0.6,
        bulk=0.8,
        bed=1.0,
        layers=0.8,
        vein_corners=5,
        true_veins=1.0,
    ),
    "fine": Resolution("fine", patch=8, edge=0.08, growth=0.3, bulk=0.6, vein_corners=5, true_veins=1.0),
    "finer": Resolution("finer", patch=12, edge=0.08, growth=0.25, bulk=0.3, layers=1.6),
}
"""Certificates come from "fine": within 2 % of converged strain, 5 % of converged jaw forces
(benchmarks/accuracy.py)."""
