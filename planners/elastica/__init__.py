"""`elastica`: a nonlinear program over a rod, its optimum corrected on finite elements."""
