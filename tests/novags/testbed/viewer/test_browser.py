"""Claims about `novags view`, by a real browser: what it shows is what the runs and the sensor model say."""

import io
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from novags.splats import read_ply
from novags.testbed.console.terminal import Console
from novags.testbed.viewer.session import viewmat_of
from novags.testbed.viewer.shown import Shown, shown_of
from novags.testbed.viewer.splats import rendered
from sensor_model import develop, expose, photons_for_electrons, srgb_to_linear
from simscenes.sets.pictures.png import read_png

pytestmark = pytest.mark.slow  # a browser without a GPU takes half a minute for them

QUIET = Console(quiet=True)
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# viser's own, of every scene with Gaussians: three.js measures their quads, which have two coordinates and not three.
VISERS = "THREE.BufferGeometry.computeBoundingSphere(): Computed radius is NaN"


@pytest.fixture(scope="module")
def shown(runs: dict[str, Path]) -> Shown:
    (found,) = shown_of([runs["first"], runs["second"]], QUIET)
    return found


@pytest.fixture(scope="module")
def opened(shown: Shown) -> Iterator[tuple[Any, Any, list[str]]]:
    """The viewer's page, its session in the server, and what the browser complained of."""
    pytest.importorskip("viser", reason="novags view needs the extra view, which is not installed")
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright, which drives the browser, is missing")
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed, and pages can be tested in a browser alone")
    from novags.testbed.viewer.server import serving

    complaints: list[str] = []
    with serving([shown], "127.0.0.1", 8300) as viewer, sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("requestfailed", lambda request: complaints.append(f"{request.url} failed"))
        page.set_default_timeout(60_000)
        page.goto(viewer.address)
        page.wait_for_selector("canvas")
        until(lambda: viewer.sessions and next(iter(viewer.sessions.values())).exposed is not None)
        yield page, next(iter(viewer.sessions.values())), complaints
        browser.close()


def until(holds: Callable[[], Any], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def exposed(page: Any) -> np.ndarray:
    """The picture in the panel, as the browser got it; without the enlargement."""
    codes = page.evaluate("""([width, height]) => {
        const picture = [...document.images].find(i => i.src.startsWith("blob:"));
        const context = Object.assign(document.createElement("canvas"), {width, height}).getContext("2d");
        context.imageSmoothingEnabled = false;
        context.drawImage(picture, 0, 0, width, height);
        return [...context.getImageData(0, 0, width, height).data];
    }""", [64, 48])  # fmt: skip
    return np.array(codes, np.uint8).reshape(48, 64, 4)[..., :3]


def choose(page: Any, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()


def test_the_page_shows_gaussians_and_cameras_and_complains_of_nothing(opened: tuple[Any, Any, list[str]]) -> None:
    page, session, complaints = opened
    until(lambda: len(session.plates) == 9)
    canvas = page.locator("canvas").first
    full = pixels(canvas.screenshot())
    page.get_by_role("checkbox", name="Gaussians").click()
    page.get_by_role("checkbox", name="Cameras").click()
    until(lambda: not session.nodes and not any(plate.visible for plate in session.plates.values()))
    time.sleep(0.3)
    empty = pixels(canvas.screenshot())
    assert (np.abs(full.astype(int) - empty).max(-1) > 30).mean() > 0.05
    page.get_by_role("checkbox", name="Gaussians").click()
    page.get_by_role("checkbox", name="Cameras").click()
    assert [said for said in complaints if not said.startswith(VISERS)] == []


def test_the_level_slider_exposes_the_true_view_as_the_sensor_model_does(
    opened: tuple[Any, Any, list[str]], shown: Shown, runs: dict[str, Path]
) -> None:
    page, session, _ = opened
    view = shown.world.nearest(viewmat_of(session.client.camera.wxyz, session.client.camera.position))
    photographs = [
        srgb_to_linear(read_png(path)) for path in sorted((runs["capture"].parent / "photos/images").iterdir())
    ]
    green, sensor = float(np.mean([light[..., 1].mean(dtype=np.float64) for light in photographs])), shown.camera.sensor
    for power in (-1, 1, 3.25):
        page.locator("input[inputmode=decimal]").fill(str(power))
        electrons = 10.0**power
        until(lambda: session.exposed[2:4] == (view, pytest.approx(electrons)))  # noqa: B023
        photons = photons_for_electrons(photographs[view], electrons=electrons, mean_green=green, sensor=sensor)
        frame = expose(photons, sensor, shown.camera.exposure, seed=3, view=view)
        gain = max(1.0, 0.18 * (sensor.white_dn - sensor.black_level) / (electrons * sensor.gain))
        expected = develop(frame, sensor, digital_gain=gain).srgb8
        until(lambda: np.array_equal(exposed(page), expected))  # noqa: B023


def test_switching_the_method_serves_its_gaussians_and_its_light(
    opened: tuple[Any, Any, list[str]], shown: Shown, runs: dict[str, Path]
) -> None:
    page, session, _ = opened
    choose(page, "Light of", "the reconstruction, this view")
    for name, folder in (("naive-l1", "second"), ("naive", "first")):
        choose(page, "Method", name)
        until(lambda: session.panel.method.value == name and session.exposed[5:6] == (name,))  # noqa: B023
        means = read_ply(runs[folder] / "point_cloud.ply").means.numpy()
        served = session.nodes[0].buffer[:, :3].view(np.float32)
        into = shown.scene(name)[1]  # type: ignore[index]
        assert np.allclose(served, into.scale * means @ into.rotation.numpy().T + into.translation.numpy(), atol=1e-4)
        camera, viewed = session.client.camera, shown.scene(name)
        viewmat = viewmat_of(np.asarray(camera.wxyz), np.asarray(camera.position))
        light = srgb_to_linear(np.clip(rendered(*viewed[:2], viewmat, camera.fov, (64, 48)), 0, 1))  # type: ignore[index]
        sensor, electrons = shown.camera.sensor, session.panel.electrons
        photons = photons_for_electrons(light, electrons=electrons, mean_green=shown.run_green(name), sensor=sensor)
        frame = expose(photons, sensor, shown.camera.exposure, seed=3, view=shown.world.nearest(viewmat))
        expected = develop(frame, sensor, digital_gain=shown.camera.brightening(electrons)).srgb8
        until(lambda: np.array_equal(exposed(page), expected))  # noqa: B023


def test_frusta_show_the_pictures_that_are_chosen_and_denoised_ones_where_the_run_has_them(
    opened: tuple[Any, Any, list[str]], runs: dict[str, Path]
) -> None:
    page, session, _ = opened
    choose(page, "Method", "naive-l1")
    for kind, path in {"true": "../photos/images", "dark": "../capture/images", "denoised": "denoised"}.items():
        choose(page, "Pictures", kind)
        until(lambda: session.shown_kind == ("naive-l1", kind))  # noqa: B023
        expected = pixels((runs["second"] / path / "0003.png").read_bytes())
        assert np.array_equal(session.plates[3].image, expected)
    assert session.plates[0].image is None  # held out: nothing was denoised
    choose(page, "Method", "naive")
    until(lambda: session.shown_kind == ("naive", "rendered"))
    assert session.plates[0].image is not None


def test_what_is_missing_is_said_in_the_panel_and_the_viewer_goes_on(
    opened: tuple[Any, Any, list[str]], runs: dict[str, Path]
) -> None:
    page, session, complaints = opened
    for part in ("renders", "exr"):
        (runs["second"] / part).rename(runs["second"] / f"{part}.gone")
    try:
        choose(page, "Method", "naive-l1")
        page.get_by_text("0000.png").wait_for()
    finally:
        for part in ("renders", "exr"):
            (runs["second"] / f"{part}.gone").rename(runs["second"] / part)
    choose(page, "Pictures", "true")
    until(lambda: session.shown_kind == ("naive-l1", "true") and not session.panel.trouble.visible)
    assert [said for said in complaints if not said.startswith(VISERS)] == []
