"""The window's content: words above and below, the section between them. Drawn in memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pygame

from baselines.play.game import Game
from baselines.play.session import Phase
from retract_env.drawing.lettering import Lettering
from retract_env.drawing.palette import GREY, GROUND, HATCH, INK, LIMIT, SIGHT, VALUE, rgb
from retract_env.drawing.renderer import SectionRenderer, laid_out
from retract_env.grasp import Array
from retract_env.mesh import SectionMesh
from retract_env.physics.base import TissueState
from retract_env.scene import Scene
from retract_env.task.rest import rest_mesh, rest_state

SIZE = (960, 720)
"""px"""
HEAD, FOOT = 104, 52
"""px, heights of the words above and below"""
PICTURE = (SIZE[0], SIZE[1] - HEAD - FOOT)
MARGIN = 18
"""px"""
SLOW_BELOW = 25.0
"""frames/s below which it is said how many there are"""


class Screen:
    """Draws a game on a surface of SIZE."""

    def __init__(self, surface: pygame.Surface):
        """surface: of SIZE; drawn on in place."""
        self.surface = surface
        self._large, self._usual = (Lettering(surface, size) for size in (30, 21))
        self._drawn: tuple[Scene, SectionMesh, SectionRenderer] | None = None
        self._at_rest: tuple[Scene, SectionMesh] | None = None

    def draw(self, game: Game, has_pad: bool = False, frames: float = 30.0) -> None:
        """The game as it stands; frames: a second, at present."""
        scene, section, state = self._state(game)
        if self._drawn is None or self._drawn[0] is not scene or self._drawn[1] is not section:
            self._drawn = scene, section, SectionRenderer(scene, section, PICTURE)
        history = game.session.env.episode.history[:-1] if game.session.phase is not Phase.GRASP else []
        frame = self._drawn[2].draw(state, history)
        picture = pygame.image.frombuffer(frame.tobytes(), PICTURE, "RGB")
        self.surface.blit(picture, (0, HEAD))
        self._write(game, has_pad, frames)

    def _state(self, game: Game) -> tuple[Scene, SectionMesh, TissueState]:
        """What is shown: the flap as it is, or at rest with the jaws where they would close."""
        session = game.session
        scene, now = game.dealt.scene, session.env.episode.now
        if now.holding:
            return scene, now.section, now.state
        if self._at_rest is None or self._at_rest[0] is not scene:
            self._at_rest = scene, rest_mesh(scene)
        grasp, height = session.proposed, scene.tissue.height
        in_by = grasp.compression / 2
        jaws = np.array([grasp.x, in_by, grasp.x, height - in_by])
        section = self._at_rest[1]
        return scene, section, replace(rest_state(scene, section), jaws=jaws)

    def _write(self, game: Game, has_pad: bool, frames: float) -> None:
        surface, lines, width = self.surface, game.lines, SIZE[0]
        foot = SIZE[1] - FOOT
        surface.fill((255, 255, 255), (0, 0, width, HEAD))
        surface.fill(rgb(GROUND), (0, foot, width, FOOT))
        for row in (HEAD - 1, foot):
            surface.fill(rgb(HATCH), (0, row, width, 1))
        slow = f"{frames:.0f} frames/s     " if frames < SLOW_BELOW else ""
        keys = lines.keys
        if has_pad:
            keys = "     ".join(part for part in keys if part), lines.pad
        colour = {None: INK, True: SIGHT, False: LIMIT}[lines.good]
        for text, letters, row, shade in (
            (lines.headline, self._large, 25, colour),
            (lines.detail, self._usual, 56, INK),
            (lines.comparison, self._usual, 82, VALUE),
            (keys[0], self._usual, foot + 16, INK),
            (keys[1], self._usual, foot + 37, INK),
        ):
            if text:  # pygame shrinks no empty picture
                letters.write(text, MARGIN, row, shade)
        self._usual.write(f"{slow}{lines.scene}", width - MARGIN, 25, GREY, align=1.0)

    @staticmethod
    def to_metres(scene: Scene, place: tuple[int, int]) -> Array:
        """(2,) m, in the section, of a place in the window, px."""
        view, *_ = laid_out(scene, PICTURE)
        x, y = place[0], place[1] - HEAD
        return np.array([x / view.scale + view.left, (view.bed - y) / view.scale])

    @staticmethod
    def to_pixels(scene: Scene, x: float, y: float) -> tuple[int, int]:
        """The inverse, to whole pixels."""
        view, *_ = laid_out(scene, PICTURE)
        column, row = view((x, y))
        return round(column), round(row) + HEAD
