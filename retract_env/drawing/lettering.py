"""Text on pictures."""

from __future__ import annotations

import pygame

from retract_env.drawing.palette import INK, rgb

FINER = 4
"""Letters are drawn this many times as large and then shrunk: pygame fits small letters to whole pixels,
which spaces them unevenly."""


class Lettering:
    """Writes on a surface, and remembers what it has written: rendering text takes longer than copying it."""

    KEPT = 512

    def __init__(self, surface: pygame.Surface, size: float):
        """surface: written on in place; size: px, height of a line."""
        pygame.font.init()
        self._surface = surface
        # pygame's own typeface: what a system has installed differs
        self._font = pygame.font.Font(None, round(size * FINER))
        self._known: dict[tuple[str, str, float], pygame.Surface] = {}

    def write(
        self,
        text: str,
        x: float,
        y: float,
        colour: str = INK,
        align: float = 0.0,
        plate: str | None = None,
        turn: float = 0.0,
    ) -> float:
        """Text with its middle at height y and x at its left (align 0), middle (0.5) or right (1).

        Returns its width, px. plate: colour behind the text; turn: degrees counter-clockwise.
        """
        if (text, colour, turn) not in self._known:
            if len(self._known) >= self.KEPT:
                self._known.clear()
            self._known[text, colour, turn] = self._render(text, colour, turn)
        drawn = self._known[text, colour, turn]
        width, height = drawn.get_size()
        place = pygame.Rect(round(x - align * width), round(y - height / 2), width, height)
        if plate is not None:
            self._surface.fill(rgb(plate), place.inflate(6, 2))
        self._surface.blit(drawn, place)
        return float(width)

    def _render(self, text: str, colour: str, turn: float) -> pygame.Surface:
        large = self._font.render(text, True, rgb(colour))
        if turn:
            large = pygame.transform.rotate(large, turn)
        width, height = large.get_size()
        return pygame.transform.smoothscale(large, (max(width // FINER, 1), max(height // FINER, 1)))
