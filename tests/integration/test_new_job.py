"""The page "New job" in a real browser, on the real stack."""

import base64
import json
import re
from collections.abc import Iterator
from io import BytesIO
from math import ceil, degrees, pi, radians
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, ConsoleMessage, Page, Route, expect

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.scenes.primitives import PRIMITIVES
from tests.integration.browser import fresh_page
from tests.integration.conftest import Stack, until
from tests.integration.specs import QUICK
from tests.integration.test_accessibility import AXE, LOOKS, save, serious, watched

pytestmark = pytest.mark.integration

LIGHT = "canvas => [...canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data].join()"
"""The pixels of the preview."""
UNFOLD = "one => { while ((one = one.parentElement.closest('details'))) one.open = true }"
"""Opens the folds around a field."""


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of a fresh profile. Refused requests are what is tested; any other complaint fails the test."""
    complaints: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type == "error" and "422" not in message.text:
            complaints.append(message.text)

    with fresh_page(browser, viewport={"width": 1440, "height": 1000}) as page:
        page.on("console", listen)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
    assert complaints == []


def spec(page: Page) -> Any:
    return json.loads(page.locator("#spec").input_value())


def wait_for_answer(page: Page) -> None:
    expect(page.locator("#preview")).not_to_have_attribute("aria-busy", "true")
    expect(page.locator("#preview-state")).to_contain_text("The network says")


def test_a_job_is_made_with_the_form_beside_its_preview(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    expect(page.locator("#answers tr")).to_have_count(5)
    before = page.locator("#picture").evaluate(LIGHT)

    page.locator("[id='f-scene.objects.0.mesh']").click()
    page.locator(".meshes label").filter(has_text="Torus").click()  # a radio button that is shown as a picture
    expect(page.locator(".meshes")).to_be_hidden()
    assert spec(page)["scene"]["objects"][0]["mesh"] == "primitive/torus"
    wait_for_answer(page)
    assert page.locator("#picture").evaluate(LIGHT) != before

    steps = page.locator("#f-attack\\.steps")
    steps.fill("many")
    error = page.locator("#f-attack\\.steps-error")
    expect(error).to_contain_text("integer")
    expect(steps).to_have_attribute("aria-invalid", "true")
    page.locator("#submit").click()  # the service refuses it, and the errors are listed
    expect(page.locator("#problems a")).to_have_text("attack.steps")
    steps.fill("2")
    expect(error).to_be_hidden()

    # both ways: what is changed in the JSON is in the fields
    page.locator("#spec").fill(json.dumps(spec(page) | {"seed": 11}))
    expect(page.locator("#f-seed")).to_have_value("11")
    page.locator("#spec").fill(page.locator("#spec").input_value().replace("11", str(2**60 + 1)))
    expect(page.locator("#f-seed")).to_have_value(str(2**60 + 1))
    page.locator("#f-attack\\.steps").fill("3")
    assert spec(page)["seed"] == 2**60 + 1  # a number of JavaScript would be rounded
    page.locator("#f-attack\\.steps").fill("2")
    page.locator("#f-seed").fill("11")
    page.locator("#f-attack\\.renderer").select_option("pyrender")
    expect(page.locator("#f-attack\\.groups-color")).to_be_visible()
    page.locator("#f-attack\\.groups-color").uncheck()
    assert "color" not in spec(page)["attack"]["groups"]
    wait_for_answer(page)

    page.locator("#plan").click()
    expect(page.locator("#cost")).to_contain_text("Up to 2 steps")
    page.locator("#submit").click()
    page.wait_for_url("**/jobs/*")
    job = stack.client.get(f"/v1/jobs/{page.url.rsplit('/', 1)[1]}").json()
    assert job["seed"] == 11
    assert job["spec"]["scene"]["objects"][0]["mesh"] == "primitive/torus"
    assert (job["renderer"], job["spec"]["attack"]["steps"]) == ("pyrender", 2)

    page.goto(f"{stack.client.base_url}/new?from={job['id']}")
    expect(page.locator("#f-attack\\.steps")).to_have_value("2")
    assert spec(page) == job["spec"]


def shown(page: Page, field: str) -> float:
    return float(page.locator(f"[id='f-{field}']").input_value())


@pytest.mark.parametrize("width", [1440, 390])
def test_the_mouse_turns_the_camera_on_the_preview(stack: Stack, page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/torus")
    wait_for_answer(page)
    before = page.locator("#picture").evaluate(LIGHT)
    assert shown(page, "scene.camera.elevation") == pytest.approx(20)  # the default, in degrees
    picture = page.locator("#picture")
    picture.scroll_into_view_if_needed()
    box = picture.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 100 - box["height"] / 4, box["y"] + 100 + box["height"] / 10)
    page.mouse.up()
    camera = spec(page)["scene"]["camera"]
    assert camera["azimuth"] == pytest.approx(0.61 + pi / 4, abs=0.01)  # the height of the picture is half a turn
    assert camera["elevation"] == pytest.approx(pi / 9 + pi / 10, abs=0.01)
    assert shown(page, "scene.camera.azimuth") == pytest.approx(degrees(camera["azimuth"]), abs=0.01)
    another_picture(page, before)
    page.mouse.wheel(0, -200)
    expect(page.locator("[id='f-scene.camera.distance']")).not_to_have_value("1.8")
    assert spec(page)["scene"]["camera"]["distance"] < 1.8


def test_a_job_is_made_with_the_keyboard_alone(stack: Stack, page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    page.locator("[id='f-scene.objects.0.mesh']").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    page.keyboard.type("primitive")
    expect(page.get_by_role("radio")).to_have_count(len(PRIMITIVES))
    page.keyboard.press("Enter")  # which submits nothing
    page.keyboard.press("Tab")  # to the one that is chosen
    expect(page.get_by_role("radio", name="Sphere")).to_be_focused()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    expect(page.locator("[id='f-scene.objects.0.mesh']")).to_be_focused()
    assert spec(page)["scene"]["objects"][0]["mesh"] == "primitive/torus"

    page.locator("#picture").focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("+")
    assert shown(page, "scene.camera.elevation") == pytest.approx(25, abs=0.1)
    assert shown(page, "scene.camera.distance") == pytest.approx(1.8 / 1.1, abs=0.01)
    page.locator("[id='f-scene.camera.azimuth-slider']").focus()
    page.keyboard.press("End")
    assert shown(page, "scene.camera.azimuth") == 180
    page.locator("[id='f-scene.camera.azimuth']").fill("-90")
    assert spec(page)["scene"]["camera"]["azimuth"] == pytest.approx(-pi / 2, abs=1e-5)
    expect(page.locator("[id='f-scene.camera.azimuth-slider']")).to_have_value("-90")
    page.locator("#f-attack\\.steps").fill("1")
    page.locator("#submit").focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/*")
    job = stack.client.get(f"/v1/jobs/{page.url.rsplit('/', 1)[1]}").json()
    attack = job["spec"]["attack"]
    assert (attack["groups"], attack["method"], attack["truncation"]) == (["bump"], "fgsm", None)
    assert job["spec"]["scene"]["camera"]["azimuth"] == pytest.approx(-pi / 2, abs=1e-5)


def test_what_fits_is_offered_and_natural_changes_come_first(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    groups = page.locator("[id='f-attack.groups']")
    for group in RENDERERS["torch"].groups:
        said = group.natural_range or group.explanation
        title = "Changes a thing could have" if group.natural_range else "Free values, without a natural range"
        expect(groups.get_by_role("group", name=title)).to_contain_text(said)
    expect(groups.locator("legend").nth(1)).to_have_text("Changes a thing could have")
    assert groups.locator("input").evaluate_all("all => all.filter(one => one.checked).map(one => one.value)") == [
        "bump"
    ]

    method = page.locator("[id='f-attack.method']")
    expect(method.locator("[value=natural-gradient]")).to_have_count(0)  # it is for renderers without gradients
    method.select_option("square")  # it needs values at each pixel
    expect(groups.locator("input")).to_have_count(1)
    assert spec(page)["attack"]["groups"] == ["normals"]
    page.locator("[id='f-attack.renderer']").select_option("pyrender")
    expect(method).to_have_value("zoo")
    page.locator("[id='f-attack.expectation'] > summary").click()
    page.locator("[id='f-attack.expectation-has']").check()
    assert spec(page)["attack"]["expectation"] == {"azimuth": 30}  # one over nothing would be refused
    page.locator("[id='f-attack.expectation.distance-slider']").fill("10")
    assert spec(page)["attack"]["expectation"]["distance"] == 0.1  # of it; the slider has per cent
    wait_for_answer(page)


def test_an_empty_choice_of_groups_stays_empty_and_is_not_submitted(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    submitted: list[Route] = []
    page.route("**/v1/jobs", lambda route: submitted.append(route))
    groups = page.locator("[id='f-attack.groups']")
    page.locator("[id='f-attack.groups-bump']").uncheck()
    expect(groups.get_by_role("alert")).to_have_text("choose at least one group")
    expect(groups).to_have_accessible_description("choose at least one group")
    expect(groups.locator("input:checked")).to_have_count(0)
    assert spec(page)["attack"]["groups"] == []
    page.locator("#submit").click()
    expect(page.locator("#problems")).to_contain_text("choose at least one group")
    page.locator("#plan").click()
    expect(page.locator("#cost")).to_have_text("choose at least one group")
    assert submitted == []

    page.locator("[id='f-attack.groups-lamp']").check()
    assert spec(page)["attack"]["groups"] == ["lamp"]
    expect(groups.locator(".error")).to_be_empty()
    expect(page.locator("#problems")).to_be_hidden()
    wait_for_answer(page)


def test_a_slider_says_how_much_of_its_natural_range_a_group_may_use(stack: Stack, page: Page) -> None:
    """The share 1 is the default, and is left out of the request."""
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    dents = page.get_by_role("slider", name="dents: share of its natural range")
    rotation = page.get_by_role("slider", name="rotation: share of its natural range")
    expect(dents).to_have_value("100")
    expect(dents).to_have_accessible_description(re.compile("20 mm at a size of 1 m"))
    expect(rotation).to_have_count(0)
    assert "epsilon" not in spec(page)["attack"]
    dents.press("ArrowLeft")
    assert spec(page)["attack"]["epsilon"] == {"bump": 19}
    expect(page.locator("output").first).to_have_text("95 %")
    box = page.locator("[id='f-attack.epsilon']")
    expect(box).to_have_value('{"bump":19}')
    box.evaluate(UNFOLD)
    box.fill('{"bump": 10}')
    expect(dents).to_have_value("50")
    page.locator("#spec").fill(page.locator("#spec").input_value().replace('"bump": 10', '"bump": 5'))
    expect(dents).to_have_value("25")

    page.locator("[id='f-attack.groups-rotation']").check()
    rotation.press("Home")
    assert spec(page)["attack"]["epsilon"] == {"bump": 5, "rotation": pytest.approx(radians(5) / 20, rel=1e-3)}
    dents.press("End")
    assert list(spec(page)["attack"]["epsilon"]) == ["rotation"]
    dents.press("Home")
    page.locator("[id='f-attack.groups-bump']").uncheck()
    expect(dents).to_have_count(0)
    assert list(spec(page)["attack"]["epsilon"]) == ["rotation"]  # the service takes none of a group that is left alone
    wait_for_answer(page)


def test_an_image_of_an_earlier_request_is_marked(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    picture = page.locator("#picture")
    expect(picture).to_have_css("opacity", "1")
    held: list[Route] = []
    page.route("**/v1/preview", lambda route: held.append(route))
    page.locator("[id='f-scene.camera.azimuth']").fill("10")
    expect(page.locator("#preview-state")).to_have_text("Drawing …")
    expect(picture).to_have_css("opacity", "0.45")
    expect(picture).to_have_accessible_name("The image of an earlier scene")
    expect(page.locator("#answers")).to_be_hidden()
    until(lambda: page.evaluate("true") and held, "a request")
    held[0].continue_()
    wait_for_answer(page)
    expect(picture).to_have_css("opacity", "1")
    expect(picture).to_have_accessible_name(re.compile("the network says"))
    expect(page.locator("#answers")).to_be_visible()


def test_of_many_changes_only_the_newest_is_drawn(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    held: list[Route] = []
    page.route("**/v1/preview", lambda route: held.append(route))
    azimuth = page.locator("[id='f-scene.camera.azimuth']")

    def sent(number: int) -> bool:
        return page.evaluate("true") and len(held) == number  # the browser is asked, so that its events are handled

    azimuth.fill("10")
    until(lambda: sent(1), "a first request")
    azimuth.fill("20")
    azimuth.fill("30")
    held[0].continue_()
    until(lambda: sent(2), "a second request")
    newest: Any = held[1].request.post_data_json
    assert newest["scene"]["camera"]["azimuth"] == pytest.approx(pi / 6, abs=1e-5)
    held[1].continue_()
    wait_for_answer(page)
    assert len(held) == 2


def noise(height: int, width: int) -> bytes:
    buffer = BytesIO()
    texels = np.random.default_rng(8).integers(0, 256, (height, width, 3), np.uint8)
    Image.fromarray(texels).save(buffer, "PNG")
    return buffer.getvalue()


def another_picture(page: Page, *before: str) -> str:
    """What the preview shows once it is none of these. Right after a change it still has its earlier answer."""
    found: list[str] = []

    def differs() -> bool:
        found.append(page.locator("#picture").evaluate(LIGHT))
        return found[-1] not in before

    until(differs, "another picture")
    return found[-1]


def test_a_picture_is_chosen_as_background(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    plain = page.locator("#picture").evaluate(LIGHT)
    box = page.locator("#f-scene\\.background-has")
    box.evaluate(UNFOLD)
    box.check()
    chooser = page.locator("#f-scene\\.background\\.image")
    chooser.evaluate(UNFOLD)
    state = page.locator("#f-scene\\.background\\.image-state")
    chooser.set_input_files({"name": "a.png", "mimeType": "image/png", "buffer": b"no picture"})
    expect(state).to_contain_text("it is no PNG, JPEG or WebP file")
    assert "image" not in spec(page)["scene"]["background"]

    exact = noise(224, 224)
    chooser.set_input_files({"name": "a.png", "mimeType": "image/png", "buffer": exact})
    expect(state).to_contain_text(f"{ceil(len(exact) / 1000)} kB")
    assert base64.b64decode(spec(page)["scene"]["background"]["image"]) == exact
    shown = another_picture(page, plain)

    page.locator("#f-scene\\.background\\.image").set_input_files(
        {"name": "large.png", "mimeType": "image/png", "buffer": noise(500, 900)}
    )
    expect(state).not_to_contain_text(f"{ceil(len(exact) / 1000)} kB")
    with Image.open(BytesIO(base64.b64decode(spec(page)["scene"]["background"]["image"]))) as fitted:
        assert fitted.size == (224, 224)
    another_picture(page, plain, shown)
    page.get_by_role("button", name="Remove the picture").click()
    assert "image" not in spec(page)["scene"]["background"]
    expect(state).to_contain_text("No picture")


def test_the_preview_stays_in_sight_on_a_low_screen(stack: Stack, page: Page) -> None:
    page.set_viewport_size({"width": 1440, "height": 600})
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    page.locator("#f-attack\\.renderer").scroll_into_view_if_needed()  # far from both ends of the page
    page.locator("#preview").hover()
    page.mouse.wheel(0, 2000)
    expect(page.locator("#plan")).to_be_in_viewport(ratio=1)
    page.locator("#plan").click()
    expect(page.locator("#cost li").last).to_be_in_viewport(ratio=0.9)


def test_without_a_script_the_json_is_a_form(stack: Stack, browser: Browser) -> None:
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        page.locator("#spec").fill("{}")
        page.locator("#submit").click()
        expect(page.locator("#problems")).to_contain_text("scene")
        page.locator("#spec").fill('{"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "attack": {"steps": 1}}')
        page.locator("#submit").click()
        page.wait_for_url("**/jobs/*")


@pytest.mark.parametrize(("theme", "width"), LOOKS)
def test_the_whole_form_is_accessible(stack: Stack, browser: Browser, theme: Any, width: int) -> None:
    """With its preview, every fold open, a list of errors, and messages at fields of all kinds."""
    with fresh_page(browser, color_scheme=theme, viewport={"width": width, "height": 900}) as page:
        complaints = watched(page, str(stack.client.base_url))
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        wait_for_answer(page)
        expect(page.locator("#warnings")).to_be_visible()  # nobody has said what the sphere is
        expect(page.locator("#plan")).to_be_in_viewport(ratio=1)
        save(page, f"new-preview-{theme}-{width}.png")
        for field in ("scene.objects.0.scale", "seed", "scene.camera.size.0", "attack.steps"):
            page.locator(f"[id='f-{field}']").evaluate(UNFOLD)
            page.locator(f"[id='f-{field}']").fill("-1")
        page.locator("#submit").click()
        expect(page.locator("#problems a")).to_have_count(4)
        for field in ("scene.objects.0.scale", "seed", "scene.camera.size", "attack.steps"):
            expect(page.locator(f"[id='f-{field}-error']")).not_to_be_empty()
        axes = page.locator("[id='f-scene.objects.0.rotation'] label")
        expect(axes).to_have_text(["x", "y", "z"])
        assert axes.evaluate_all("all => new Set(all.map(one => one.offsetTop)).size") == 1  # one line
        page.locator("#f-scene\\.background-has").evaluate(UNFOLD)
        page.locator("#f-scene\\.background-has").check()
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        save(page, f"new-errors-{theme}-{width}.png")
        page.evaluate(AXE)
        assert serious(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), "it scrolls sideways"
        assert [one for one in complaints if "422" not in one] == []


@pytest.mark.parametrize("which", ["beside the fields", "beside the preview"])
def test_a_pressed_button_says_at_once_that_the_request_is_checked(stack: Stack, page: Page, which: str) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    held: list[Route] = []
    page.route("**/v1/jobs", lambda route: held.append(route))
    buttons = page.get_by_role("button", name="Submit the job")
    pressed = buttons.nth(0 if which == "beside the fields" else 1)
    place = "#submit" if which == "beside the fields" else "#preview [type=submit]"
    pressed.click()
    expect(page.locator(place)).to_have_text("Checking…")
    expect(page.locator("#submitting")).to_have_text("Checking…")
    expect(page.locator("[type=submit][form=new], #submit").and_(page.locator(":disabled"))).to_have_count(2)
    held[0].fulfill(status=422, json={"detail": "no", "errors": [{"field": "seed", "detail": "no"}]})
    expect(page.locator("#problems")).to_contain_text("seed")
    expect(buttons).to_have_count(2)
    expect(page.locator("#submitting")).to_be_empty()


def test_a_form_of_the_service_s_own_waits_too_and_works_without_a_script(stack: Stack, browser: Browser) -> None:
    """The page of a finished job, whose request is tried again: first with the script, and then without."""
    job = stack.ended(stack.submit(QUICK))
    with fresh_page(browser) as page:
        page.goto(f"{stack.client.base_url}/jobs/{job['id']}")
        page.route("**/retry", lambda route: route.fulfill(status=204))  # so that the browser stays on the page
        page.get_by_role("button", name="Retry").click()
        expect(page.locator("#retry")).to_have_text("Checking…")
        expect(page.locator("#retry")).to_be_disabled()
        expect(page.locator("#submitting")).to_have_text("Checking…")
        page.unroute("**/retry")
        page.reload()
        page.get_by_role("button", name="Retry").click()
        page.wait_for_url(lambda url: job["id"] not in url)
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        assert "Checking it takes a few seconds" in page.content()  # text of `noscript` is none to the driver
        page.get_by_role("button", name="Submit the job").click()
        page.wait_for_url("**/jobs/*")
