"""The pictures show what the states say; the flap here is bent by formula, so that no solver is needed."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import TriMesh
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image, ImageSequence

from baselines.pictures.drawing import JawArtist, draw_surroundings, path_steps, strain_map, view_limits
from baselines.pictures.film import animate_retraction
from baselines.pictures.steps import shown_frames
from baselines.pictures.stiffness import ranked
from baselines.pictures.still import draw_retraction, retraction_figure, verdict
from planners.base import Candidate, Plan
from planners.certify import Certificate
from retract_env.drawing.shapes import SectionTopology
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, SectionMesh, section_mesh
from retract_env.physics.base import TissueState
from retract_env.scene import LineOfSight, Scene, Tissue, Vein
from retract_env.spring import SpringModel

LENGTH, HEIGHT = 0.05, 0.0044
WIDTH = 0.8 * HEIGHT  # how far the pinch of the jaws reaches


def scene_with(veins: int) -> Scene:
    """The paper's flap with round veins along it; B at 25 % of the length from the fixed end."""
    turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    pitch = LENGTH / (veins + 1)
    outlines = []
    for i in range(veins):
        radius = min(0.36 * pitch, 1.5e-3) * (0.75 + 0.25 * math.sin(3.0 * i + 1.0))
        x, y = -LENGTH + (i + 1) * pitch, HEIGHT / 2 + 0.5e-3 * math.cos(2.0 * i)
        outlines.append(tuple((x + radius * math.cos(a), y + radius * math.sin(a)) for a in turn))
    tissue = Tissue(
        length=LENGTH,
        height=HEIGHT,
        depth=HEIGHT,
        density=1000.0,
        modulus=40e3,
        poisson=0.45,
        veins=tuple(Vein(outline=outline, modulus=200e3) for outline in outlines),
    )
    sight = LineOfSight.at(-0.25 * LENGTH, math.pi / 4)
    return Scene(name=f"{veins}_veins", tissue=tissue, line_of_sight=sight)


def bent(
    scene: Scene, section: SectionMesh, grasp: Grasp, squeeze: float, curvature: float, progress: float
) -> TissueState:
    """Medial axis of constant curvature (Sec. IV-D), pinched at the jaws; strain from curvature and pinch."""
    pinch = squeeze * grasp.compression / HEIGHT

    def place(x: Any, y: Any) -> NDArray[np.float64]:
        here = np.exp(-(((x - grasp.x) / WIDTH) ** 2)) * pinch
        radius = 1.0 / max(curvature, 1e-9)
        across = HEIGHT / 2 + (y - HEIGHT / 2) * (1 - here)
        phi = -x / (radius - HEIGHT / 2)
        # R - (R - y) cos(phi), without the cancellation at large R
        up = 2 * radius * np.sin(phi / 2) ** 2 + across * np.cos(phi)
        return np.stack((-(radius - across) * np.sin(phi), up), axis=-1)

    points = place(*section.points.T)
    jaws = np.concatenate((place(grasp.x, 0.0), place(grasp.x, HEIGHT)))
    axis = (jaws[2:] - jaws[:2]) / np.linalg.norm(jaws[2:] - jaws[:2])
    at = section.points[section.triangles].mean(axis=1)
    strain = 0.9 * curvature * abs(at[:, 1] - HEIGHT / 2) + pinch * np.exp(
        -(((at[:, 0] - grasp.x) / WIDTH) ** 2)
    )
    strain = strain * np.where(section.vein >= 0, 0.4, 1.0)
    camera, target = np.array(scene.line_of_sight.camera), np.array(scene.line_of_sight.target)
    along = (target - camera) / np.linalg.norm(target - camera)
    return TissueState(
        points=points,
        strain=strain,
        jaws=jaws,
        reactions=np.stack((-axis, axis)),
        normals=np.stack((axis, -axis)),
        worst_strain=float(np.quantile(strain, 0.99)),
        worst_at=at[np.argmax(strain)],
        required_friction=np.array([0.05, 0.04]) + 0.004 * curvature,
        clearance=float(np.min((points - target) @ np.array([-along[1], along[0]]))),
        progress=progress,
    )


def plan_with(
    veins: int, reason: str = "ok", squeezes: int = 8, motions: int = 42, last: float = 48.0
) -> Plan:
    """last: 1/m, the curvature at the end."""
    scene = scene_with(veins)
    grasps = SpringModel(scene.tissue).stable_grasps()
    grasp = min(grasps, key=lambda g: abs(g.x + 0.036))
    section = section_mesh(scene, grasp.x, RESOLUTIONS["fine"])
    squeeze, motion = np.linspace(0.0, 1.0, squeezes + 1), np.linspace(0.0, 1.0, motions + 1)[1:]
    frames = [bent(scene, section, grasp, part, 0.0, part) for part in squeeze]
    frames += [bent(scene, section, grasp, 1.0, last * part, 1.0 + motions * part) for part in motion]
    certificate = Certificate(
        certified=reason == "ok",
        reason=reason,
        max_strain=max(f.worst_strain for f in frames),
        strain_limit=0.5,
        required_friction=float(np.max(frames[-1].required_friction)),
        friction_limit=0.5,
        clearance=frames[-1].clearance,
        increments=len(frames) - 1,
        mesh={},
        scene_hash=scene.hash,
        grasp={"x": grasp.x, "compression": grasp.compression},
        path={},
        history={},
        frames=tuple(frames),
        section=section,
    )
    path = JawPath(np.array([frames[0].jaws, *(f.jaws for f in frames[squeezes:])]), "ctc")
    return Plan(
        scene, "ctc", grasp, path, certificate, tuple(Candidate(i, g, path) for i, g in enumerate(grasps))
    )


@pytest.fixture(scope="module")
def ten() -> Plan:
    return plan_with(10)


def axes_of(figure: Figure, label: str) -> Axes:
    return next(a for a in figure.axes if a.get_label() == label)


def final_flap(figure: Figure) -> TriMesh:
    found = next(c for c in axes_of(figure, "motion").collections if c.get_gid() == "final flap")
    assert isinstance(found, TriMesh)
    return found


def with_certificate(plan: Plan, **changes: Any) -> Plan:
    return dataclasses.replace(plan, certificate=dataclasses.replace(plan.certificate, **changes))


def section_of(plan: Plan) -> SectionMesh:
    assert plan.certificate.section is not None
    return plan.certificate.section


def test_picture_is_1600_pixels_wide_and_the_same_bytes_every_time(ten: Plan, tmp_path: Path) -> None:
    draw_retraction(ten, tmp_path / "a.png")
    draw_retraction(ten, tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with Image.open(tmp_path / "a.png") as picture:
        image = np.asarray(picture.convert("RGB")).astype(np.int64)
    assert image.shape[1] == 1600
    assert len(np.unique(image @ [1 << 16, 1 << 8, 1])) > 500  # neither blank nor without a strain map
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]  # no temporary left behind


@pytest.mark.parametrize(
    ("veins", "reason", "last"), [(0, "not_visible", 20.0), (20, "strain", 60.0), (1, "diverged", 30.0)]
)
def test_any_plan_is_drawn(veins: int, reason: str, last: float, tmp_path: Path) -> None:
    plan = plan_with(veins, reason, squeezes=2, motions=3, last=last)
    assert verdict(plan).startswith("Not certified")
    assert "_" not in verdict(plan)  # plain words
    draw_retraction(plan, tmp_path / "all.png")
    broken_at_once = with_certificate(plan, frames=plan.certificate.frames[:1])
    retraction_figure(broken_at_once)
    animate_retraction(broken_at_once, tmp_path / "one.gif")
    assert all(p.stat().st_size > 10_000 for p in tmp_path.iterdir())


def test_no_frames_is_an_error(ten: Plan, tmp_path: Path) -> None:
    empty = with_certificate(ten, frames=())
    for draw, name in ((draw_retraction, "a.png"), (animate_retraction, "a.gif")):
        with pytest.raises(ValueError, match="no frames"):
            draw(empty, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_final_flap_is_drawn_where_its_nodes_are(ten: Plan) -> None:
    section = section_of(ten)
    topology = SectionTopology(section, ten.scene.tissue.veins)
    triangles = final_flap(retraction_figure(ten)).get_paths()
    drawn = np.array([np.asarray(path.vertices)[:3] for path in triangles])
    wanted = ten.certificate.frames[-1].points[topology.nodes[topology.faces]] * 1e3
    np.testing.assert_array_equal(drawn, wanted)
    assert set(topology.nodes) == set(range(len(section.points)))


def test_colours_run_from_zero_to_the_strain_limit(ten: Plan) -> None:
    assert final_flap(retraction_figure(with_certificate(ten, strain_limit=0.37))).get_clim() == (0.0, 0.37)


def test_more_strain_is_always_darker() -> None:
    linear = strain_map()(np.linspace(0, 1, 64))[:, :3] ** 2.2  # of sRGB
    assert np.all(np.diff(linear @ [0.2126, 0.7152, 0.0722]) < 0)


@pytest.mark.parametrize("straight", [False, True])
def test_small_triangles_cover_the_section_once(ten: Plan, straight: bool) -> None:
    section = section_of(ten)
    topology = SectionTopology(section, ten.scene.tissue.veins)
    faces = topology.straight if straight else topology.faces
    a, b, c = np.moveaxis(section.points[topology.nodes[faces]], 1, 0)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    areas = (ux * vy - uy * vx) / 2
    assert np.all(areas > 0)
    assert areas.sum() == pytest.approx(LENGTH * HEIGHT, rel=1e-9)


def test_smoothing_keeps_uniform_strain_and_the_jump_at_a_vein(ten: Plan) -> None:
    section = section_of(ten)
    smooth = SectionTopology(section, ten.scene.tissue.veins).smooth(np.where(section.vein >= 0, 0.1, 0.3))
    assert set(smooth.round(12)) == {0.1, 0.3}


def test_outline_and_vein_edges_have_the_length_of_their_polygons(ten: Plan) -> None:
    section = section_of(ten)
    topology = SectionTopology(section, ten.scene.tissue.veins)
    loop = section.points[topology.outline]
    np.testing.assert_allclose(loop[[0, -1]], 0.0, atol=1e-12)
    assert loop[1, 0] < 0  # the lower surface comes first
    assert loop[1, 1] == pytest.approx(0.0, abs=1e-12)
    around = np.linalg.norm(np.diff(loop, axis=0), axis=1).sum()
    assert around == pytest.approx(2 * (LENGTH + HEIGHT), rel=1e-9)
    steps = np.linalg.norm(np.diff(topology.vein_lines(section.points), axis=0), axis=1)
    outlines = [np.array(vein.outline) for vein in ten.scene.tissue.veins]
    wanted = sum(np.linalg.norm(o - np.roll(o, 1, axis=0), axis=1).sum() for o in outlines)
    assert np.nansum(steps) == pytest.approx(wanted, rel=1e-9)


def test_stiffness_panel_shows_k_eq_and_marks_every_grasp_once(ten: Plan) -> None:
    figure = retraction_figure(ten)
    panel = axes_of(figure, "stiffness")
    lines = {str(line.get_gid()): np.asarray(line.get_xydata()) for line in panel.lines}
    assert sum(name.startswith("grasp") for name in lines) == len(ten.candidates)
    for rank, candidate in enumerate(ten.candidates, start=1):
        assert lines[f"grasp {rank}"][0, 0] == pytest.approx(candidate.grasp.x * 1e3)
    curve = max((np.asarray(line.get_xydata()) for line in panel.lines), key=len)
    assert curve[:, 1].min() == pytest.approx(40 / 4.4, rel=1e-9)  # 40 kPa over 4.4 mm where there is no vein
    assert panel.get_xlim() == axes_of(figure, "motion").get_xlim()


def test_grasps_at_one_place_share_a_rank() -> None:
    grasps = [Grasp(-0.02, 1e-3), Grasp(-0.03, 1e-3), Grasp(-0.02, 5e-4), Grasp(-0.01, 1e-3)]
    path = JawPath(np.array([[-0.02, 0.0, -0.02, HEIGHT], [-0.02, 5e-4, -0.02, HEIGHT - 5e-4]]), "ctc")
    tried = [Candidate(i, grasp, path) for i, grasp in enumerate(grasps)]
    assert ranked(tried) == [(1, -0.02), (2, -0.03), (3, -0.01)]


def test_histories_are_the_frames_own(ten: Plan) -> None:
    figure, frames = retraction_figure(ten), ten.certificate.frames
    wanted = (
        [f.worst_strain for f in frames],
        [max(f.required_friction) if f.progress >= 1 else math.nan for f in frames],  # asked of closed jaws
        [f.clearance * 1e3 for f in frames],
    )
    for i, values in enumerate(wanted):
        curves = [np.asarray(line.get_ydata(), dtype=float) for line in axes_of(figure, f"history {i}").lines]
        assert any(np.array_equal(curve, values, equal_nan=True) for curve in curves)


def test_a_clearance_that_is_asked_for_is_the_limit_that_is_drawn(ten: Plan) -> None:
    panel = axes_of(retraction_figure(with_certificate(ten, clearance_limit=5e-3)), "history 2")
    assert any(np.allclose(np.asarray(line.get_ydata(), float), 5.0) for line in panel.lines)
    assert any(text.get_text() == "in view above 5" for text in panel.texts)
    assert panel.get_ylim()[0] < 5 < panel.get_ylim()[1]


def test_a_dollar_in_a_scenes_name_is_one(ten: Plan, tmp_path: Path) -> None:
    """Matplotlib would take what stands between two of them for a formula, and fail on this one."""
    scene = ten.scene.model_copy(update={"name": r"$\frac$ flap"})
    draw_retraction(dataclasses.replace(ten, scene=scene), tmp_path / "retraction.png")
    assert (tmp_path / "retraction.png").stat().st_size > 0


@pytest.mark.parametrize("bed", [True, False])
def test_a_flap_that_sags_where_there_is_no_bed_is_in_view(ten: Plan, bed: bool) -> None:
    scene, frame = ten.scene.model_copy(update={"bed": bed}), ten.certificate.frames[-1]
    below = dataclasses.replace(frame, points=np.asarray(frame.points) - (0, 0.02))
    left, right, low, high = view_limits(scene, [below])
    assert (low < 1e3 * below.points[:, 1].min()) == (not bed)
    axes = Figure().add_subplot()
    draw_surroundings(axes, scene, (left, right, low, high))
    hatched = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_y() < 0]
    assert len(hatched) == bed
    jaws = JawArtist(axes, scene)
    for finger in jaws.fingers:
        box = finger.get_clip_box()
        assert box is not None
        cut = box.transformed(axes.transData.inverted()).y0
        assert cut == pytest.approx(0.0 if bed else axes.get_ylim()[0], abs=1e-6)


def test_friction_that_no_coefficient_meets_stays_on_the_page(ten: Plan) -> None:
    frames = list(ten.certificate.frames)
    frames[15] = dataclasses.replace(frames[15], required_friction=np.array([math.inf, 0.1]))
    panel = axes_of(retraction_figure(with_certificate(ten, frames=tuple(frames))), "history 1")
    low, high = panel.get_ylim()
    assert math.isfinite(high)
    for line in panel.lines:
        values = np.asarray(line.get_ydata(), dtype=float)
        values = values[~np.isnan(values)]
        assert np.all((values >= low) & (values <= high))


def test_animation_has_even_frames_steady_white_and_a_pause(ten: Plan, tmp_path: Path) -> None:
    animate_retraction(ten, tmp_path / "a.gif", fps=20)
    assert (tmp_path / "a.gif").stat().st_size < 3e6
    times, pictures = [], []
    with Image.open(tmp_path / "a.gif") as film:
        assert film.width == 800
        assert film.height % 16 == 0  # as video encoders want
        assert film.info["loop"] == 0
        for frame in ImageSequence.Iterator(film):
            times.append(frame.info["duration"])
            pictures.append(np.asarray(frame.convert("RGB")))
    assert len(times) == len(shown_frames(path_steps(ten.certificate.frames))) > 40
    assert set(times[:-1]) == {50}
    assert times[-1] >= 1000
    assert all(np.array_equal(picture[5, 5], (255, 255, 255)) for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[-1])


@pytest.mark.parametrize("count", [1, 2, 60, 61, 500])
def test_long_motions_are_thinned_but_keep_both_ends(count: int) -> None:
    shown = shown_frames(np.arange(count, dtype=float))
    assert (shown[0], shown[-1], len(shown)) == (0, count - 1, min(count, 60))


def test_the_film_does_not_linger_where_the_certifier_looked_closely() -> None:
    steps = np.array([0, 1, 2, 2.25, 2.3, 2.35, 2.5, 3, 4, 5, 6, 7, 7.1, 7.12])
    assert shown_frames(steps)[-1] == len(steps) - 1
    assert np.diff(steps[shown_frames(steps)]).min() > 0.1


@pytest.mark.parametrize(
    ("name", "fps", "message"), [("a.avi", 20, "must end in"), ("a.gif", 0, "fps"), ("a.gif", 51, "fps")]
)
def test_bad_requests_are_refused_in_one_line(
    ten: Plan, tmp_path: Path, name: str, fps: int, message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        animate_retraction(ten, tmp_path / name, fps=fps)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_mp4_is_written_or_says_what_to_install(tmp_path: Path) -> None:
    plan = plan_with(0, squeezes=1, motions=3)
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        with pytest.raises(ValueError, match="pip install imageio-ffmpeg"):
            animate_retraction(plan, tmp_path / "a.mp4")
        assert not list(tmp_path.iterdir())
    else:
        animate_retraction(plan, tmp_path / "a.mp4")
        assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"


def test_pyplot_is_never_imported() -> None:
    code = (
        "import sys, baselines.pictures.still, baselines.pictures.film; "
        "sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_numbers_along_the_flap_are_what_the_planner_had(ten: Plan) -> None:
    """Ranks of grasps that were scored, or places in the order in which they were tried."""
    for score, words in ((1.0, "1 is the most secure"), (math.nan, "places tried, in that order")):
        tried = [
            dataclasses.replace(c, grasp=dataclasses.replace(c.grasp, score=score)) for c in ten.candidates
        ]
        figure = retraction_figure(dataclasses.replace(ten, candidates=tuple(tried)))
        assert words in axes_of(figure, "stiffness").get_title()
