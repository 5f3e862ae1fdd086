"""The window: what is seen in it, and a person who plays in it from the grasp to the certificate."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pygame
import pytest

from baselines.play import words
from baselines.play.game import Command
from baselines.play.screen import HEAD, MARGIN, PICTURE, SIZE, Screen
from baselines.play.words import Known
from planners.base import plan_from_json
from planners.certify import FAILURES, Certificate
from retract_env.drawing.lettering import Lettering
from tests.baselines.play.person import game
from tests.baselines.play.playing import NO_SCREEN

ROOT = Path(__file__).resolve().parents[3]


def drawn(folder: Path) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.uint8]], Screen]:
    screen = Screen(pygame.Surface(SIZE))
    screen.draw(game(folder))
    return pygame.surfarray.array3d(screen.surface), screen


def test_the_mouse_points_to_what_is_drawn_there(tmp_path: Path) -> None:
    image, screen = drawn(tmp_path)
    scene = game(tmp_path).dealt.scene
    length, height = scene.tissue.length, scene.tissue.height
    for x, y in ((-length, 0.0), (-0.02, 0.01), (0.01, 0.04)):
        assert screen.to_metres(scene, screen.to_pixels(scene, x, y)) == pytest.approx([x, y], abs=1e-4)
    column, row = screen.to_pixels(scene, -length, height / 2)
    dark = np.flatnonzero(image[column - 20 : column + 20, row].max(axis=1) < 80)
    assert dark.mean() == pytest.approx(20, abs=1.5)  # the outline of the free end
    column, row = screen.to_pixels(scene, -0.97 * length, height)
    dark = np.flatnonzero(image[column, row - 20 : row + 20].max(axis=1) < 80)
    assert dark.mean() == pytest.approx(20, abs=1.5)  # that of the upper surface


def test_the_jaws_are_shown_where_they_would_close(tmp_path: Path) -> None:
    screen = Screen(pygame.Surface(SIZE))
    playing = game(tmp_path)
    for place in (-0.03, -0.012):
        playing.session.propose_at(place)
        screen.draw(playing)
        image = pygame.surfarray.array3d(screen.surface)
        tissue = playing.dealt.scene.tissue
        column, row = screen.to_pixels(playing.dealt.scene, place, tissue.height + 2e-3)
        assert image[column, row].max() < 120  # the upper jaw's finger
    playing.command(Command.CONFIRM)
    screen.draw(playing)
    assert not np.array_equal(pygame.surfarray.array3d(screen.surface), image)


def test_all_that_may_be_said_fits_beside_each_other() -> None:
    surface = pygame.Surface(SIZE)
    large, usual = Lettering(surface, 30), Lettering(surface, 21)
    room = SIZE[0] - 2 * MARGIN
    scene = usual.write("random flap 99999, 999 recorded", 0, 0) + 15
    for headline in (words.ASKS, words.MOVES, words.GOES_BACK, words.IN_VIEW, *words.ENDS.values()):
        assert large.write(headline, 0, 0) + scene <= room, headline
    good = {
        "certified": True,
        "max_strain": 0.1234,
        "strain_limit": 0.55,
        "required_friction": 0.444,
        "friction_limit": 0.55,
    }
    certificates = [words.judged(good)]
    certificates += [words.judged(good | {"certified": False, "reason": reason}) for reason in FAILURES]
    olds: list[dict[str, Any]] = [{"old": 0.2574}, {"old_none": True}, {"failed": ["ctc"]}, {}]
    bests: list[dict[str, Any]] = [
        {"best": 0.1112, "best_by": "ppo_lagrangian"},
        {"best": 0.1112, "best_by": "swift", "planned": True},
        {"best_none": True},
        {},
    ]
    compared = []
    for old, best, strain in product(olds, bests, (None, 0.1234)):
        waiting = "ctc" if not old else "swift" if not best else ""
        compared.append(words.compared(strain, Known(**old, **best), waiting))
    lines = [f"{said} Written: play-999.json" for said in certificates] + compared
    lines += [line for keys in words.HELP.values() for line in keys if line]
    lines += [f"{first}     {second}" for first, second in words.HELP.values() if first and second]
    lines += [*words.PAD_HELP.values(), words.HINT]
    for line in lines:
        assert usual.write(line, 0, 0) <= room, line


def test_the_words_lie_beside_the_picture(tmp_path: Path) -> None:
    image, _ = drawn(tmp_path)
    for rows in (image[:, HEAD - 4 : HEAD - 1], image[:, HEAD + PICTURE[1] + 1 : HEAD + PICTURE[1] + 4]):
        assert (rows == rows[0, 0]).all()


@pytest.fixture(scope="module")
def screen_of_its_own() -> Iterator[dict[str, str]]:
    """Variables of the environment under which there is a screen: an X server's without a display, or SDL's
    driver without a screen where there is no such server."""
    server = shutil.which("Xvfb")
    if server is None:
        yield {"SDL_VIDEODRIVER": "dummy"}
        return
    reader, writer = os.pipe()
    command = [server, "-displayfd", str(writer), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"]
    process = subprocess.Popen(command, pass_fds=[writer], stderr=subprocess.DEVNULL)
    os.close(writer)
    with open(reader) as pipe:
        number = pipe.readline().strip()
    yield {"DISPLAY": f":{number}", "SDL_VIDEODRIVER": "x11"}
    process.terminate()
    process.wait()


def run(how: str, folder: Path, screen: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | screen | {"PYTHONPATH": str(ROOT)}
    environment |= {"MINARI_DATASETS_PATH": str(folder / "minari"), "SDL_AUDIODRIVER": "dummy"}
    done = subprocess.run(
        [sys.executable, "-m", "tests.baselines.play.playing", how, *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=500, check=False,
    )  # fmt: skip
    if done.returncode == NO_SCREEN:
        pytest.skip(done.stdout.strip())
    return done


@pytest.mark.parametrize("how", ["quits", "interrupted"])
def test_a_person_plays_from_the_grasp_to_the_certificate(
    how: str, tmp_path: Path, screen_of_its_own: dict[str, str]
) -> None:
    minari = pytest.importorskip("minari")
    done = run(
        how, tmp_path, screen_of_its_own, "ten_veins", "--record", "toy/played-v0", "--resolution", "coarse",
        "--out", str(tmp_path / "mine.json"),
    )  # fmt: skip
    assert done.returncode == (0 if how == "quits" else 130), done.stdout + done.stderr
    assert "written: 1 episodes into toy/played-v0" in done.stdout
    plan_from_json(json.loads((tmp_path / "mine.json").read_text()))
    certificate = tmp_path / "mine.certificate.json"
    assert certificate.exists() is (how == "quits")
    if how == "quits":
        assert Certificate.from_json(json.loads(certificate.read_text())).certified
    root = os.environ.get("MINARI_DATASETS_PATH")
    os.environ["MINARI_DATASETS_PATH"] = str(tmp_path / "minari")
    try:
        dataset = minari.load_dataset("toy/played-v0")
        env, episode = dataset.recover_environment(), dataset[0]
        env.reset(seed=next(iter(dataset.storage.get_episode_metadata([0])))["seed"])
        for action in episode.actions:
            seen, _, terminated, _, _ = env.step(action)
        assert terminated and np.array_equal(seen, episode.observations[-1])
        env.close()
    finally:
        os.environ.pop("MINARI_DATASETS_PATH")
        if root is not None:
            os.environ["MINARI_DATASETS_PATH"] = root


def test_without_a_screen_one_line_says_so(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"PYTHONPATH": str(ROOT)}
    environment.pop("SDL_VIDEODRIVER", None)
    if sys.platform != "linux":
        pytest.skip("elsewhere a screen is not a matter of the environment")
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from baselines.cli import main; sys.exit(main(['play']))"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and "error: no window can be opened: " in done.stderr
    assert list(tmp_path.iterdir()) == []
