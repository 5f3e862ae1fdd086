"""The window of render_mode="human", on SDL's driver without a screen."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
import pygame
import pytest

from retract_env.drawing.window import Window


@pytest.fixture
def dummy_window(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Window]]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    opened: list[Window] = []

    def make(size: tuple[int, int] = (64, 48), fps: float = 1000.0) -> Window:
        opened.append(Window(size, fps))
        return opened[-1]

    yield make
    for window in opened:
        window.close()


def test_a_window_shows_frames_until_the_user_closes_it(dummy_window: Callable[..., Window]) -> None:
    window = dummy_window()
    frame = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    assert window.show(frame)
    screen = pygame.display.get_surface()
    assert screen is not None and pygame.image.tobytes(screen, "RGB") == frame.tobytes()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert not window.show(frame)
    assert not pygame.display.get_init()
    assert not window.open and not window.show(frame)
    window.close()


def test_windows_take_the_screen_over_from_each_other(dummy_window: Callable[..., Window]) -> None:
    """As of an environment that trains and one that is opened and closed beside it to evaluate."""
    frame, wide = np.zeros((48, 64, 3), dtype=np.uint8), np.zeros((32, 96, 3), dtype=np.uint8)
    first, second = dummy_window(), dummy_window((96, 32))
    for window, shown in ((first, frame), (second, wide), (first, frame)):
        assert window.show(shown)
        screen = pygame.display.get_surface()
        assert screen is not None and screen.get_size() == window.size
    second.close()
    assert first.show(frame) and not second.show(wide)
    third = dummy_window()
    third.close()
    assert first.show(frame)


def test_a_window_takes_frames_of_its_size_only(dummy_window: Callable[..., Window]) -> None:
    with pytest.raises(ValueError, match=r"frame.shape = \(64, 48, 3\), allowed \(48, 64, 3\)"):
        dummy_window().show(np.zeros((64, 48, 3), dtype=np.uint8))


def test_a_window_keeps_its_pace(dummy_window: Callable[..., Window]) -> None:
    window, frame = dummy_window(fps=50.0), np.zeros((48, 64, 3), dtype=np.uint8)
    window.show(frame)
    start = time.perf_counter()
    for _ in range(5):
        window.show(frame)
    assert time.perf_counter() - start > 0.9 * 5 / 50
