"""The flap's section as a mesh: how fine, where the jaws sit, which outlines it follows."""

from retract_env.mesh.jaws import SLIVER, jaw_range, patch_ends
from retract_env.mesh.resolutions import RESOLUTIONS, Resolution
from retract_env.mesh.section import SectionMesh, quadratic_shares, section_mesh

__all__ = [
    "RESOLUTIONS",
    "SLIVER",
    "Resolution",
    "SectionMesh",
    "jaw_range",
    "patch_ends",
    "quadratic_shares",
    "section_mesh",
]
