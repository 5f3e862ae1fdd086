"""Scenes: the paper's values, what is refused and how it is said, round trips, files."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from retract_env.errors import SceneError
from retract_env.scene import Jaws, Limits, LineOfSight, Scene, load_scene, sample_scene
from tests.retract_env.descriptions import LENGTH, SQUARE, complaint, moved, plain, with_veins

SCENES = Path(__file__).resolve().parents[3] / "configs" / "scenes"


# --- The paper's scenes


@pytest.mark.parametrize(
    ("name", "veins", "target", "depth"),
    [
        ("homogeneous", 0, 0.25, 0.0044),
        ("homogeneous_near", 0, 0.15, 0.0044),
        ("ten_veins", 10, 0.25, 0.0044),
        ("twenty_veins", 20, 0.25, 0.0044),
        ("wide", 20, 0.25, 0.035),
    ],
)
def test_scene_files_hold_the_values_of_section_v(name: str, veins: int, target: float, depth: float) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    tissue = scene.tissue
    assert scene.name == name
    assert (tissue.length, tissue.height, tissue.depth) == (0.05, 0.0044, depth)
    assert (tissue.density, tissue.modulus, tissue.poisson) == (1000.0, 40e3, 0.45)
    assert [(vein.modulus, vein.poisson) for vein in tissue.veins] == [(200e3, 0.45)] * veins
    assert scene.limits == Limits(strain=0.5, friction=0.5)
    assert (scene.jaws, scene.gravity, scene.bed) == (Jaws(width=1e-3), 9.8, True)
    assert scene.line_of_sight.target == (-target * tissue.length, 0.0)
    assert scene.line_of_sight.slope == pytest.approx(math.pi / 4, abs=1e-12)


def test_there_are_no_other_scene_files() -> None:
    names = {path.stem for path in SCENES.iterdir()}
    assert names == {"homogeneous", "homogeneous_near", "ten_veins", "twenty_veins", "wide"}


def test_the_wide_flap_has_the_twenty_veins() -> None:
    assert (
        load_scene(SCENES / "wide.yaml").tissue.veins == load_scene(SCENES / "twenty_veins.yaml").tissue.veins
    )


@pytest.mark.parametrize("name", ["ten_veins", "twenty_veins"])
def test_jaws_fit_between_the_drawn_veins(name: str) -> None:
    """Fig. 11 grasps between veins: columns free of veins must hold a jaw, with 0.2 mm to spare."""
    scene = load_scene(SCENES / f"{name}.yaml")
    spans = sorted((min(x for x, _ in v.outline), max(x for x, _ in v.outline)) for v in scene.tissue.veins)
    reach, free = spans[0][1], []
    for left, right in spans[1:]:
        free.append(left - reach)
        reach = max(reach, right)
    assert sum(gap > scene.jaws.width + 2e-4 for gap in free) >= 9


# --- The same scene, however it is held


def all_scenes() -> list[Scene]:
    sampled = [sample_scene(np.random.default_rng(seed)) for seed in range(10)]
    return [load_scene(path) for path in sorted(SCENES.iterdir())] + sampled


def test_round_trips_lose_nothing(tmp_path: Path) -> None:
    for scene in all_scenes():
        file = tmp_path / "scene.yaml"
        file.write_text(yaml.safe_dump(scene.dump()))
        copies = (
            Scene.from_data(scene.dump()),
            Scene.model_validate(scene.dump()),
            Scene.from_data(json.loads(json.dumps(scene.dump()))),
            Scene.from_data(scene),
            load_scene(file),
            pickle.loads(pickle.dumps(scene)),
            copy.deepcopy(scene),
        )
        for same in copies:
            assert same == scene
            assert hash(same) == hash(scene)
            assert same.hash == scene.hash
            assert same.dump() == scene.dump()


def test_hash_is_that_of_the_canonical_values() -> None:
    scene = Scene.from_data(plain(limits={"strain": 0.4}))
    values = plain(limits={"strain": 0.4, "friction": 0.5}, jaws={"width": 1e-3, "depth": None})
    values |= {"gravity": 9.8, "bed": True}
    del values["name"]
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    assert scene.hash == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    "same",
    [
        {"name": "another"},
        {"tissue__density": 1000},
        {"tissue__modulus": np.float64(4e4)},
        {"line_of_sight__target": (-0.0125, -0.0)},
        {"line_of_sight__target": np.array([-0.0125, 0.0])},
        {"limits": {"strain": 0.5, "friction": 0.5}},
        {"gravity": 9.8, "bed": True},
    ],
)
def test_hash_knows_equal_scenes(same: dict[str, Any]) -> None:
    assert Scene.from_data(plain(**same)).hash == Scene.from_data(plain()).hash


def test_hash_tells_any_other_value() -> None:
    changes: list[dict[str, Any]] = [
        {"tissue__length": math.nextafter(LENGTH, 1.0)},
        {"tissue__height": 0.0045},
        {"tissue__depth": 0.035},
        {"tissue__density": 1001.0},
        {"tissue__modulus": 5e4},
        {"tissue__poisson": 0.4},
        {"tissue__veins": [{"outline": SQUARE, "modulus": 2e5}]},
        {"tissue__veins": [{"outline": SQUARE[1:] + SQUARE[:1], "modulus": 2e5}]},
        {"line_of_sight__camera": [-0.1, 0.07]},
        {"line_of_sight__target": [-0.013, 0.0]},
        {"limits__strain": 0.4},
        {"limits__friction": 0.4},
        {"jaws__width": 2e-3},
        {"jaws__depth": 1e-3},
        {"gravity": 0.0},
        {"bed": False},
    ]
    hashes = {Scene.from_data(plain(**change)).hash for change in [{}, *changes]}
    assert len(hashes) == 1 + len(changes)


def test_scenes_do_not_change() -> None:
    scene = Scene.from_data(plain())
    with pytest.raises(ValueError, match="frozen"):
        scene.tissue.height = 0.01


# --- What is refused, and how


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tissue__height": -0.0044}, "tissue.height = -0.0044 m, allowed (0, 0.05] m"),
        ({"tissue__height": 0}, "tissue.height = 0 m, allowed (0, 0.05] m"),
        ({"tissue__length": math.nan}, "tissue.length = nan m, allowed (0, 0.5] m"),
        ({"tissue__length": np.float32(2.0)}, "tissue.length = 2.0 m, allowed (0, 0.5] m"),
        ({"tissue__depth": math.inf}, "tissue.depth = inf m, allowed (0, 0.5] m"),
        ({"tissue__density": True}, "tissue.density = True, not a number; allowed [0, 20000] kg/m^3"),
        ({"tissue__modulus": "4e4"}, "tissue.modulus = '4e4', not a number; allowed [100, 1e+08] Pa"),
        ({"tissue__modulus": 99.9}, "tissue.modulus = 99.9 Pa, allowed [100, 1e+08] Pa"),
        ({"tissue__modulus": None}, "tissue.modulus = None, not a number; allowed [100, 1e+08] Pa"),
        ({"tissue__poisson": 0.5}, "tissue.poisson = 0.5, allowed [0, 0.49]"),
        ({"tissue__poisson": ...}, "tissue.poisson: missing"),
        ({"tissue__veins": {}}, "tissue.veins = {}, not a list"),
        ({"tissue": []}, "tissue = [], not a mapping; known keys: length, height, depth,"),
        ({"limits__strain": 1}, "limits.strain = 1, allowed (0, 1)"),
        ({"limits__friction": 0.0}, "limits.friction = 0.0, allowed (0, 5]"),
        ({"gravity": -9.8}, "gravity = -9.8 m/s^2, allowed [0, 100] m/s^2"),
        ({"gravity": 10**400}, "gravity = 1000"),
        ({"gravity": 10**5000}, "m/s^2, allowed [0, 100] m/s^2"),
        ({"bed": 1}, "bed = 1, not true or false"),
        ({"name": 3}, "name = 3, not a text"),
        ({"name": "two\nlines"}, "name = 'two\\nlines', not a text"),
        ({"jaws__width": 0.0125}, "jaws.width = 0.0125 m, allowed (0, 0.0125) m"),
        ({"jaws__depth": 0.0045}, "jaws.depth = 0.0045 m, allowed (0, 0.0044] m"),
        ({"line_of_sight__target": [0.0, 0.0]}, "line_of_sight.target[0] = 0.0 m, allowed (-0.05, 0) m"),
        ({"line_of_sight__target": [-0.05, 0.0]}, "line_of_sight.target[0] = -0.05 m, allowed (-0.05, 0) m"),
        ({"line_of_sight__target": [-0.01, 1e-3]}, "line_of_sight.target[1] = 0.001 m, allowed 0 m"),
        ({"line_of_sight__target": -0.01}, "line_of_sight.target = -0.01, not a point [x, y] in m"),
        ({"line_of_sight__camera": [-0.08, 0.0]}, "line_of_sight.camera[1] = 0.0 m, allowed [0.001, 10] m"),
        (
            {"line_of_sight__camera": [-0.01, 0.1]},
            "line_of_sight.camera[0] = -0.01 m, allowed [-10, -0.0125] m",
        ),
        (
            {"line_of_sight__camera": [-0.04, 0.004]},
            "line_of_sight.camera = (-0.04, 0.004) m, inside the flap",
        ),
        ({"line_of_sight__camera": [-0.1]}, "line_of_sight.camera = [-0.1], not a point [x, y] in m"),
        (
            {"tissue__heigth": 0.0044},
            "tissue.heigth: unknown key, did you mean height? known keys: length, height",
        ),
        ({"colour": "red"}, "colour: unknown key; known keys: name, tissue, line_of_sight, limits, jaws"),
    ],
)
def test_errors_name_the_field_the_value_and_what_is_allowed(change: dict[str, Any], message: str) -> None:
    assert message in complaint(lambda: Scene.from_data(plain(**change)))


@pytest.mark.parametrize("data", [None, 3, "scene", [1, 2], {1: 2}, {(1, 2): 3}, {"a\nb": 1}, Limits()])
def test_what_is_no_scene_at_all_is_said_in_one_line(data: Any) -> None:
    assert "known keys: name, tissue" in complaint(lambda: Scene.from_data(data))


def test_several_errors_share_the_line_and_the_rest_are_counted() -> None:
    bad = plain(tissue__length=0, tissue__height=0, tissue__depth=0, gravity=-1, bed="yes")
    message = complaint(lambda: Scene.from_data(bad))
    assert message.count("allowed") == 3
    assert message.startswith("tissue.length = 0 m, allowed (0, 0.5] m; tissue.height")
    assert message.endswith("; and 2 more")


def test_constructors_complain_in_the_same_words() -> None:
    assert complaint(lambda: Limits(strain=2.0)) == "strain = 2.0, allowed (0, 1)"
    parts = plain()
    parts["tissue"]["height"] = -1.0
    assert complaint(lambda: Scene(**parts)) == "tissue.height = -1.0 m, allowed (0, 0.05] m"


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8) | st.integers(), inner, max_size=3)
    ),
    max_leaves=6,
)
PLACES = [
    *[(key,) for key in ("name", "tissue", "line_of_sight", "limits", "jaws", "gravity", "bed", "more")],
    *[
        ("tissue", key)
        for key in ("length", "height", "depth", "density", "modulus", "poisson", "veins", "more")
    ],
    ("tissue", "veins", 0),
    *[("tissue", "veins", 0, key) for key in ("outline", "modulus", "poisson", "more")],
    ("tissue", "veins", 0, "outline", 2),
    ("tissue", "veins", 0, "outline", 2, 1),
    ("line_of_sight", "camera"),
    ("line_of_sight", "target", 0),
]


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(PLACES), JUNK)
def test_junk_anywhere_gives_a_scene_or_one_line(place: tuple[Any, ...], junk: Any) -> None:
    data: Any = with_veins(copy.deepcopy(SQUARE))
    spot = data
    for key in place[:-1]:
        spot = spot[key]
    spot[place[-1]] = junk
    try:
        scene = Scene.from_data(data)
    except SceneError as error:
        message = str(error)
    else:
        message = "fine"
        assert Scene.from_data(scene.dump()) == scene
    assert len(message.splitlines()) == 1
    assert len(message) < 1000


# --- Line of sight


@given(st.floats(-0.4, -1e-3), st.floats(0.05, math.pi / 2), st.floats(0.05, 5.0))
def test_line_at_a_slope_has_that_slope_and_length(target: float, slope: float, distance: float) -> None:
    line = LineOfSight.at(target, slope, distance)
    assert line.target == (target, 0.0)
    assert math.dist(line.camera, line.target) == pytest.approx(distance, rel=1e-12)
    # Rounding moves the camera by an ulp of its coordinates, at most 5.4 m, seen from at least 0.05 m.
    assert line.slope == pytest.approx(slope, abs=4 * np.spacing(5.4) / 0.05)
    assert 0 < line.slope <= math.pi / 2


@pytest.mark.parametrize("slope", [0.0, -0.1, math.nextafter(math.pi / 2, 2), math.nan])
def test_slopes_beyond_the_vertical_or_the_bed_are_refused(slope: float) -> None:
    assert f"slope = {slope} rad, allowed (0, 1.5708] rad" == complaint(lambda: LineOfSight.at(-0.01, slope))


# --- Files


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file or directory"),
        (b"", "the file is empty"),
        (b"# only a comment\n", "the file is empty"),
        (b"\xff\xfe\x00", "not UTF-8 text (byte 0)"),
        (b"name: \x00", "not readable as YAML: special characters are not allowed"),
        (b"name: [1, 2", "not readable as YAML, line 1, column 12"),
        (b"name: a\n---\nname: b\n", "not readable as YAML, line 2, column 1: but found another document"),
        (
            b"name: a\ngravity: 1.0\ngravity: 2.0\n",
            "not readable as YAML, line 3, column 1: key gravity given twice",
        ),
        (b"tissue: {height: 1.0, 'height': 1.0}", "line 1, column 23: key height given twice"),
        (b"name: !!python/object:os.system {}", "could not determine a constructor"),
        (b"name: 2001-13-45", "not readable as YAML: month must be in"),
        (b"name: " + b"9" * 5000, "not readable as YAML"),
        (b"name: " + b"[" * 500, "not readable as YAML"),
        (b"just text", "scene = 'just text', not a mapping"),
        (b"&a {tissue: *a}", "line 1, column 13: alias a within what it stands for"),
        (b"{[1]: 2}", "not readable as YAML, line 1, column 2: found unhashable key"),
        (b"name: a", "tissue: missing; line_of_sight: missing"),
    ],
)
def test_a_file_that_is_no_scene_is_said_in_one_line(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    file = tmp_path / "case.yaml"
    if content is not None:
        file.write_bytes(content)
    said = complaint(lambda: load_scene(file))
    assert said.startswith(f"{file}: ")
    assert message in said


def test_a_directory_is_no_scene(tmp_path: Path) -> None:
    assert complaint(lambda: load_scene(str(tmp_path))).startswith(f"{tmp_path}: ")


def test_numbers_may_be_written_as_yaml_1_2_has_them(tmp_path: Path) -> None:
    text = yaml.safe_dump(plain()).replace("40000.0", "4e4").replace("0.0044", "44E-4")
    file = tmp_path / "scene.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + text.encode())  # and a byte order mark does no harm
    assert "4e4" in text
    assert "44E-4" in text
    assert load_scene(file) == Scene.from_data(plain())
    file.write_text(text.replace("4e4", "'4e4'"))
    assert "modulus = '4e4', not a number" in complaint(lambda: load_scene(file))


def test_anchors_and_merges_work(tmp_path: Path) -> None:
    data = yaml.safe_dump(with_veins())
    veins = f"""
  veins:
  - &vein {{outline: {SQUARE}, modulus: 2.0e+5}}
  - {{<<: *vein, outline: {moved(SQUARE, dx=0.01)}}}
"""
    file = tmp_path / "scene.yaml"
    file.write_text(data.replace("\n  veins: []\n", veins))
    assert load_scene(file) == Scene.from_data(with_veins(SQUARE, moved(SQUARE, dx=0.01)))
