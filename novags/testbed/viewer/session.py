"""One browser: its choices, and the thread that shows them."""

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from novags.cameras.align import to_true
from novags.cameras.estimate import Array, centers_of
from novags.testbed.viewer.latest import Latest
from novags.testbed.viewer.light import expose_again
from novags.testbed.viewer.panel import MODEL, NOTHING, TRUTH, ControlPanel
from novags.testbed.viewer.shown import Shown
from novags.testbed.viewer.splats import rendered
from novags.testbed.viewer.world import SIZE, own_cameras, true_from
from sensor_model.files.reading import brief

PLATE = 320  # px; longest side of a picture at a frustum
ENLARGED = 384  # px; about as wide as the panel
TRAINING, HELD_OUT, ESTIMATED = (90, 160, 255), (255, 176, 64), (230, 90, 200)
APART = 1e-3  # viewer units: cameras that are nearer to the true ones are not drawn beside them
FRUSTUM = 0.1  # viewer units; of more than 20 cameras less: they mark places, and the scene is what is looked at
WITHIN = 0.7  # viewer units: a frustum that the viewer stands in, or beside, would cover everything


class Session:
    """The content of one browser. Everything is computed in one thread of its own, and by one session at a time."""

    def __init__(self, client: Any, all_shown: Sequence[Shown], computing: threading.Lock) -> None:
        """Build the controls, and begin with the first run. `computing`: held where sessions share memory."""
        self.client, self.all_shown, self.computing = client, all_shown, computing
        self.plates: dict[int, Any] = {}
        self.nodes: list[Any] = []
        self.estimated: list[Any] = []  # frusta of the cameras that a method had
        self.has_gaussians = True
        self.exposed: tuple[Any, ...] | None = None  # the inputs of the exposed picture
        self.shown_kind: tuple[str, str] | None = None  # method and kind of the pictures, once all are there
        self.latest = Latest(self._update)
        told = all_shown[0].capture.record.simulated
        first = 20.0 if told is None else told.electrons
        self.panel = ControlPanel(client.gui, [shown.title for shown in all_shown], first, self.latest.ask)
        self.latest.ask("capture")
        client.camera.on_update(lambda _: self.latest.ask("move"))

    @property
    def shown(self) -> Shown:
        """The capture that is chosen."""
        return next((s for s in self.all_shown if s.title == self.panel.capture.value), self.all_shown[0])

    def _update(self, parts: frozenset[str]) -> None:
        """Show the present choice. Errors, a folder that was removed say, are shown in the panel."""
        if "capture" in parts:
            parts |= {"splats", "pictures", "light"}
        steps = (
            ({"capture"}, self._enter),
            (parts, self._offer),
            ({"splats"}, self._show_splats),
            ({"splats", "estimated"}, self._show_estimated),
            ({"light", "move"}, self._show_light),
            ({"pictures"}, self._show_pictures),
            (parts, self._clear_the_view),
        )
        troubles = [trouble for asked, step in steps if parts & asked and (trouble := self._trouble_of(step))]
        name = self.panel.method.value
        none = "" if self.has_gaussians else f"{name} has no Gaussians that a browser can draw: see its pictures"
        if not self.latest.over:  # else the browser has gone, and with it all that could be changed
            self._say(troubles[0] if troubles else none)

    def _trouble_of(self, step: Callable[[], None]) -> str:
        """Take a step, and return the error; "": none. A black model has no light, but pictures."""
        try:
            step()
        except Exception as error:  # the thread must outlive every file that is missing
            return f"**{type(error).__name__}**: {brief(error, 500)}"
        return ""

    def _say(self, trouble: str) -> None:
        self.panel.trouble.content, self.panel.trouble.visible = trouble, bool(trouble)

    def _enter(self) -> None:
        """Begin with a capture in its first training view, with the best method and the one to compare it with."""
        shown = self.shown
        for plate in self.plates.values():
            plate.remove()
        self.plates = {}
        for control, first in zip((self.panel.method, self.panel.other), shown.pair, strict=True):
            self.panel.offer(control, tuple(shown.runs), first)
        self.panel.switch.visible = self.panel.other.visible = len(shown.runs) > 1
        self.client.scene.set_up_direction(shown.world.up)
        self._stand_at(shown.capture.cameras.train_indices[0])

    def _offer(self) -> None:
        panel, shown = self.panel, self.shown
        kinds = shown.kinds(panel.method.value)
        panel.offer(panel.pictures, (*kinds, NOTHING), "rendered")
        panel.offer(panel.light, (TRUTH, MODEL) if shown.source.lit_known else (MODEL,), MODEL)

    def _show_splats(self) -> None:
        with self.computing:
            found = self.shown.scene(self.panel.method.value)
        self.has_gaussians = found is not None and found[2] is not None
        for node in self.nodes:
            node.remove()
        self.nodes = []
        if found is None or not self.panel.splats.value:
            return
        drawn = found[2]
        if drawn is None:  # a field, or Gaussians whose pictures a network makes: their pictures and light are shown
            return
        add = self.client.scene.add_gaussian_splats
        self.nodes.append(add("/gaussians", drawn.centers, drawn.covariances, drawn.colors, drawn.opacities))

    def _show_estimated(self) -> None:
        """Where the method had its cameras, if that was somewhere else."""
        for node in self.estimated:
            node.remove()
        self.estimated = []
        shown, run = self.shown, self.shown.runs[self.panel.method.value]
        if not self.panel.cameras.value or (own := own_cameras(run)) is None:
            return
        into = shown.world.from_true @ true_from(run, shown.capture)
        for name, viewmat in zip(own[0], to_true(into, own[1]).numpy(), strict=True):
            true = shown.world.viewmats[shown.capture.names.index(name)]
            if np.abs(viewmat - true).max() > APART:
                self.estimated.append(self._frustum(f"/estimated/{name}", viewmat, ESTIMATED))

    def _frustum(self, name: str, viewmat: Array, color: tuple[int, int, int], **more: Any) -> Any:
        rig = self.shown.capture.cameras.rig
        tall = 2 * np.arctan(rig.height / 2 / rig.Ks[0, 1, 1])
        scale = FRUSTUM * min(1.0, (20 / len(rig.Ks)) ** 0.5)
        return self.client.scene.add_camera_frustum(
            name, float(tall), rig.width / rig.height, scale=scale, color=color, thickness=0.004,
            wxyz=quaternion(viewmat[:3, :3].T), position=centers_of(viewmat[None])[0], cast_shadow=False,
            receive_shadow=False, **more,
        )  # fmt: skip

    def _show_pictures(self) -> None:
        """Every frustum with its picture; left when other pictures are asked for."""
        panel, shown = self.panel, self.shown
        name, kind = panel.method.value, panel.pictures.value
        held_out = set(shown.capture.cameras.test_indices)
        for i, view in enumerate(shown.capture.names):
            if self.latest.pending("pictures") or self.latest.pending("capture"):
                return
            with self.computing:
                picture = None if kind == NOTHING else shown.picture(kind, name, i)
            plate = None if picture is None else small(picture)
            if i not in self.plates:
                color = HELD_OUT if i in held_out else TRAINING
                self.plates[i] = self._frustum(f"/cameras/{view}", shown.world.viewmats[i], color, image=plate)
                self.plates[i].on_click(lambda _, i=i: self._stand_at(i))
            else:
                self.plates[i].image = plate
            self.plates[i].visible = panel.cameras.value
        self.shown_kind = name, kind

    def _stand_at(self, i: int) -> None:
        """Put the viewer where a camera is."""
        viewmat, rig = self.shown.world.viewmats[i], self.shown.capture.cameras.rig
        place, camera = centers_of(viewmat[None])[0], self.client.camera
        with self.client.atomic():
            camera.position, camera.up_direction = place, -viewmat[1, :3]
            camera.look_at = place + SIZE * viewmat[2, :3]
            camera.fov = float(2 * np.arctan(rig.height / 2 / rig.Ks[i, 1, 1]))

    def _clear_the_view(self) -> None:
        """Hide the frusta that the viewer stands in."""
        places = centers_of(self.shown.world.viewmats)
        here = np.asarray(self.client.camera.position)
        for i, plate in self.plates.items():
            wanted = bool(self.panel.cameras.value and np.linalg.norm(places[i] - here) > WITHIN)
            if plate.visible != wanted:
                plate.visible = wanted

    def _show_light(self) -> None:
        """Expose the view that is seen now, and show the developed picture."""
        shown, panel, client = self.shown, self.panel, self.client
        viewmat = viewmat_of(np.asarray(client.camera.wxyz), np.asarray(client.camera.position))
        true, name, view = panel.light.value == TRUTH, panel.method.value, shown.world.nearest(viewmat)
        seen = () if true else (name, viewmat.tobytes(), client.camera.fov)
        made_from = (shown.title, true, view, panel.electrons, panel.brighten.value, *seen)
        if made_from == self.exposed:
            return
        with self.computing:
            light, green = (shown.true_light(view), shown.true_green()) if true else self._modelled(viewmat, view)
            camera = shown.camera if true else shown.camera.for_srgb()
            picture, gain = expose_again(
                light, camera, electrons=panel.electrons, mean_green=green, view=view, brighten=panel.brighten.value
            )
        panel.exposed.image = enlarged(picture)
        what = f"view {shown.capture.names[view]}" if true else name
        panel.said.content = f"{what}: **{panel.electrons:.3g} electrons** per pixel, digital gain {gain:.3g}"
        self.exposed = made_from

    def _modelled(self, viewmat: Array, view: int) -> tuple[np.ndarray, float]:
        """Light and mean green of the view that the browser has, or of the nearest one without Gaussians."""
        shown, name = self.shown, self.panel.method.value
        found = shown.scene(name)
        if found is None:
            if not (view in shown.capture.cameras.test_indices or shown.runs[name].shows_training_views):
                view = min(shown.capture.cameras.test_indices, key=lambda k: abs(k - view))
            image = shown.runs[name].rendering(shown.capture.names[view])
        else:
            scene, into, _ = found
            image = rendered(scene, into, viewmat, float(self.client.camera.fov), shown.size)
        return shown.linear(name, image), shown.run_green(name)


def small(picture: np.ndarray) -> np.ndarray:
    """An 8-bit picture, at most `PLATE` px wide and high, of one in 0..1."""
    height, width = picture.shape[:2]
    if max(height, width) > PLATE:
        import cv2

        share = PLATE / max(height, width)
        size = (max(1, round(share * width)), max(1, round(share * height)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)


def enlarged(picture: np.ndarray) -> np.ndarray:
    """A small picture with every pixel as a square, so that its noise is seen."""
    times = max(1, ENLARGED // max(picture.shape[:2]))
    return picture.repeat(times, 0).repeat(times, 1)


def quaternion(rotation: Array) -> Array:
    """The quaternion wxyz of a rotation matrix [3, 3]."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def viewmat_of(wxyz: Array, place: Array) -> Array:
    """World to camera [4, 4] of a camera's rotation to the world, wxyz, and its centre."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = wxyz
    viewmat = np.eye(4)
    viewmat[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix().T
    viewmat[:3, 3] = -viewmat[:3, :3] @ place
    return viewmat
