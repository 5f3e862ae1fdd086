"""`fem_gradient`: grip and path of least strain by the derivatives of the finite elements."""
