"""The page in a real browser, opened from a file: Chromium, found on the machine, driven by playwright."""

from __future__ import annotations

import base64
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from baselines.pictures.page import page
from retract_env.drawing.palette import SIGHT, STRAIN, rgb
from tests.baselines.pictures.pages import HOSTILE, two_plans

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright, of the extra `dev`, drives the browser"
)
FOUND = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(FOUND is None, reason="no Chromium on this machine: apt install chromium")

# software draws, as there may be no graphics card; Chromium as root has no sandbox
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
PATIENCE = 240_000
"""ms, of a machine that does other work"""

Pixels = NDArray[np.int64]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("page") / "two plans.html"
    found.write_text(page(two_plans()), encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=FOUND, args=ARGUMENTS, timeout=PATIENCE)
        yield found
        found.close()


def opened(browser: Any, file: Path, width: int = 1200, dark: bool = False) -> tuple[Any, list[str]]:
    """The page, still at its beginning, and what goes wrong in it."""
    context = browser.new_context(
        viewport={"width": width, "height": 800},
        reduced_motion="reduce",
        color_scheme="dark" if dark else "light",
        offline=True,
    )
    context.set_default_timeout(PATIENCE)
    tab, wrong = context.new_page(), []
    tab.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
    tab.on("pageerror", lambda problem: wrong.append(str(problem)))
    tab.goto(file.as_uri(), wait_until="commit")
    tab.wait_for_selector("body.ready")
    drawn(tab)
    return tab, wrong


def drawn(tab: Any) -> None:
    """Wait until all that was asked for is in the picture."""
    tab.wait_for_function("!retract.state.dirty")


@pytest.fixture(scope="module")
def tab(browser: Any, file: Path) -> Iterator[Any]:
    found, wrong = opened(browser, file)
    yield found
    assert wrong == []
    found.context.close()


@pytest.fixture(autouse=True)
def at_the_beginning(request: pytest.FixtureRequest) -> None:
    if "tab" in request.fixturenames:
        tab = request.getfixturevalue("tab")
        tab.evaluate("retract.stop(); retract.goTo(0)")
        drawn(tab)


def go_to(tab: Any, time: float) -> None:
    tab.evaluate(f"retract.goTo({time})")
    drawn(tab)


def picture(tab: Any, view: int = 0) -> Pixels:
    """(h, w, 3) what a view shows."""
    url = tab.evaluate(f"retract.views[{view}].canvas.toDataURL()")
    image = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGB")
    return np.asarray(image, np.int64)


def places(tab: Any, view: int = 0) -> NDArray[np.float64]:
    """(n, 3) mm, the flap's nodes as they are drawn."""
    found = tab.evaluate(f"[...retract.views[{view}].flap.endNow]")
    return np.array(found).reshape(-1, 3)


def near(pixels: Pixels, colour: tuple[int, int, int], off: int = 12) -> int:
    """How many pixels have that colour."""
    return int((np.abs(pixels - colour).max(axis=-1) <= off).sum())


def test_the_verdicts_are_there(tab: Any) -> None:
    assert [badge.inner_text() for badge in tab.query_selector_all(".view .badge")] == [
        "certified",
        "not certified",
    ]
    assert HOSTILE in tab.inner_text("h1") and HOSTILE in tab.title()
    assert tab.query_selector("img") is None
    assert tab.inner_text("#chart-strain .now") != ""


def test_the_slider_moves_the_flap_and_the_picture(tab: Any) -> None:
    flat, before = places(tab), picture(tab)
    tab.locator("#time").fill("700")
    drawn(tab)
    lifted, after = places(tab), picture(tab)
    assert lifted[:, 1].max() > flat[:, 1].max() + 5  # mm
    assert (np.abs(after - before).max(axis=-1) > 40).mean() > 0.01
    assert "lifting" in tab.get_attribute("#time", "aria-valuetext")
    assert "first <b>: strain" in tab.get_attribute("#time", "aria-valuetext")


def test_the_picture_has_the_colours_it_should(tab: Any) -> None:
    assert near(picture(tab), rgb(SIGHT)) > 100  # the line of sight, and what is to be seen
    go_to(tab, 1)
    assert near(picture(tab), rgb(SIGHT)) > 500
    tab.click("input[value=flap]")
    drawn(tab)
    strained = picture(tab)
    tab.click("input[value=off]")
    drawn(tab)
    plain = picture(tab)
    tab.click("input[value=flap]")
    assert (np.abs(strained - plain).max(axis=-1) > 20).mean() > 0.01
    bar = tab.evaluate("[...document.querySelector('#bar').getContext('2d').getImageData(0, 0, 256, 1).data]")
    assert np.array_equal(np.array(bar).reshape(256, 4)[:, :3], STRAIN)


def test_one_plan_may_be_in_both_pictures(tab: Any) -> None:
    go_to(tab, 0.5)
    second = tab.locator(".view select").nth(1)
    second.select_option("0")
    badge = "document.querySelectorAll('.view .badge')[1].textContent"
    tab.wait_for_function(f"{badge} === 'certified'")
    drawn(tab)
    both = picture(tab, 0), picture(tab, 1)
    shown = tab.evaluate("retract.views.map((view) => view.flap.group.parent === view.stage.world)")
    second.select_option("1")
    tab.wait_for_function(f"{badge} === 'not certified'")
    drawn(tab)
    assert (np.abs(both[0] - both[1]).max(axis=-1) > 40).mean() < 0.01  # nothing is missing from either
    assert shown == [True, True]


def test_veins_are_seen_through_the_tissue(tab: Any) -> None:
    solid = picture(tab)
    tab.click("input[value=veins]")
    drawn(tab)
    assert tab.is_checked("#through")
    assert (np.abs(picture(tab) - solid).max(axis=-1) > 10).mean() > 0.01
    tab.click("#through")
    tab.click("input[value=flap]")
    drawn(tab)
    assert np.array_equal(picture(tab), solid)


def test_two_plans_run_in_step(tab: Any) -> None:
    """The second goes the same way in twice as many waypoints: at the same share it is where the first is."""
    for time in (0.0, 0.4, 1.0):
        go_to(tab, time)
        assert places(tab, 1) == pytest.approx(places(tab, 0), abs=0.02)
    before = tab.evaluate("retract.views[1].stage.camera.position.toArray()")
    tab.click("[data-orbit='0.26 0']")
    drawn(tab)
    one, other = (tab.evaluate(f"retract.views[{k}].stage.camera.position.toArray()") for k in (0, 1))
    assert one == pytest.approx(other) and other != pytest.approx(before)


def test_keys_play_and_step(tab: Any) -> None:
    tab.evaluate("document.activeElement.blur()")
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("retract.state.time") == pytest.approx(0.01)
    tab.keyboard.press("End")
    assert tab.evaluate("retract.state.time") == 1
    tab.keyboard.press("Home")
    tab.keyboard.press(" ")
    assert tab.get_attribute("#play", "aria-label") == "Pause"
    tab.wait_for_function("retract.state.time > 0.02")
    tab.keyboard.press(" ")
    assert tab.get_attribute("#play", "aria-label") == "Play"


def test_a_click_in_a_curve_goes_there(tab: Any) -> None:
    box = tab.locator("#chart-clearance svg").bounding_box()
    tab.locator("#chart-clearance svg").click(position={"x": 0.5 * box["width"], "y": 60})
    left, right = 34, 8  # px beside the curve
    share = (0.5 * box["width"] - left) / (box["width"] - left - right)
    assert tab.evaluate("retract.state.time") == pytest.approx(share, abs=0.01)
    assert float(tab.input_value("#time")) == pytest.approx(1000 * share, abs=15)


def test_a_candidate_opens_and_moves_by_the_rod(tab: Any) -> None:
    tab.click("summary >> text=What the planner tried")
    tab.click("button[aria-controls]")
    assert tab.get_attribute("button[aria-controls]", "aria-expanded") == "true"
    assert "Candidate 1: grasped" in tab.inner_text("tr.told:not([hidden])")
    tab.click("button[data-tried]")
    tab.wait_for_selector(".note:not([hidden]) >> text=not certified")
    assert tab.inner_text(".view .badge") == "not certified: by the rod"
    label = tab.get_attribute(".view canvas", "aria-label")
    assert "first <b>, candidate 1. not certified: by the rod." in label
    assert "first <b>, candidate 1: strain" in tab.get_attribute("#time", "aria-valuetext")
    tab.evaluate("retract.stop(); retract.goTo(1)")
    drawn(tab)
    fine = places(tab, 1)[:, :2]
    # the rod lifts the flap's end to where finite elements do
    assert np.abs(places(tab)[:, :2].min(axis=0) - fine.min(axis=0)).max() < 3  # mm
    assert np.abs(places(tab)[:, :2].max(axis=0) - fine.max(axis=0)).max() < 3
    tab.click(".note:not([hidden]) button")
    tab.wait_for_selector(".note", state="hidden")
    assert tab.inner_text(".view .badge") == "certified"
    assert "first <b>. certified." in tab.get_attribute(".view canvas", "aria-label")
    assert "first <b>: strain" in tab.get_attribute("#time", "aria-valuetext")


def test_what_can_be_used_has_a_name(tab: Any) -> None:
    unnamed = tab.evaluate(
        """[...document.querySelectorAll("button, input, select, canvas[tabindex], svg[role]")]
        .filter((one) =>
        !(one.getAttribute("aria-label") || one.labels?.length || one.textContent.trim())).length"""
    )
    assert unnamed == 0


@pytest.mark.parametrize("dark", [False, True])
def test_narrow_pages_do_not_scroll_sideways(browser: Any, file: Path, dark: bool) -> None:
    tab, wrong = opened(browser, file, width=400, dark=dark)
    go_to(tab, 1)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 400
    assert near(picture(tab), rgb(SIGHT)) > 50
    first, second = (tab.locator(".view").nth(k).bounding_box() for k in (0, 1))
    assert second["y"] >= first["y"] + first["height"]  # one below the other
    back = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, back[4:-1].split(","))) < 200) == dark
    assert wrong == []
    tab.context.close()
