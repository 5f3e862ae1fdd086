"""The window of `render_mode="human"`."""

from __future__ import annotations

from typing import ClassVar

import pygame

from retract_env.drawing.palette import Bytes


class Window:
    """Shows frames on the screen, at most `fps` a second. pygame has one window: who shows takes it over."""

    _shown: ClassVar[Window | None] = None
    """whose it is now"""

    def __init__(self, size: tuple[int, int], fps: float, title: str = "tissue retraction"):
        """size: width and height, px. Raises pygame.error where there is no screen."""
        self.size, self.fps, self._title = size, fps, title
        self._take_over()
        self._clock = pygame.time.Clock()
        self._open = True

    def _take_over(self) -> None:
        pygame.display.init()
        self._screen = pygame.display.set_mode(self.size)
        pygame.display.set_caption(self._title)
        Window._shown = self

    @property
    def open(self) -> bool:
        """Whether the user has left it open."""
        return self._open

    def show(self, frame: Bytes) -> bool:
        """Show a frame (h, w, 3) of the window's size and wait for its time; returns whether still open.

        A closed window shows nothing and does not wait. Raises ValueError for another size.
        """
        if frame.shape != (self.size[1], self.size[0], 3):
            raise ValueError(f"frame.shape = {frame.shape}, allowed {(self.size[1], self.size[0], 3)}")
        if not self._open:
            return False
        if Window._shown is not self:
            self._take_over()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return False
        self._screen.blit(pygame.image.frombuffer(frame.tobytes(), self.size, "RGB"), (0, 0))
        pygame.display.flip()
        self._clock.tick(self.fps)
        return True

    def close(self) -> None:
        """Close the window, if it is not another's by now; again does no harm."""
        self._open = False
        if Window._shown is self:
            Window._shown = None
            pygame.display.quit()
