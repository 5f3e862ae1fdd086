"""The colours of every picture: of the parts, by name, and of strain, by a table."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""Red, green, blue, each 0 to 255."""
Bytes = NDArray[np.uint8]

# Okabe and Ito's colours, which every kind of colour vision tells apart.
WHITE, INK, GREY, STEEL = "#ffffff", "#22282e", "#6d757d", "#39444f"
TISSUE, VEIN, VEIN_EDGE = "#f7e1d3", "#9fcdea", "#1b3a5c"
SIGHT, VALUE, LIMIT = "#00805f", "#0072b2", "#d55e00"
GROUND, HATCH, HIDDEN, WEDGE = "#eceef0", "#c9ced3", "#c7ccd1", "#e3f1ec"
SEEN_BED, UNSEEN_BED, WALL = "#a8dcc6", "#f2c6a6", "#d3d8dd"
"""In space: the area of interest in view and out of it, and the block that holds the fixed end."""
METHODS = (GREY, VALUE, "#7f5da8", "#009e73", "#c874a3")
"""Of plans or methods that are compared, in turn: 3:1 or more against the page's cards, light and dark."""
HIDDEN_VEIL = "#b4bbc2", 0.75
"""Colour and opacity of HIDDEN where what lies behind shows through: over white it is HIDDEN."""
PALE_VALUE = "#b9d3e6"
"""VALUE for what is still to come."""


@cache
def rgb(colour: str) -> Colour:
    """The colour written as "#rrggbb"."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


# matplotlib's magma_r from 0.02 to 0.86, in 256 steps: perceptually uniform, pale when relaxed, dark at the
# limit. Written out, because drawing a frame must not need matplotlib.
_STRAIN = (
    "fcf4b6fcf4b6fcf2b4fcf0b2fceeb0fcecaefdebacfde9aafde9aafde7a9fde5a7fde3a5fde2a3fde0a1fde0a1fddea0"
    "fddc9efdda9cfed89afed799fed799fed597fed395fed194fecf92fecd90fecc8ffecc8ffeca8dfec88cfec68afec488"
    "fec287fec287fec185febf84febd82febb81feb97ffeb77efeb77efeb67cfeb47bfeb27afeb078feae77feae77feac76"
    "feaa74fea973fea772fea571fea571fea36ffea16efe9f6dfe9d6cfd9b6bfd9a6afd9a6afd9869fd9668fd9467fd9266"
    "fc9065fc9065fc8e64fc8c63fc8a62fc8961fb8761fb8761fb8560fb835ffa815ffa7f5efa7d5ef97b5df97b5df9795d"
    "f9785df8765cf8745cf7725cf7725cf7705cf66e5cf66c5cf56b5cf4695cf4675cf4675cf3655cf2645cf2625df1605d"
    "f05f5ef05f5eef5d5eee5b5eed5a5fec5860eb5760eb5760ea5661e95462e85362e75263e55064e44f64e44f64e34e65"
    "e24d66e04c67df4a68de4968de4968dc4869db476ad9466bd8456cd6456cd5446dd5446dd3436ed2426fd0416fcf4070"
    "cd4071cd4071cc3f71ca3e72c83e73c73d73c53c74c53c74c43c75c23b75c03a76bf3a77bd3977bc3978bc3978ba3878"
    "b83779b73779b5367ab3367ab3367ab2357bb0357bae347bad347cab337cab337caa337da8327da6317da5317ea3307e"
    "a1307ea1307ea02f7f9e2f7f9c2e7f9b2e7f992d80992d80982d80962c80942c80932b80912b81902a81902a818e2a81"
    "8c29818b29818928818827818827818627818426818326818125818025828025827e24827c23827b2382792282782281"
    "762181762181752181732081721f81701f816e1e816e1e816d1d816b1d816a1c81681c81671b80671b80651a80641a80"
    "6219806018805f187f5d177f5d177f5c167f5a167e59157e57157e56147d56147d54137d52137c51127c4f127b4e117b"
    "4c117a4c117a4a1079491078471078451077440f76440f76420f75400f743f0f723d0f713b0f703b0f70390f6e38106c"
    "36106b3410693310673111653111652f11632d11612c115f2a115c29115a29115a27125825125524125322115021114e"
)
STRAIN: Bytes = np.frombuffer(bytes.fromhex(_STRAIN), dtype=np.uint8).reshape(-1, 3)
"""(256, 3) colours of strain from 0 to its limit, read-only."""
