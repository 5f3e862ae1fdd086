"""How a flap between two jaws behaves: by finite elements, or as a soft body of PyBullet."""
