"""The pictures show what the states say; the flap here is bent by formula, so that no solver is needed."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from PIL import Image

from baselines.animation import animate_retraction, shown_increments
from baselines.drawing import SectionTopology, hidden_area, strain_map
from baselines.pictures import draw_retraction, ranked, retraction_figure, verdict
from planners.spring import SpringModel
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, SectionMesh, section_mesh
from retract_env.physics.base import TissueState
from retract_env.scene import LineOfSight, Scene, Tissue, Vein

LENGTH, HEIGHT = 0.05, 0.0044


def scene_with(veins: int) -> Scene:
    """The paper's flap with round veins along it; B at 25 % of the length from the fixed end."""
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    pitch = LENGTH / (veins + 1)
    outlines = []
    for i in range(veins):
        radius = min(0.36 * pitch, 1.5e-3) * (0.75 + 0.25 * math.sin(3.0 * i + 1.0))
        centre = (-LENGTH + (i + 1) * pitch, HEIGHT / 2 + 0.5e-3 * math.cos(2.0 * i))
        outlines.append(tuple((centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in turn))
    tissue = Tissue(
        length=LENGTH, height=HEIGHT, depth=HEIGHT, density=1000.0, modulus=40e3, poisson=0.45,
        veins=tuple(Vein(outline=o, modulus=200e3) for o in outlines),
    )  # fmt: skip
    return Scene(
        name=f"{veins}_veins", tissue=tissue, line_of_sight=LineOfSight.at(-0.25 * LENGTH, math.pi / 4)
    )


def bent(scene: Scene, section: SectionMesh, grasp: Grasp, squeeze: float, curvature: float, progress: float) -> TissueState:
    """Constant curvature of the medial axis (Sec. IV-D), pinched near the jaws; strain from curvature and pinch."""
    arc, y = -section.points[:, 0], section.points[:, 1]
    delta = squeeze * grasp.compression

    def place(s: Any, y: Any) -> np.ndarray:
        pinch = np.exp(-(((s + grasp.x) / (0.8 * HEIGHT)) ** 2)) * delta / HEIGHT
        radius = 1.0 / max(curvature, 1e-9)
        across = HEIGHT / 2 + (y - HEIGHT / 2) * (1 - pinch)
        phi = s / (radius - HEIGHT / 2)
        # R - (R - y) cos(phi), without the cancellation at large R
        return np.stack((-(radius - across) * np.sin(phi), 2 * radius * np.sin(phi / 2) ** 2 + across * np.cos(phi)), -1)

    points = place(arc, y)
    jaws = np.concatenate((place(-grasp.x, 0.0), place(-grasp.x, HEIGHT)))
    axis = (jaws[2:] - jaws[:2]) / np.linalg.norm(jaws[2:] - jaws[:2])
    at = section.points[section.triangles].mean(axis=1)
    strain = abs(at[:, 1] - HEIGHT / 2) * curvature * 0.9 + delta / HEIGHT * np.exp(-(((at[:, 0] - grasp.x) / (0.8 * HEIGHT)) ** 2))
    strain = strain * np.where(section.vein >= 0, 0.4, 1.0)
    camera, target = np.array(scene.line_of_sight.camera), np.array(scene.line_of_sight.target)
    along = (target - camera) / np.linalg.norm(target - camera)
    clearance = float(np.min((points - target) @ np.array([-along[1], along[0]])))
    return TissueState(
        points=points, strain=strain, jaws=jaws, reactions=np.stack((-axis, axis)), normals=np.stack((axis, -axis)),
        max_strain=float(np.quantile(strain, 0.99)), worst_at=at[np.argmax(strain)],
        required_friction=np.array([0.05 + 0.004 * curvature, 0.04 + 0.003 * curvature]) if squeeze else np.zeros(2),
        clearance=clearance, progress=progress,
    )  # fmt: skip


def plan_with(veins: int, reason: str = "ok", squeezes: int = 8, motions: int = 42, last: float = 48.0) -> Any:
    scene = scene_with(veins)
    model = SpringModel(scene.tissue)
    grasps = model.stable_grasps() if veins else [Grasp(x, 0.25 * HEIGHT) for x in np.linspace(-0.045, -0.01, 10)]
    grasp = min(grasps, key=lambda g: abs(g.x + 0.036))
    section = section_mesh(scene, grasp.x, RESOLUTIONS["fine"])
    frames = [bent(scene, section, grasp, p, 0.0, p) for p in np.linspace(0.0, 1.0, squeezes + 1)]
    frames += [bent(scene, section, grasp, 1.0, last * p, 1.0 + p) for p in np.linspace(0.0, 1.0, motions + 1)[1:]]
    end = frames[-1]
    certificate = SimpleNamespace(
        certified=reason == "ok", reason=reason, max_strain=max(f.max_strain for f in frames), strain_limit=0.5,
        required_friction=float(np.max(end.required_friction)), friction_limit=0.5, clearance=end.clearance,
        increments=len(frames), frames=tuple(frames), section=section,
    )  # fmt: skip
    path = JawPath(np.array([frames[0].jaws, *(f.jaws for f in frames[squeezes:])]), "ctc")
    candidates = tuple(SimpleNamespace(grasp=g, reason=None, max_strain=0.3) for g in grasps)
    return SimpleNamespace(scene=scene, planner="ctc", grasp=grasp, path=path, certificate=certificate, candidates=candidates)


@pytest.fixture(scope="module")
def ten() -> Any:
    return plan_with(10)


def axes_of(figure: Figure, label: str) -> Any:
    return next(a for a in figure.axes if a.get_label() == label)


def final_flap(figure: Figure) -> TriMesh:
    return next(c for c in axes_of(figure, "motion").collections if c.get_gid() == "final flap")


def with_certificate(plan: Any, **changes: Any) -> Any:
    certificate = SimpleNamespace(**{**vars(plan.certificate), **changes})
    return SimpleNamespace(**{**vars(plan), "certificate": certificate})


def test_picture_is_1600_pixels_wide_and_the_same_bytes_every_time(ten: Any, tmp_path: Path) -> None:
    draw_retraction(ten, tmp_path / "a.png")
    draw_retraction(ten, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    image = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"))
    assert image.shape[1] == 1600
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 500  # neither blank nor without a strain map
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]  # no temporary left behind


@pytest.mark.parametrize(("veins", "reason", "last"), [(0, "not_visible", 20.0), (20, "strain", 60.0), (1, "diverged", 30.0)])
def test_any_plan_is_drawn(veins: int, reason: str, last: float) -> None:
    plan = plan_with(veins, reason, squeezes=2, motions=3, last=last)
    retraction_figure(plan)
    assert verdict(plan).startswith("Not certified")
    retraction_figure(with_certificate(plan, frames=plan.certificate.frames[:1]))  # it broke at once


def test_no_frames_is_an_error(ten: Any, tmp_path: Path) -> None:
    empty = with_certificate(ten, frames=())
    for draw, name in ((draw_retraction, "a.png"), (animate_retraction, "a.gif")):
        with pytest.raises(ValueError, match="no frames"):
            draw(empty, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_final_flap_is_drawn_where_its_nodes_are(ten: Any) -> None:
    flap = final_flap(retraction_figure(ten))
    certificate = ten.certificate
    drawn = np.column_stack((flap._triangulation.x, flap._triangulation.y))
    nodes = SectionTopology(certificate.section).nodes
    np.testing.assert_array_equal(drawn, certificate.frames[-1].points[nodes] * 1e3)
    assert set(nodes) == set(range(len(certificate.section.points)))


def test_colours_run_from_zero_to_the_strain_limit(ten: Any) -> None:
    assert final_flap(retraction_figure(with_certificate(ten, strain_limit=0.37))).get_clim() == (0.0, 0.37)


def test_relaxed_is_paler_than_strained() -> None:
    luma = strain_map()(np.linspace(0, 1, 256))[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(luma) < 0)


def test_small_triangles_cover_the_section_once(ten: Any) -> None:
    section = ten.certificate.section
    for straight in (False, True):
        topology = SectionTopology(section, straight)
        a, b, c = np.moveaxis(section.points[topology.nodes[topology.faces]], 1, 0)
        areas = np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2] / 2
        assert np.all(areas > 0)
        assert areas.sum() == pytest.approx(LENGTH * HEIGHT, rel=1e-9)


def test_smoothing_keeps_uniform_strain_and_the_jump_at_a_vein(ten: Any) -> None:
    section = ten.certificate.section
    topology = SectionTopology(section)
    smooth = topology.smooth(np.where(section.vein >= 0, 0.1, 0.3))
    assert set(smooth.round(12)) == {0.1, 0.3}
    assert np.bincount(topology.nodes[smooth < 0.2]).max() == 1  # once per side, not more


def test_outline_and_vein_edges_have_the_length_of_their_polygons(ten: Any) -> None:
    section, topology = ten.certificate.section, SectionTopology(ten.certificate.section)
    loop = section.points[topology.outline]
    np.testing.assert_allclose(loop[[0, -1]], 0.0, atol=1e-12)
    assert loop[1, 0] < 0 and loop[1, 1] == pytest.approx(0.0, abs=1e-12)  # the lower surface comes first
    assert np.linalg.norm(np.diff(loop, axis=0), axis=1).sum() == pytest.approx(2 * (LENGTH + HEIGHT), rel=1e-9)
    edges = section.points[topology.vein_edges]
    perimeter = sum(np.linalg.norm(np.array(v.outline) - np.roll(v.outline, 1, axis=0), axis=1).sum() for v in ten.scene.tissue.veins)
    assert np.linalg.norm(np.diff(edges, axis=1), axis=2).sum() == pytest.approx(perimeter, rel=1e-9)


def test_hidden_area_of_a_box_is_bounded_by_the_ray_over_its_corner() -> None:
    box = np.array([(0.0, 0.0), (-4.0, 0.0), (-4.0, 2.0), (0.0, 2.0), (0.0, 0.0)])
    # It stands on the bed, so its foot (-4, 0) comes first; the ray over its corner meets the bed behind it, at -2.
    np.testing.assert_allclose(hidden_area(box, (-10.0, 8.0)), [(0, 0), (-4, 0), (-4, 0)])
    lifted = box + (0.0, 1.0)  # now the lower corner (-4, 1) hides most: 6 across, 7 down, so 8 down is 48 / 7 across
    np.testing.assert_allclose(hidden_area(lifted, (-10.0, 8.0))[-1], (-10 + 48 / 7, 0))


def test_stiffness_panel_shows_k_eq_and_marks_every_grasp_once(ten: Any) -> None:
    panel = axes_of(retraction_figure(ten), "stiffness")
    marks = {line.get_gid(): line.get_xydata()[0] for line in panel.lines if str(line.get_gid()).startswith("grasp")}
    assert len(marks) == len(ten.candidates)
    for rank, candidate in enumerate(ten.candidates, start=1):
        assert marks[f"grasp {rank}"][0] == pytest.approx(candidate.grasp.x * 1e3)
    curve = max((line.get_xydata() for line in panel.lines), key=len)
    # 40 kPa over 4.4 mm where there is no vein
    assert curve[:, 1].min() == pytest.approx(40 / 4.4, rel=1e-9)
    assert panel.get_xlim() == axes_of(retraction_figure(ten), "motion").get_xlim()


def test_grasps_at_one_place_share_a_rank() -> None:
    grasps = [Grasp(-0.02, 1e-3), Grasp(-0.03, 1e-3), Grasp(-0.02, 5e-4), Grasp(-0.01, 1e-3)]
    assert ranked([SimpleNamespace(grasp=g) for g in grasps]) == [(1, -0.02), (2, -0.03), (3, -0.01)]  # type: ignore[misc]


def test_histories_are_the_frames_own(ten: Any) -> None:
    figure = retraction_figure(ten)
    frames = ten.certificate.frames
    wanted = (
        [f.max_strain for f in frames], [max(f.required_friction) for f in frames], [f.clearance * 1e3 for f in frames],
    )  # fmt: skip
    for i, values in enumerate(wanted):
        curves = [line.get_ydata() for line in axes_of(figure, f"history {i}").lines]
        assert any(len(c) == len(values) and np.array_equal(c, values) for c in curves)


def test_friction_that_no_coefficient_meets_stays_on_the_page(ten: Any) -> None:
    frames = list(ten.certificate.frames)
    frames[5] = dataclasses.replace(frames[5], required_friction=np.array([math.inf, 0.1]))
    panel = axes_of(retraction_figure(with_certificate(ten, frames=tuple(frames))), "history 1")
    low, high = panel.get_ylim()
    assert math.isfinite(high)
    for line in panel.lines:
        assert np.all((np.asarray(line.get_ydata()) >= low) & (np.asarray(line.get_ydata()) <= high))


def test_animation_has_a_frame_per_increment_one_palette_and_a_pause(ten: Any, tmp_path: Path) -> None:
    animate_retraction(ten, tmp_path / "a.gif", fps=20)
    assert (tmp_path / "a.gif").stat().st_size < 3e6
    film = Image.open(tmp_path / "a.gif")
    assert film.width == 800 and film.height % 16 == 0
    assert film.info["loop"] == 0
    times, pictures = [], []
    for i in range(film.n_frames):  # type: ignore[attr-defined]
        film.seek(i)
        times.append(film.info["duration"])
        pictures.append(np.asarray(film.convert("RGB")))
    assert len(times) == len(ten.certificate.frames)
    assert set(times[:-1]) == {50} and times[-1] >= 1000
    assert all(np.array_equal(p[5, 5], (255, 255, 255)) for p in pictures)
    assert not np.array_equal(pictures[0], pictures[-1])


def test_long_motions_are_thinned_but_keep_both_ends() -> None:
    for count in (1, 2, 60, 61, 500):
        shown = shown_increments(count)
        assert shown[0] == 0 and shown[-1] == count - 1 and len(shown) == min(count, 60)


@pytest.mark.parametrize(
    ("name", "fps", "message"), [("a.avi", 20, "must end in .gif or .mp4"), ("a.gif", 0, "fps"), ("a.gif", 51, "fps")]
)
def test_bad_requests_are_refused_in_one_line(ten: Any, tmp_path: Path, name: str, fps: int, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        animate_retraction(ten, tmp_path / name, fps=fps)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is not None, reason="imageio-ffmpeg is installed")
def test_mp4_without_ffmpeg_says_what_to_install(ten: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="pip install imageio-ffmpeg"):
        animate_retraction(ten, tmp_path / "a.mp4")


def test_mp4_is_written_where_ffmpeg_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    animate_retraction(plan_with(0, squeezes=1, motions=3), tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"


def test_pyplot_is_never_imported() -> None:
    code = "import sys, baselines.pictures, baselines.animation; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
