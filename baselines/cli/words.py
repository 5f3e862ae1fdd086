"""What the console calls things."""

FAILS = {
    "not_visible": "tissue stays below the line of sight",
    "strain": "too much strain",
    "slip": "a jaw slips",
    "release": "a jaw lets go",
    "contact": "tissue runs into itself or into the block that holds the fixed end",
    "torn": "tissue is stretched more than threefold somewhere, and no equilibrium was found",
    "diverged": "no equilibrium was found",
    "undecided": "not decided, which counts as failing",
}
"""Why a retraction is not certified, by the certificate's name for it."""
SHORT = {"ok": "certified", "not_visible": "not visible"}
"""What became of a candidate, in a table; other reasons are said as they are."""
UNKNOWN = {
    "modulus": "stiffness of the flap",
    "vein_modulus": "stiffness of the veins",
    "poisson": "compressibility of the flap",
    "weight": "weight of the flap",
    "thickness": "thickness of the flap",
    "friction": "friction of the jaws",
    "grasp": "place of the grasp",
    "closing": "closing of the jaws",
    "force": "force of the grip",
    "jaw_width": "width of the jaws",
    "target": "place of the target",
}
"""What may be unknown, by the scene's name for it."""
