"""The page's geometry and data, without a browser: the surface is the flap's, packing loses nothing that is
seen, nothing that a file says can become code."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.pictures.page import NotFollowed, Shown, followed, followed_by_rod, page
from baselines.pictures.page.compose import in_script, script_json
from baselines.pictures.page.motion import SQUEEZE, depth_rows
from baselines.pictures.page.pack import motion_data, packed, unpacked
from baselines.pictures.page.surface import surface_of
from planners.certify import Certificate
from retract_env.drawing.palette import METHODS, rgb
from retract_env.grasp import Grasp, JawPath
from retract_env.mesh import RESOLUTIONS, section_mesh
from retract_env.scene import Scene, load_scene
from tests.baselines.pictures.pages import HOSTILE, judged, two_plans

Judged = tuple[Scene, Grasp, JawPath, Certificate]


@pytest.fixture(scope="module")
def ten() -> Judged:
    return judged()


@pytest.fixture(scope="module")
def plans() -> list[Shown]:
    return two_plans()


@pytest.fixture(scope="module")
def text(plans: list[Shown]) -> str:
    return page(plans)


def area(points: NDArray[np.float64], edges: NDArray[np.intp]) -> float:
    """Of what closed edges go round, counter-clockwise: Green's theorem."""
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    return float((a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]).sum()) / 2


@pytest.mark.parametrize("smeared", [(), (0, 3, 9)])
def test_the_surface_is_the_flaps_and_its_veins(smeared: tuple[int, ...]) -> None:
    scene = load_scene("ten_veins")
    section = section_mesh(scene, -0.03, RESOLUTIONS["coarse"], smeared)
    surface = surface_of(section)
    points = surface.moved(section.points)[surface.nodes]
    corners = points[surface.faces]
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2
    whole = scene.tissue.length * scene.tissue.height
    assert areas.min() > 0 and areas.sum() == pytest.approx(whole)
    veins = [area(np.array(v.outline), _round(len(v.outline))) for v in scene.tissue.veins]
    kept = [a for k, a in enumerate(veins) if k not in smeared]
    assert areas[surface.in_vein].sum() == pytest.approx(sum(kept))
    assert area(points, surface.walls) == pytest.approx(sum(veins))
    assert len(surface.rings) == len(smeared)
    perimeter = 2 * (scene.tissue.length + scene.tissue.height)
    ends = points[surface.skin]
    on_the_side = sum(
        np.hypot(*(points[b] - points[a]))
        for a, b in surface.walls
        if any(abs(points[[a, b], k] - at).max() < 1e-12 for k, at in ((1, 0.0), (1, scene.tissue.height)))
    )
    assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum() + on_the_side == pytest.approx(perimeter)


def _round(count: int) -> NDArray[np.intp]:
    along = np.arange(count)
    return np.stack([along, np.roll(along, -1)], axis=1)


def test_veins_that_the_mesh_does_not_follow_move_with_the_tissue() -> None:
    """As any affine motion is exact in the elements, the outlines follow it exactly."""
    scene = load_scene("ten_veins")
    surface = surface_of(section := section_mesh(scene, -0.03, RESOLUTIONS["coarse"], range(10)))
    turned = np.array([[0.8, -0.6], [0.7, 0.9]])
    rest, moved = surface.moved(section.points), surface.moved(section.points @ turned.T + 1.0)
    assert moved == pytest.approx(rest @ turned.T + 1.0)
    strain = np.arange(float(len(section.triangles)))
    assert surface.strains(np.full(len(strain), 0.25)) == pytest.approx(np.full(len(surface.nodes), 0.25))
    assert surface.strains(strain)[-len(surface.within) :] == pytest.approx(strain[surface.within])


def test_strain_jumps_between_a_vein_and_tissue() -> None:
    section = section_mesh(load_scene("ten_veins"), -0.03, RESOLUTIONS["fine"])
    surface = surface_of(section)
    at = surface.strains(np.where(section.vein >= 0, 1.0, 0.0))
    assert set(np.unique(at)) == {0.0, 1.0}
    assert at[surface.walls].min() == 1.0 and at[surface.skin].max() == 0.0


@pytest.mark.parametrize(("kind", "low", "high"), [("u1", 0, 255), ("i2", -32768, 32767), ("u4", 0, 70000)])
def test_packing_loses_nothing(kind: str, low: int, high: int) -> None:
    """Jumps from end to end included, where differences wrap round."""
    rng = np.random.default_rng(0)
    values = rng.integers(low, high, (7, 5, 3), endpoint=True)
    values[::2, 0], values[1::2, 0] = low, high
    assert np.array_equal(unpacked(packed(values, kind)), values)


def test_rows_over_the_depth_begin_in_the_middle_and_end_at_the_end() -> None:
    for count in (1, 2, 4, 6):
        plane, along = depth_rows(np.linspace(0, 0.01, count))
        assert plane.sum(axis=1) == pytest.approx(np.ones(len(plane)))  # a flap that moves as one stays one
        assert plane[0].tolist() == np.eye(count)[0].tolist() and not along[0].any()
        assert plane[-1].tolist() == along[-1].tolist() == np.eye(count)[-1].tolist()
        assert (np.diff(along @ np.arange(1.0, count + 1)) > 0).all()


def test_the_motion_is_the_certificates(ten: Judged) -> None:
    motion = followed(*ten)
    certificate = ten[3]
    assert motion.progress.tolist() == certificate.history["progress"]
    middle = np.array([np.asarray(certificate.frames[k].points) for k in motion.shown])
    found = motion.shapes[:, 0, : middle.shape[1], :2]
    # two solutions of the same equations, each within the solver's tolerance
    assert found == pytest.approx(middle, abs=2e-3 * ten[0].tissue.height)
    depth = motion.shapes[:, -1, :, 2]
    assert depth[0] == pytest.approx(np.full_like(depth[0], ten[0].tissue.depth / 2), rel=0.02)
    assert depth[-1].max() > depth[0].max()  # what is pressed between the jaws bulges
    assert motion.time[0] == 0 and motion.time[-1] == 1
    assert motion.time[motion.progress == 1] == pytest.approx([SQUEEZE])


def test_what_ends_while_the_jaws_close_does_not_last_longer(ten: Judged) -> None:
    motion = replace(followed(*ten), progress=np.array([0.0, 0.25, 0.5]))
    assert motion.time == pytest.approx([0, SQUEEZE / 4, SQUEEZE / 2])
    assert replace(motion, progress=np.array([0.0, 1.0])).time == pytest.approx([0, SQUEEZE])
    assert replace(motion, progress=np.array([0.0])).time.tolist() == [0]


def contrast(one: str, other: str) -> float:
    """Of two colours, as WCAG 2 has it."""

    def luminance(colour: str) -> float:
        parts = np.array(rgb(colour)) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("scheme", [0, 1])
def test_small_words_and_curves_stand_out_in_both_schemes(scheme: int, text: str) -> None:
    """WCAG 2, 1.4.3 and 1.4.11."""
    roots = re.findall(r":root \{(.*?)\}", text, re.DOTALL)
    assert len(roots) == 2
    colours = dict(re.findall(r"--([\w-]+): (#\w{6});", "".join(roots[: scheme + 1])))
    for ground in ("back", "card", "squeeze"):
        assert contrast(colours["soft"], colours[ground]) >= 4.5
    for curve in METHODS:
        assert contrast(curve, colours["card"]) >= 3


def test_what_is_packed_is_the_motion_to_two_micrometres(ten: Judged) -> None:
    motion = followed(*ten)
    data = motion_data(motion)
    low, size = np.array(data["low"]), np.array(data["size"])
    end = low + (unpacked(data["end"]) + 32768) / 65535 * size
    assert end == pytest.approx(1e3 * motion.shapes[:, -1], abs=2e-3)  # mm
    inner = low + (unpacked(data["inner"]) + 32768) / 65535 * size
    assert inner == pytest.approx(1e3 * motion.shapes[:, :-1][:, :, unpacked(data["sides"])], abs=2e-3)
    strain = unpacked(data["strain"]) / 255 * data["strainTop"]
    assert strain == pytest.approx(motion.strain, abs=data["strainTop"] / 255)


def test_a_certificate_of_another_plan_is_not_shown(ten: Judged) -> None:
    scene, grasp, path, certificate = ten
    history = certificate.history | {"strain": [1.3 * s for s in certificate.history["strain"]]}
    with pytest.raises(NotFollowed, match="not of this plan: at step"):
        followed(scene, grasp, path, replace(certificate, history=history))
    beyond = certificate.history | {"progress": [*certificate.history["progress"][:-1], 1e4]}
    with pytest.raises(NotFollowed, match="not of this plan: step"):
        followed(scene, grasp, path, replace(certificate, history=beyond))


def test_the_rod_follows_to_where_the_target_is_in_view(ten: Judged) -> None:
    motion = followed_by_rod(*ten[:3])
    assert motion is not None and motion.reason == "ok"
    assert motion.clearance[-1] >= 0 > motion.clearance[-2]
    assert np.isnan(motion.friction[motion.progress < 1]).all()
    assert motion.shapes.shape[1:] == (1, len(motion.shapes[0, 0]), 3)
    assert len(motion.surface.rings) == len(ten[0].tissue.veins)


class Reader(HTMLParser):
    """Elements, and the text of each kind of element."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.setdefault(self.tags[-1][0] if self.tags else "", []).append(data)


def test_names_stay_names(text: str) -> None:
    reader = Reader()
    reader.feed(text)
    kinds = [tag for tag, _ in reader.tags]
    assert "img" not in kinds and kinds.count("script") == 3
    assert not any(name.startswith("on") for _, attributes in reader.tags for name in attributes)
    assert f"{HOSTILE.replace('_', ' ')}, retracted" in reader.texts["h1"] + reader.texts["title"]
    data = json.loads(re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)[0])
    assert [plan["name"] for plan in data["plans"]] == ["first <b>", "second"]


def test_the_page_needs_nothing_else(text: str) -> None:
    reader = Reader()
    reader.feed(text)
    assert not any(name in ("src", "href", "srcset") for _, attributes in reader.tags for name in attributes)
    assert not re.search(r"url\(|@import|\bimport\(|fetch\(\"", text)
    assert len(text) < 2_000_000


def test_verdicts_and_margins_are_there_without_a_script(text: str) -> None:
    words = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    assert "Certified by finite elements" in words
    assert "Not certified by finite elements" in words and "too much strain" in words
    assert "100 % too much" in words  # half as much is allowed in the second
    assert "of 0.5 allowed, in the worst 1 % of the tissue" in words
    assert "What the planner tried: 1" in words and "lets go" in words


def test_what_ends_a_script_is_escaped_or_refused() -> None:
    said = {"name": "</script><!-- \u2028 &"}
    assert not re.search("[<>&\u2028]", script_json(said)) and json.loads(script_json(said)) == said
    with pytest.raises(ValueError, match="end its own element"):
        in_script("let s = '</SCRIPT>'")


def test_how_many_plans(plans: list[Shown]) -> None:
    with pytest.raises(ValueError, match="plans: 0, allowed 1 to 5"):
        page([])
    assert page(plans[:1]).count('class="view"') == 1
