"""Evidence that the equations are solved right, number by number."""
