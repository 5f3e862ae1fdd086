"""Pictures of an episode: frames, small images, a window. pygame is imported when the first is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from retract_env.task.rest import rest_mesh, rest_state

if TYPE_CHECKING:
    from retract_env.drawing.renderer import SectionRenderer, Window
    from retract_env.mesh import SectionMesh
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene
    from retract_env.task.episode import Episode

Bytes = NDArray[np.uint8]

FRAME = (640, 480)
"""px, width and height of a frame."""
PIXELS = (96, 96)
"""px, width and height of an image that is an observation."""


class Stage:
    """Draws the episodes of one environment, and keeps the last renderer and the last flap at rest.

    A copy of it, also a pickled one, is as good and begins with neither, and without a window.
    """

    def __init__(self, camera: str, fps: float):
        """camera: "section", or "3d" for Bullet's own picture, which begins when the jaws have closed."""
        self.camera, self.fps = camera, fps
        self._kept: tuple[Scene, SectionMesh, SectionRenderer] | None = None
        self._at_rest: tuple[Scene, SectionMesh] | None = None
        self._window: Window | None = None

    def frame(self, episode: Episode) -> Bytes:
        """(h, w, 3) of the state now, with the curves of the episode so far."""
        physics: Any = episode.physics
        if self.camera == "3d" and physics is not None:
            picture: Bytes = physics.render_3d(*FRAME)
            return picture
        renderer, state = self._drawn(episode)
        return renderer.draw(state, episode.history[:-1])

    def pixels(self, episode: Episode) -> Bytes:
        """(h, w, 3) small image of the state now."""
        renderer, state = self._drawn(episode)
        return renderer.pixels(state, PIXELS)

    def show(self, episode: Episode) -> None:
        """Show a frame in the window. Raises pygame.error where there is no screen."""
        from retract_env.drawing.renderer import Window

        if self._window is None:
            self._window = Window(FRAME, self.fps)
        self._window.show(self.frame(episode))

    def close(self) -> None:
        """Close the window and forget the rest; drawing again begins anew."""
        if self._kept is not None:
            self._kept[2].close()
            self._kept = None
        self._at_rest = None
        if self._window is not None:
            self._window.close()
            self._window = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_kept": None, "_at_rest": None, "_window": None}

    def _rest_mesh(self, scene: Scene) -> SectionMesh:
        if self._at_rest is None or self._at_rest[0] != scene:
            self._at_rest = scene, rest_mesh(scene)
        return self._at_rest[1]

    def _drawn(self, episode: Episode) -> tuple[SectionRenderer, TissueState]:
        """The renderer of the mesh as it is now, and the state on it."""
        from retract_env.drawing.renderer import SectionRenderer

        scene, now = episode.task.scene, episode.now
        section = now.section if now.holding else self._rest_mesh(scene)
        if self._kept is None or self._kept[0] is not scene or self._kept[1] is not section:
            self._kept = scene, section, SectionRenderer(scene, section, FRAME)
        return self._kept[2], now.state if now.holding else rest_state(scene, section)
