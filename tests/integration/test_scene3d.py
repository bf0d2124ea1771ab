"""The view of a job's scene, and of an asset, in three dimensions, in a real browser."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from scene_attack.scenes.view import camera_pose
from tests.integration.browser import ARGUMENTS, launched
from tests.integration.conftest import Stack
from tests.integration.scene3d_view import (
    GROUND,
    SOFTWARE,
    changed,
    drawn_after,
    framed,
    looking,
    opened,
    overlap,
    radio,
    stored,
)
from tests.integration.test_accessibility import AXE, LOOKS, serious
from tests.integration.test_export import textured_glb

pytestmark = pytest.mark.integration

LAMPS = {
    "ambient": 0.3,
    "points": [{"energy": 18}],
    "directional": [{"energy": 1, "direction": [1, -1, -0.5]}],
    "spots": [{"position": [0, 2, 2], "direction": [0, -2, -2.2], "inner_angle": 0.1, "outer_angle": 0.3}],
}
MOVED: dict[str, Any] = {
    "scene": {
        "camera": {"size": [96, 160], "elevation": 0.4},
        "objects": [{"mesh": "furniture/drill"}],
        "ground": [channel / 255 for channel in GROUND],
        "lights": LAMPS,
    },
    "attack": {
        "renderer": "pyrender",
        "method": "cma-es",
        "steps": 6,
        "groups": ["illumination", "color", "translation", "rotation", "camera"],
    },
    "seed": 3,
}
"""The search draws all coordinates at random, so that lights, colours, poses and the camera have moved."""
LIT_BY_MAP: dict[str, Any] = {
    "scene": {
        "camera": {"size": [64, 64]},
        "objects": [{"mesh": "primitive/sphere", "material": "matte", "translation": [0.3, 0.1, 0]}],
        "ground": [channel / 255 for channel in GROUND],
    },
    "attack": {"renderer": "torch", "steps": 1},
}


@pytest.fixture(scope="module")
def jobs(stack: Stack) -> dict[str, str]:
    """The ids of jobs that have ended: of the pyrender renderer, of it with an object that has all maps and vertex
    colours, and of the torch renderer."""
    uploaded = stack.client.post("/v1/assets", files={"file": ("square.glb", textured_glb())}, data={"kind": "glb"})
    square = {"mesh": uploaded.json()["name"], "rotation": [0.2, 0.5, 0]}
    textured = MOVED | {"scene": MOVED["scene"] | {"objects": [square], "camera": {"size": [128, 128]}}}
    ids = {
        name: stack.submit(spec)
        for name, spec in (("moved", MOVED), ("textured", textured), ("lit by map", LIT_BY_MAP))
    }
    for job_id in ids.values():
        job = stack.ended(job_id)
        assert job["state"] == "succeeded", job["failure"]
    return ids


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched(*SOFTWARE) as browser:
        yield browser


@pytest.mark.parametrize("job", ["moved", "textured"])
def test_from_the_image_s_camera_the_view_is_the_image(
    stack: Stack, browser: Browser, jobs: dict[str, str], job: str
) -> None:
    with looking(browser, stack) as page:
        opened(page, stack, jobs[job])
        drawn_after(page, lambda: page.get_by_label("Lights and camera").uncheck())
        for side, other in (("original", "attacked"), ("attacked", "original")):
            drawn_after(page, radio(page, side.capitalize()).check)
            image = stored(stack, jobs[job], side)
            shown = framed(page, image.shape[:2])
            assert overlap(shown, image) > 0.96  # of an image that is shifted by one pixel it is at most 0.93
            assert overlap(shown, stored(stack, jobs[job], other)) < 0.9
            object_seen = np.abs(image - GROUND).max(axis=-1) > 12
            assert np.abs(shown - image)[object_seen].mean() < 8  # its lights and materials, too


def test_each_choice_stands_beside_its_words(stack: Stack, browser: Browser, jobs: dict[str, str]) -> None:
    with looking(browser, stack) as page:
        opened(page, stack, jobs["moved"])
        for name in ("Original", "Attacked", "Both"):
            choice = radio(page, name).bounding_box()
            words = page.locator("scene-3d label", has_text=name).bounding_box()
            assert choice is not None
            assert words is not None
            assert words["height"] < 2 * choice["height"], name  # one line
            assert words["width"] > 2 * choice["width"], name
        bar = page.locator("scene-3d .bar").evaluate("bar => [bar.scrollHeight, bar.clientHeight]")
        assert bar[0] <= bar[1]


def test_the_view_turns_and_zooms_by_pointer_keys_and_buttons(
    stack: Stack, browser: Browser, jobs: dict[str, str]
) -> None:
    with looking(browser, stack) as page:
        opened(page, stack, jobs["moved"])
        canvas, status = page.locator("scene-3d canvas"), page.locator("scene-3d [role=status]")
        first = drawn_after(page, lambda: page.get_by_label("Lights and camera").uncheck())
        box = canvas.bounding_box()
        assert box is not None
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(*middle)
        page.mouse.down()
        dragged = drawn_after(page, lambda: page.mouse.move(middle[0] + 90, middle[1] + 30))
        page.mouse.up()
        assert changed(dragged, first) > 0.02

        canvas.focus()
        drawn_after(page, lambda: page.keyboard.press("0"))
        place = status.inner_text()
        assert place.startswith("Azimuth")
        turned = drawn_after(page, lambda: page.keyboard.press("ArrowRight"))
        assert changed(turned, first) > 0.01
        assert status.inner_text() != place
        nearer = drawn_after(page, lambda: page.keyboard.press("+"))
        assert changed(nearer, turned) > 0.01
        again = drawn_after(page, lambda: page.keyboard.press("0"))
        assert changed(again, first) < 0.002
        assert status.inner_text() == place

        near = drawn_after(page, lambda: page.get_by_role("button", name="Come nearer").click())
        assert changed(near, again) > 0.01
        drawn_after(page, lambda: page.get_by_role("button", name="Camera of the image").click())
        away = drawn_after(page, lambda: page.get_by_role("button", name="Go away").click())
        assert changed(away, again) > 0.01


def test_a_side_is_seen_from_its_own_camera_until_the_view_is_turned(
    stack: Stack, browser: Browser, jobs: dict[str, str]
) -> None:
    with looking(browser, stack) as page:
        opened(page, stack, jobs["moved"])
        drawn_after(page, lambda: page.get_by_label("Lights and camera").uncheck())
        after = drawn_after(page, lambda: radio(page, "Original").check())
        page.locator("scene-3d canvas").focus()
        drawn_after(page, lambda: page.keyboard.press("ArrowLeft"))
        place = page.locator("scene-3d [role=status]").inner_text()
        drawn_after(page, lambda: radio(page, "Attacked").check())
        assert page.locator("scene-3d [role=status]").inner_text() == place
        drawn_after(page, lambda: radio(page, "Original").check())
        page.locator("scene-3d canvas").focus()
        assert changed(drawn_after(page, lambda: page.keyboard.press("0")), after) < 0.002


def test_marks_and_a_shade_of_the_original_come_and_go(stack: Stack, browser: Browser, jobs: dict[str, str]) -> None:
    with looking(browser, stack) as page:
        opened(page, stack, jobs["moved"])
        page.locator("scene-3d canvas").focus()
        with_marks = drawn_after(page, lambda: page.keyboard.press("ArrowUp"))
        bare = drawn_after(page, lambda: page.get_by_label("Lights and camera").uncheck())
        assert changed(with_marks, bare) > 0.001
        both = drawn_after(page, lambda: radio(page, "Both").check())
        assert changed(both, bare) > 0.005


def test_a_job_that_moves_nothing_has_one_scene(stack: Stack, browser: Browser, jobs: dict[str, str]) -> None:
    with looking(browser, stack) as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        opened(page, stack, jobs["lit by map"])
        assert [url for url in asked if "scene.glb" in url] == [
            f"{stack.client.base_url}/v1/jobs/{jobs['lit by map']}/scene.glb?which=before"
        ]
        expect(page.locator("scene-3d").get_by_role("radio")).to_have_count(0)
        drawn_after(page, lambda: page.get_by_label("Camera", exact=True).uncheck())
        image = stored(stack, jobs["lit by map"], "original")
        assert overlap(framed(page, image.shape[:2]), image) > 0.97


def test_nothing_is_loaded_before_the_part_is_opened(stack: Stack, browser: Browser, jobs: dict[str, str]) -> None:
    with looking(browser, stack) as page:
        large: list[str] = []
        page.on("request", lambda request: large.append(request.url) if is_large(request.url) else None)
        page.goto(f"{stack.client.base_url}/jobs/{jobs['moved']}")
        page.wait_for_load_state("networkidle")
        assert large == []
        page.locator("#scene3d-details > summary").click()
        expect(page.locator("scene-3d canvas")).to_be_visible()
        assert len(large) == 4
        for url in large:
            if "three" in url:
                answer = stack.client.get(url)
                assert answer.headers["content-encoding"] == "gzip"
                assert answer.headers["cache-control"] == "max-age=31536000, immutable"


def is_large(url: str) -> bool:
    return "/vendor/" in url or "/scene.glb" in url


def test_without_webgl_there_is_a_sentence_and_nothing_is_loaded(
    stack: Stack, browser: Browser, jobs: dict[str, str]
) -> None:
    arguments = [*ARGUMENTS, "--disable-3d-apis"]
    with (
        closing(browser.browser_type.launch(executable_path="/usr/bin/chromium", args=arguments)) as without,
        looking(without, stack) as page,
    ):
        large: list[str] = []
        page.on("request", lambda request: large.append(request.url) if is_large(request.url) else None)
        page.goto(f"{stack.client.base_url}/jobs/{jobs['moved']}")
        page.locator("#scene3d-details > summary").click()
        expect(page.locator("scene-3d [role=status]")).to_contain_text("this browser has no WebGL")
        expect(page.locator("scene-3d canvas")).to_be_hidden()
        assert large == []


def test_without_javascript_the_files_are_there(stack: Stack, browser: Browser, jobs: dict[str, str]) -> None:
    with looking(browser, stack, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/jobs/{jobs['moved']}")
        page.locator("#scene3d-details > summary").click()
        expect(page.get_by_text("The view needs JavaScript and WebGL")).to_be_visible()
        expect(page.locator("scene-3d button").first).to_be_hidden()
        link = page.get_by_role("link", name="scene_after.glb")
        assert stack.client.get(str(link.get_attribute("href"))).content[:4] == b"glTF"


def test_an_asset_turns_on_its_page(stack: Stack, browser: Browser) -> None:
    with looking(browser, stack) as page:
        page.goto(f"{stack.client.base_url}/assets/furniture/drill")
        page.locator("#scene3d-details > summary").click()
        expect(page.locator("scene-3d")).to_have_attribute("data-drawings", "1")
        first = drawn_after(page, lambda: page.get_by_role("button", name="Return").click())
        page.locator("scene-3d canvas").focus()
        turned = drawn_after(page, lambda: page.keyboard.press("ArrowRight"))
        assert changed(turned, first) > 0.01
        link = page.locator("#scene3d-details").get_by_role("link")
        assert stack.client.get(str(link.get_attribute("href"))).content[:4] == b"glTF"


def test_a_viewpoint_is_the_camera_of_the_service(stack: Stack, browser: Browser) -> None:
    cameras = [(0.4, 0.3, 1.8, 0.0), (-2.9, -1.2, 0.7, 0.5), (1.1, np.pi / 2, 2.0, -0.3), (0.2, 2.0, 1.0, 0.0)]
    poses = [camera_pose(*one).T.ravel().tolist() for one in cameras]
    with looking(browser, stack) as page:
        page.goto(f"{stack.client.base_url}/targets")
        script = """async (poses) => {
          const { pose, viewpoint } = await import('/static/orbit.js');
          return poses.map((one) => [viewpoint(one), pose(viewpoint(one))]);
        }"""
        found = page.evaluate(script, poses)
    for camera, matrix, (view, again) in zip(cameras, poses, found, strict=True):
        assert again == pytest.approx(matrix, abs=1e-7)
        if abs(camera[1]) < np.pi / 2:  # elsewhere the same camera has other numbers
            assert [view[name] for name in ("azimuth", "elevation", "distance", "roll")] == pytest.approx(camera)


@pytest.mark.parametrize(("theme", "width"), LOOKS)
def test_the_open_view_is_accessible(
    stack: Stack, browser: Browser, jobs: dict[str, str], theme: str, width: int
) -> None:
    with looking(browser, stack, color_scheme=theme, viewport={"width": width, "height": 900}) as page:
        opened(page, stack, jobs["moved"])
        page.evaluate(AXE)
        assert serious(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
