"""The flap as a planar rod, shear-flexible and geometrically exact: sections, grip, equilibrium, what is
measured.

`mechanics` is the problem as in a textbook, `chain` and `equilibrium` solve it for many rods side by side,
`flap` makes two chains of a flap between jaws, `grip` says what the jaws do to the tissue between them, and
`block` is what environments and planners step.
"""

from retract_env.compilation import forget_old

forget_old()
