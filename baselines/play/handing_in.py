"""What was played as a plan that the certifier can judge: the grasp, and the way of the jaws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from retract_env.grasp import Grasp, JawPath, to_jaws
from retract_env.task.episode import Episode

Array = NDArray[np.float64]

OFF = 1e-5
"""m, by how much a jaw may be off from where it was at any of the waypoints that are left out: half of how
closely the certifier meets the moment of visibility."""
LEAD = 6e-3
"""m, how far the motion goes on as it ended: the finite elements may see the target later than the rod did,
and stop as soon as they do. The benchmark's policies are led on by three moves of 2 mm."""
LAST = 1e-3
"""m, what of the motion tells how it ended."""
KIND = "played"


def handed_in(episode: Episode, success: bool) -> tuple[Grasp, JawPath] | None:
    """Grasp and path of an episode; None where the jaws never closed. What succeeded is led on by LEAD."""
    grasp, path = episode.grasp, episode.path
    if grasp is None or path is None:
        return None
    poses = path.poses.copy()
    # as the grasp says, even where a limit broke while the jaws closed
    poses[1, 3] = episode.task.scene.tissue.height - grasp.compression
    moved = thinned(poses[1:])
    if success:
        moved = led_on(poses[1:], moved)
    return grasp, JawPath.from_poses(np.concatenate([poses[:1], moved]), KIND)


def thinned(poses: Array) -> Array:
    """Poses (k, 4) of (n, 4) between which the jaws go as they went, to within OFF (Douglas and Peucker).

    A frame's move is a fraction of what an increment of the certifier needs to be.
    """
    keep = np.zeros(len(poses), bool)
    keep[[0, -1]] = True
    waiting = [(0, len(poses) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        off = _off(poses[first : last + 1])
        worst = int(off.argmax())
        if off[worst] > OFF:
            keep[first + 1 + worst] = True
            waiting += [(first, first + 1 + worst), (first + 1 + worst, last)]
    return poses[keep]


def _off(poses: Array) -> Array:
    """(n - 2,) m, how far the jaws are at each pose between the ends of (n, 4) from a straight change of pose
    between these."""
    arm = poses[0, 3] / 2  # a turn moves a jaw by that
    flat = poses[:, :3] * (1.0, 1.0, arm)
    way = flat[-1] - flat[0]
    share = ((flat[1:-1] - flat[0]) @ way / max(float(way @ way), 1e-30)).clip(0.0, 1.0)
    straight = poses[0] + share[:, None] * (poses[-1] - poses[0])
    apart = (to_jaws(straight) - to_jaws(poses[1:-1])).reshape(-1, 2, 2)
    found: Array = np.hypot(apart[..., 0], apart[..., 1]).max(axis=1)
    return found


def led_on(poses: Array, kept: Array) -> Array:
    """`kept`, of the poses (n, 4), and LEAD more in the direction in which the jaws went last."""
    jaws = to_jaws(poses).reshape(-1, 2, 2)
    away = np.linalg.norm(jaws - jaws[-1], axis=2).max(axis=1)
    far = np.flatnonzero(away >= LAST)
    if len(far) == 0:
        return kept
    before = far[-1]
    change = (poses[-1] - poses[before]) / away[before]
    more = poses[-1] + np.linspace(0.0, LEAD, 4)[1:, None] * change
    return np.concatenate([kept, more])
