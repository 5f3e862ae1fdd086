"""Pictures of an episode: frames, small images, a window. pygame is imported when the first is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from retract_env.task.rest import rest_mesh, rest_state

if TYPE_CHECKING:
    from retract_env.drawing.renderer import SectionRenderer, Window
    from retract_env.drawing.space import SpaceRenderer
    from retract_env.mesh import SectionMesh
    from retract_env.physics.base import TissueState
    from retract_env.scene import Scene
    from retract_env.task.episode import Episode

    Renderer = SectionRenderer | SpaceRenderer

Bytes = NDArray[np.uint8]

CAMERAS = ("section", "3d")
"""What frames can show."""
VIEWS = ("section", "camera")
"""What images that are observations can show."""
FRAME = (640, 480)
"""px, width and height of a frame."""
PIXELS = (96, 96)
"""px, width and height of an image that is an observation."""


class Stage:
    """Draws the episodes of one environment, and keeps the last renderers and the last flap at rest.

    A copy of it, also a pickled one, is as good and begins with neither, and without a window.
    """

    def __init__(self, camera: str, view: str, fps: float):
        """camera: of `CAMERAS`; view: of `VIEWS`."""
        self.camera, self.view, self.fps = camera, view, fps
        self._kept: tuple[Scene, SectionMesh] | None = None
        self._renderers: dict[bool, Renderer] = {}
        """for what is `_kept`: in space, or not"""
        self._at_rest: tuple[Scene, SectionMesh] | None = None
        self._window: Window | None = None

    def frame(self, episode: Episode) -> Bytes:
        """(h, w, 3) of the state now, with the curves of the episode so far."""
        renderer, state = self._drawn(episode, self.camera == "3d")
        return renderer.draw(state, episode.history[:-1])

    def pixels(self, episode: Episode) -> Bytes:
        """(h, w, 3) small image of the state now."""
        renderer, state = self._drawn(episode, self.view == "camera")
        return renderer.pixels(state, PIXELS)

    def show(self, episode: Episode) -> None:
        """Show a frame in the window. Raises pygame.error where there is no screen."""
        from retract_env.drawing.renderer import Window

        if self._window is None:
            self._window = Window(FRAME, self.fps)
        self._window.show(self.frame(episode))

    def close(self) -> None:
        """Close the window and forget the rest; drawing again begins anew."""
        self._forget()
        self._at_rest = None
        if self._window is not None:
            self._window.close()
            self._window = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_kept": None, "_renderers": {}, "_at_rest": None, "_window": None}

    def _forget(self) -> None:
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        self._kept = None

    def _rest_mesh(self, scene: Scene) -> SectionMesh:
        if self._at_rest is None or self._at_rest[0] != scene:
            self._at_rest = scene, rest_mesh(scene)
        return self._at_rest[1]

    def _drawn(self, episode: Episode, in_space: bool) -> tuple[Renderer, TissueState]:
        """The renderer of the mesh as it is now, and the state on it."""
        scene, now = episode.task.scene, episode.now
        section = now.section if now.holding else self._rest_mesh(scene)
        if self._kept is None or self._kept[0] is not scene or self._kept[1] is not section:
            self._forget()
            self._kept = scene, section
        if in_space not in self._renderers:
            self._renderers[in_space] = _renderer(in_space)(scene, section, FRAME)
        return self._renderers[in_space], now.state if now.holding else rest_state(scene, section)


def _renderer(in_space: bool) -> type[Renderer]:
    if in_space:
        from retract_env.drawing.space import SpaceRenderer

        return SpaceRenderer
    from retract_env.drawing.renderer import SectionRenderer

    return SectionRenderer
