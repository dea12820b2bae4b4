"""What to render."""

import os
from dataclasses import asdict, dataclass, field
from typing import Any

from novags.numbers import PIXELS, SAMPLES, SIDE, VIEWS, check_range
from novags.settings import check_seed
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.stages.layouts import check_layouts
from sensor_model.files.reading import brief
from simscenes.backend import BACKENDS, COLORS
from simscenes.loading.reference import SceneRef
from simscenes.optics import Optics
from simscenes.scenes import SCENES, split_name
from simscenes.sets.writers.camera_files import is_test_view
from simscenes.transport.plan import EFFECTS

VARIANTS = ("auto", *BACKENDS, *(f"{backend}_{color}" for backend in BACKENDS for color in COLORS))


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """The scene to render and the accuracy."""

    scene: str = "tabletop"  # of simscenes.SCENES, "tabletop:3" for its variation 3, or a .xml or glTF file
    n_views: int = 32
    width: int = 128  # px
    height: int = 128  # px
    spp: int | None = 256  # samples per pixel; None: as many as `target_error` requires
    target_error: float | None = None  # relative RMSE of a view
    # Times these samples in held-out views, by which methods are judged; of a target error, a target smaller by the
    # root of it. With 8 the truth's noise was below 2 % of the squared error of the oracle on the scene of the demo.
    truth_samples: float = 8.0
    denoise: bool = False  # smooth training views, for previews; held-out ones stay unbiased
    variant: str = "auto"  # of Mitsuba
    on: tuple[str, ...] = ()  # effects of light that are simulated in any case
    off: tuple[str, ...] = ()  # and that are left out
    max_depth: int | None = None  # longest path of light, as Mitsuba counts; None: as long as the plan finds worthwhile
    optics: Optics = field(default_factory=Optics)  # lens (None: a file's own, else a pinhole), motion, colour filters
    allow_outside: bool = False  # let a Mitsuba file read files outside its folder
    parameters: tuple[str, ...] = ()  # "name=value": values of the $names of a Mitsuba file
    sensor_index: int = 0  # which of a Mitsuba file's sensors the cameras are placed around, from 0
    own_cameras: bool = False  # all of a Mitsuba file's sensors are the views; their number is not n_views then
    export: tuple[str, ...] = ()  # further layouts of the set: "blender", "llff"
    seed: int = 0

    def __post_init__(self) -> None:
        # The blocks of the enhancement and SSIM's window need room, and every 8th view is held out.
        if min(self.width, self.height) < 16:
            raise ValueError(f"width and height must be >= 16 px, got {self.width} x {self.height}")
        if self.n_views < 3:
            raise ValueError(f"n_views must be >= 3 (one is held out, two are trained on), got {self.n_views}")
        if (self.spp is None) == (self.target_error is None):
            raise ValueError(f"give either spp or target_error, got {self.spp} and {self.target_error}")
        if self.spp is not None and self.spp < 2:
            raise ValueError(f"spp must be >= 2, because the variance needs two halves, got {self.spp}")
        if self.target_error is not None and not 0 < self.target_error < 1:
            raise ValueError(f"target_error must lie in (0, 1), got {self.target_error}")
        check_range("truth_samples", self.truth_samples, 1, 1024)
        check_range("n_views", self.n_views, 3, VIEWS)
        check_range("width", self.width, 16, SIDE, " px")
        check_range("height", self.height, 16, SIDE, " px")
        check_range("width x height", self.width * self.height, 256, PIXELS, " px")
        if self.spp is not None:
            check_range("spp", self.spp, 2, SAMPLES)
        if self.max_depth is not None:
            check_range("max_depth", self.max_depth, 1, SAMPLES)
        check_range("sensor_index", self.sensor_index, 0, VIEWS)
        check_seed(self.seed)
        if not os.path.isdir(self.scene):  # a set that is there already; pathlib fails at long names
            _ = self.source  # refuses a scene that there is not
        for what, given, known in (
            ("variant", (self.variant,), VARIANTS),
            ("on and off", (*self.on, *self.off), EFFECTS),
        ):
            if unknown := [name for name in given if name not in known]:
                raise ValueError(f"{what} must be among {', '.join(known)}; got {brief(', '.join(unknown))}")
        check_layouts(self.export)
        if both := set(self.on) & set(self.off):
            raise ValueError(f"{brief(', '.join(sorted(both)))}: forced on and off at once; name each effect once")

    @property
    def views_worth(self) -> float:
        """How many views of the usual samples the set costs, held-out ones with their `truth_samples`."""
        held_out = sum(map(is_test_view, range(self.n_views)))
        return self.n_views + (self.truth_samples - 1) * held_out

    @property
    def most_samples(self) -> float:
        """Samples of the view that has most, a held-out one; of a target error, about the usual ones."""
        return self.width * self.height * (self.spp or 256) * self.truth_samples

    def resolved(self) -> dict[str, Any]:
        """The settings that determine the pixels, apart from the content of the scene: neither its path nor further
        layouts.
        """
        kept = {name: value for name, value in asdict(self).items() if name != "export"}
        for name in ("parameters", "sensor_index", "own_cameras", "denoise"):
            if not kept[name]:
                del kept[name]  # sets rendered before these options existed stay valid
        return kept | {"scene": self.source.name}

    @property
    def code(self) -> Code:
        """What renders it."""
        scene = SCENES.module_of(split_name(self.scene)[0]) if self.source.in_catalogue else None
        return code_of("novags.testbed.stages.rendering", scene)

    @property
    def source(self) -> SceneRef:
        """The scene of the catalogue, or the Mitsuba file.

        Raises:
            ValueError: If no scene of the catalogue has that name, or it cannot have the parameters or the sensor.
        """
        return SceneRef.of(self.scene).given(self.parameters, self.sensor_index)
