"""From events of keyboard, mouse and gamepad to what a person asks for."""

from __future__ import annotations

import math
from collections.abc import Callable

import pygame

from baselines.play.game import Command, Drive
from baselines.play.session import SLOW
from retract_env.grasp import Array

KEYS = {
    pygame.K_RETURN: Command.CONFIRM,
    pygame.K_KP_ENTER: Command.CONFIRM,
    pygame.K_SPACE: Command.CONFIRM,
    pygame.K_u: Command.UNDO,
    pygame.K_BACKSPACE: Command.UNDO,
    pygame.K_r: Command.RESTART,
    pygame.K_n: Command.NEW,
    pygame.K_ESCAPE: Command.QUIT,
}
BUTTONS = {0: Command.CONFIRM, 1: Command.UNDO, 2: Command.RESTART, 3: Command.NEW, 7: Command.QUIT}
"""A, B, X, Y and start of a gamepad, as SDL numbers them on most."""
SHOULDERS = {4: 1.0, 5: -1.0}
"""Which way the left and the right one turn."""
HELD = {
    pygame.K_LEFT: (-1, 0, 0),
    pygame.K_RIGHT: (1, 0, 0),
    pygame.K_UP: (0, 1, 0),
    pygame.K_DOWN: (0, -1, 0),
    pygame.K_a: (-1, 0, 0),
    pygame.K_d: (1, 0, 0),
    pygame.K_w: (0, 1, 0),
    pygame.K_s: (0, -1, 0),
    pygame.K_q: (0, 0, 1),
    pygame.K_e: (0, 0, -1),
}
"""What a key does while it is held: x, y, turn, counter-clockwise."""
SHIFT = (pygame.K_LSHIFT, pygame.K_RSHIFT)
NOTCH = math.radians(3.0)
"""rad that a notch of the wheel turns by"""
FIRMER = 0.05
"""of the range of grips, from -1 to 1, that a notch of the wheel changes"""
DEAD = 0.15
"""of a stick's way, within which it counts as at rest"""
AGAIN = 0.15
"""s after which a held U takes back another move"""
LEFT_X, LEFT_Y, RIGHT_X, RIGHT_X_LATER = 0, 1, 2, 3
"""Axes of a gamepad, as SDL numbers them. The right stick's is the last where number 2 is a trigger."""
TRIGGER = -0.5
"""Where a trigger is heard of first, or below: it rests at -1, a stick at 0."""


class Controls:
    """What is held now, from the events so far. Nothing is asked of pygame but by its events."""

    def __init__(self, to_metres: Callable[[tuple[int, int]], Array]):
        """to_metres: from a place in the window, px, to one in the section, (2,) m."""
        self._to_metres = to_metres
        self._keys: set[int] = set()
        self._axes: dict[int, float] = {}
        self._right = RIGHT_X_LATER
        self._shoulders: set[int] = set()
        self._turning = 0.0
        self._firmer = 0.0
        self._pointing: tuple[int, int] | None = None
        """where the mouse was moved to in this frame"""
        self._at: tuple[int, int] = (0, 0)
        self._held_at: tuple[int, int] | None = None
        self._offset: Array | None = None
        """m, from the mouse to the jaws' midpoint, while these are dragged"""
        self._back = 0.0
        """s since U was pressed or last counted"""
        self._undoing = False
        self._pads: dict[int, object] = {}

    @property
    def has_pad(self) -> bool:
        """Whether a gamepad is there."""
        return bool(self._pads) or bool(self._axes)

    def read(self, event: pygame.event.Event, choosing: bool) -> Command | None:
        """Take an event in; returns what it asks for at once. choosing: whether the grasp is being chosen,
        where a click confirms."""
        if event.type == pygame.QUIT:
            return Command.QUIT
        if event.type == pygame.KEYDOWN:
            self._keys.add(event.key)
            command = KEYS.get(event.key)
            if command is Command.UNDO:
                self._undoing, self._back = True, -2 * AGAIN
            return command
        if event.type == pygame.KEYUP:
            self._keys.discard(event.key)
            if KEYS.get(event.key) is Command.UNDO:
                self._undoing = False
        elif event.type == pygame.MOUSEMOTION:
            self._at = self._pointing = event.pos
        elif event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
            self._at = event.pos
            if choosing:
                self._pointing = event.pos
                return Command.CONFIRM
            self._held_at, self._offset = event.pos, None
        elif event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self._held_at = self._offset = None
        elif event.type == pygame.MOUSEWHEEL:
            self._turning += event.y * NOTCH
            self._firmer += event.y * FIRMER
        elif event.type == pygame.WINDOWFOCUSLOST:
            self._let_go()
        else:
            return self._read_pad(event)
        return None

    def _read_pad(self, event: pygame.event.Event) -> Command | None:
        if event.type == pygame.JOYDEVICEADDED:
            pad = pygame.joystick.Joystick(event.device_index)
            self._pads[pad.get_instance_id()] = pad  # events come as long as it is kept
        elif event.type == pygame.JOYDEVICEREMOVED:
            self._pads.pop(event.instance_id, None)
            self._axes.clear()
            self._right = RIGHT_X_LATER
            self._shoulders.clear()
        elif event.type == pygame.JOYAXISMOTION:
            if event.axis == RIGHT_X and RIGHT_X not in self._axes:
                self._right = RIGHT_X if event.value > TRIGGER else RIGHT_X_LATER
            self._axes[event.axis] = event.value
        elif event.type == pygame.JOYBUTTONDOWN:
            self._shoulders |= {event.button} & SHOULDERS.keys()
            return BUTTONS.get(event.button)
        elif event.type == pygame.JOYBUTTONUP:
            self._shoulders.discard(event.button)
        return None

    def _let_go(self) -> None:
        """Keys that are released in another window are never heard of."""
        self._keys.clear()
        self._shoulders.clear()
        self._held_at = self._offset = None
        self._undoing = False

    def repeated(self, seconds: float) -> Command | None:
        """UNDO again where its key is held; seconds: since the last frame."""
        if not self._undoing:
            return None
        self._back += seconds
        if self._back < AGAIN:
            return None
        self._back = 0.0
        return Command.UNDO

    def drive(self, pose: Array, turn_speed: float, seconds: float, choosing: bool) -> Drive:
        """What is asked for in this frame.

        pose: (4,) of the jaws now; turn_speed: rad/s of a turn by 1; seconds: that the frame stands for.
        """
        x, y, turn = (sum(HELD[key][axis] for key in self._keys if key in HELD) for axis in range(3))
        sticks = [self._stick(axis) for axis in (LEFT_X, LEFT_Y, self._right)]
        across, up = x + sticks[0], y - sticks[1]
        turned = turn - sticks[2] + sum(SHOULDERS[button] for button in self._shoulders)
        slow = not self._keys.isdisjoint(SHIFT)
        firmer, self._firmer = self._firmer, 0.0
        pointing, self._pointing = self._pointing, None
        if choosing:
            self._turning = 0.0
            place = None if pointing is None else float(self._to_metres(pointing)[0])
            return Drive(_one(across), _one(up), 0.0, slow, None, place, firmer)
        if turned:
            self._turning = 0.0
        elif self._turning:
            reach = turn_speed * (SLOW if slow else 1.0) * seconds
            turned = _one(self._turning / reach)
            self._turning -= turned * reach
        return Drive(_one(across), _one(up), _one(turned), slow, self._dragged(pose))

    def _dragged(self, pose: Array) -> tuple[float, float] | None:
        """m, where the mouse drags the jaws' midpoint to."""
        if self._held_at is None:
            return None
        if self._offset is None:
            self._offset = pose[:2] - self._to_metres(self._held_at)
        x, y = (self._to_metres(self._at) + self._offset).tolist()
        return x, y

    def _stick(self, axis: int) -> float:
        """A stick's way in [-1, 1]; from where it counts, it begins at 0."""
        value = self._axes.get(axis, 0.0)
        return math.copysign(max(0.0, (abs(value) - DEAD) / (1 - DEAD)), value)


def _one(value: float) -> float:
    return min(max(value, -1.0), 1.0)
