"""Claims about study files: what they mean, and that every mistake in one is a line that names the file and the key."""

import re
from pathlib import Path

import pytest

from novags.cameras.sources.sfm import SfmConfig
from novags.cameras.sources.vggsfm import VggsfmConfig
from novags.testbed.study.cells.grid import Study, read_study
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from sensor_model import PRESETS as SENSORS
from sensor_model import write_sensor

GRID = """
preset = "demo"
[grid]
scene = ["tabletop:1", "cornell"]
electrons = [5, 20]
method = ["naive", "nova-no-sh-here"]
seed = [0, 1]
[override]
views = 12
fit.sh_degree = 2
[variant.nova-no-sh-here]
method = "nova-fast"
sh_weight = "none"
[[exclude]]
scene = "cornell"
electrons = 5
"""


def read(tmp_path: Path, text: str) -> Study:
    (tmp_path / "study.toml").write_text(text)
    return read_study(tmp_path / "study.toml")


def test_every_combination_that_is_not_excluded_is_a_run_in_the_order_of_the_file(tmp_path: Path) -> None:
    study = read(tmp_path, GRID)
    assert (len(study.cells), study.excluded) == (12, 4)
    expected = [
        (scene, electrons, method, seed)
        for scene in ("tabletop:1", "cornell")
        for electrons in (5, 20)
        for method in ("naive", "nova-no-sh-here")
        for seed in (0, 1)
        if (scene, electrons) != ("cornell", 5)
    ]
    assert [tuple(cell.values.values()) for cell in study.cells] == expected


def test_a_run_has_the_values_of_its_axes_and_what_is_said_for_all(tmp_path: Path) -> None:
    cell = next(
        c for c in read(tmp_path, GRID).cells if tuple(c.values.values()) == ("cornell", 20, "nova-no-sh-here", 1)
    )
    preset = cell.preset
    assert (preset.render.scene, preset.render.n_views, preset.render.width) == ("cornell", 12, 160)
    assert (preset.capture.electrons, preset.capture.seed) == (20.0, 1)
    assert preset.methods == ("nova-no-sh-here",)
    found = preset.reconstruct("nova-no-sh-here")
    assert (found.config.sh_weight, found.config.fit.sh_degree, found.seed) == (None, 2, 1)
    assert found.variant.method == "nova"


def test_the_seed_is_that_of_noise_and_training_so_that_one_set_serves_all(tmp_path: Path) -> None:
    cells = read(tmp_path, "[grid]\nseed = [3, 4]\nmethod = 'naive'").cells
    assert [(c.preset.render.seed, c.preset.capture.seed, c.preset.reconstruct("naive").seed) for c in cells] == [
        (0, 3, 3), (0, 4, 4)
    ]  # fmt: skip


def test_an_empty_study_is_its_preset(tmp_path: Path) -> None:
    study = read(tmp_path, "")
    demo = EXPERIMENTS["demo"]
    assert study.axes == {"method": demo.methods, "seed": (demo.capture.seed,)}
    assert [cell.preset.render for cell in study.cells] == [demo.render] * len(demo.methods)


def test_rigs_stages_and_methods_can_be_axes(tmp_path: Path) -> None:
    text = """
    [grid]
    rig = ["near", "far"]
    pictures = ["8bit", "16bit"]
    "capture.jpeg_quality" = ["none", 90]
    "fit.sh_degree" = 1
    cameras = ["known:rotation_deg=1"]
    method = "naive"
    [rig.near]
    views = 9
    [rig.far]
    views = 20
    width = 64
    """
    cells = read(tmp_path, text).cells
    assert len(cells) == 8
    assert [(c.preset.render.n_views, c.preset.render.width) for c in cells[::4]] == [(9, 160), (20, 64)]
    assert [c.preset.capture.jpeg_quality for c in cells[:2]] == [None, 90]
    found = [c.preset.reconstruct("naive") for c in cells]
    assert [f.config.pictures for f in found[::2]] == ["8bit", "16bit"] * 2
    assert {f.config.fit.sh_degree for f in found} == {1}
    assert {f.cameras.rotation_deg for f in found} == {1.0}  # type: ignore[union-attr]


def test_paths_start_at_the_folder_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "rooms").mkdir()
    (tmp_path / "rooms" / "a.xml").write_text("<scene version='3.0.0'/>")
    (tmp_path / "photos").mkdir()
    cells = read(tmp_path, "[grid]\nscene = ['rooms/a.xml']\nmethod = 'naive'").cells
    assert cells[0].preset.render.scene == str(tmp_path / "rooms" / "a.xml")
    assert cells[0].values["scene"] == "rooms/a.xml"
    cells = read(tmp_path, "[grid]\nscene = ['photos', 'cornell']\nmethod = 'naive'\n[override]\nviews = 7").cells
    assert [cell.preset.folder for cell in cells] == [tmp_path / "photos", None]
    assert cells[1].preset.render.n_views == 7
    sources = "['vggsfm:home=clone,checkpoint=/w.bin', 'sfm:mapper=global']"
    cells = read(tmp_path, f"[grid]\ncameras = {sources}\nmethod = 'naive'").cells
    config = cells[0].preset.cameras
    assert isinstance(config, VggsfmConfig)
    assert (config.home, config.checkpoint, config.python) == (tmp_path / "clone", Path("/w.bin"), "python")
    assert cells[1].preset.cameras == SfmConfig(mapper="global")
    for name in ("a.pth", "b.pth"):
        (tmp_path / name).touch()
    variants = """
    [variant.one]
    method = "uretinex-gs"
    enhance.weights = ["a.pth"]
    [variant.two]
    method = "one"
    enhance.weights = ["a.pth", "b.pth"]
    """
    cells = read(tmp_path, f"[grid]\nmethod = ['one', 'two']\n{variants}").cells
    found = [cell.preset.reconstruct(cell.values["method"]).config.enhance.weights for cell in cells]
    assert found == [(tmp_path / "a.pth",), (tmp_path / "a.pth", tmp_path / "b.pth")]
    (cell,) = read(tmp_path, "[grid]\nmethod = 'sci-gs'\n[override]\nenhance.weights = 'b.pth'").cells
    assert cell.preset.reconstruct("sci-gs").config.enhance.weights == (tmp_path / "b.pth",)


def test_paths_among_settings_of_stages_start_at_the_folder_of_the_file_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "studies"
    folder.mkdir()
    (folder / "a.xml").write_text("<scene version='3.0.0'/>")
    write_sensor(folder / "mine.toml", SENSORS["a7s2-iso6400"])
    text = "[grid]\nrender.scene = ['a.xml', 'cornell:0']\ncapture.sensor = ['mine.toml', 'imx686-iso800']\n"
    text += "[override]\nimport.sensor = 'mine.toml'\nimport.lit = 'lit'\nimport.clean = 'none'"
    (folder / "study.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    presets = [cell.preset for cell in read_study(Path("studies/study.toml")).cells]
    whole = str(folder / "mine.toml")
    assert {preset.render.scene for preset in presets} == {str(folder / "a.xml"), "cornell"}
    assert {preset.capture.sensor for preset in presets} == {whole, "imx686-iso800"}
    assert {(p.imported.sensor, p.imported.lit, p.imported.clean) for p in presets} == {(whole, folder / "lit", None)}


def test_a_scene_has_one_name_and_the_axis_keeps_its_spelling(tmp_path: Path) -> None:
    cells = read(tmp_path, "[grid]\nscene = ['cornell:0', 'tabletop:03', 'tabletop:4']\nmethod = 'naive'").cells
    assert [cell.preset.render.scene for cell in cells] == ["cornell", "tabletop:3", "tabletop:4"]
    assert [cell.values["scene"] for cell in cells] == ["cornell:0", "tabletop:03", "tabletop:4"]


def test_a_scene_file_by_two_paths_is_listed_twice(tmp_path: Path) -> None:
    (tmp_path / "rooms").mkdir()
    (tmp_path / "a.xml").write_text("<scene version='3.0.0'/>")
    (tmp_path / "link.xml").symlink_to("a.xml")
    for other in ("rooms/../a.xml", "link.xml"):
        with pytest.raises(ValueError, match=f"'a.xml' is listed twice, also as '{other}': leave one out"):
            read(tmp_path, f"[grid]\nscene = ['a.xml', '{other}']")


TOGETHER = (
    "[grid]\nscene = 's.xml'\n[override]\nparameters = ['size=2']",
    "[override]\nrender.parameters = ['size=2']\nscene = 's.xml'",
    "[grid]\nrig = 'second'\n[rig.second]\nrender.sensor_index = 1\nscene = 's.xml'",
    "[grid]\nphotos = 'film.mp4'\n[override]\nfps = 2.0",
    "[grid]\nrender.target_error = [0.05, 0.1]\nrender.spp = 'none'",
)


@pytest.mark.parametrize("text", TOGETHER)
def test_keys_that_need_each_other_are_looked_at_together(tmp_path: Path, text: str) -> None:
    """Rationale: each was applied to the preset alone, which refused it whatever else the file said."""
    (tmp_path / "s.xml").write_text("<scene version='3.0.0'><default name='size' value='1'/></scene>")
    (tmp_path / "film.mp4").touch()
    assert read(tmp_path, text).cells
    alone = re.sub(r"[\w.]*(scene|photos|spp) = '.*'", "", text)
    with pytest.raises(ValueError, match=r"\.toml: \[\S+\] \w+(\.\w+)?: "):
        read(tmp_path, alone)


WRONG: dict[str, tuple[str, str]] = {
    "no toml": ("[grid", "is not a readable TOML file"),
    "table": ("[gird]\nseed = 0", "unknown table or key 'gird'; did you mean 'grid'"),
    "data set": ("[dataset]\nname='a'", "[dataset]: this is the file of a data set: novags dataset makes it"),
    "preset": ("preset = 'dmeo'", "preset: must be one of demo, small, paper, paper-160, got 'dmeo'"),
    "axis": ("[grid]\nelektrons = [1]", "[grid] elektrons: there is no such key; did you mean 'electrons'"),
    "scene": ("[grid]\nscene = ['tabeltop']", "[grid] scene: "),
    "scene file": ("[grid]\nscene = ['none.xml']", "[grid] scene: the scene file FOLDER/none.xml does not exist"),
    "photos": ("[grid]\nphotos = ['none']", "[grid] photos: there are no photographs"),
    "sensor": ("[grid]\nsensor = ['kodak']", "[grid] sensor: unknown sensor 'kodak'"),
    "method": ("[grid]\nmethod = ['navie']", "[grid] method: unknown method 'navie'; did you mean 'naive'"),
    "cameras": ("[grid]\ncameras = ['sffm']", "[grid] cameras: unknown cameras 'sffm' (did you mean sfm?)"),
    "type": ("[grid]\nelectrons = ['many']", "[grid] electrons: it must be a number or none, got 'many'"),
    "whole": ("[grid]\nseed = [0.5]", "[grid] seed: it must be a whole number or none, got 0.5"),
    "range": ("[grid]\nelectrons = [5, -1]", "[grid] electrons: electrons must be > 0 and at most 1e+09, got -1"),
    "seed": ("[grid]\nseed = [-1]", "[grid] seed: seed must be >= 0 and < 2**64, got -1"),
    "large seed": (f"[grid]\nseed = [{2**64}]", "grid.seed[0] must be below 2**64"),
    "empty": ("[grid]\nseed = []", "[grid] seed: it has no values"),
    "twice": ("[grid]\nelectrons = [5, 5.0]", "[grid] electrons: 5 is listed twice"),
    "scene twice": ("[grid]\nscene = ['cornell', 'cornell:0']", "[grid] scene: 'cornell' is listed twice, also as"),
    "variation twice": ("[grid]\nscene = ['hall:1', 'hall:01']", "'hall:1' is listed twice, also as 'hall:01'"),
    "first": ("[grid]\nelectrons = [[6], 5]", "[grid] electrons: each value must be text, a number, or true or false"),
    "second": ("[grid]\nelectrons = [5, [6]]", "[grid] electrons: each value must be text, a number, or true or false"),
    "nested": ("[grid]\nelectrons = [[5, 6]]", "[grid] electrons: each value must be text, a number, or true or false"),
    "setting of a stage": ("[grid]\n'capture.jpeg_qualty' = 9", "CaptureConfig has no setting 'jpeg_qualty'; did"),
    "type in a stage": ("[override]\nrender.width = 'x'", "[override] render.width: render width must be a whole"),
    "range of a stage's setting": ("[grid]\nrender.width = 3", "[grid] render.width: width and height must be >= 16"),
    "range in a rig": ("[grid]\nrig='a'\n[rig.a]\nwidth=3", "[rig.a] width: width and height must be >= 16 px"),
    "seed of the capture": ("[grid]\n'capture.seed' = [1]", "capture.seed: the noise has the seed of the run"),
    "override": ("[override]\nspp = 1", "[override] spp: spp must be >= 2"),
    "override key": ("[override]\nspps = 8", "[override] spps: there is no such key; did you mean 'spp'"),
    "method's setting": ("[override]\nfit.rates.schedule='x'", "schedule must be 'original' or 'gsplat'"),
    "two places": ("[grid]\nspp = [8, 16]\n[override]\nspp = 9", "[override]: spp is set by [grid] spp too"),
    "rig and axis": (
        "[grid]\nrig='a'\nwidth=[64]\n[rig.a]\nwidth=32", "[grid] width: width is set by [grid] rig too"
    ),
    "a later rig": (
        "[grid]\nrig=['a', 'b']\n[override]\nwidth=64\n[rig.a]\nviews=9\n[rig.b]\nwidth=32",
        "[override]: width is set by [grid] rig too",
    ),
    "an earlier rig": (
        "[grid]\nrig=['b', 'a']\n[override]\nwidth=64\n[rig.a]\nviews=9\n[rig.b]\nwidth=32",
        "[override]: width is set by [grid] rig too",
    ),
    "rig": ("[grid]\nrig = ['b']\n[rig.a]\nviews=9", "[grid] rig: the table [rig.b] is missing; the file has: a"),
    "rig's key": ("[grid]\nrig = 'a'\n[rig.a]\nviewz=9", "[rig.a] viewz: there is no such key; did you mean 'views'"),
    "method of a rig": (
        "[grid]\nrig='a'\n[rig.a]\nmethod='naive'", "[rig.a] method: it is an axis of its own: list its values"
    ),
    "seed of a rig": ("[grid]\nrig='a'\n[rig.a]\nseed=7", "[rig.a] seed: it is an axis of its own"),
    "rig of a rig": ("[grid]\nrig='a'\n[rig.a]\nrig='a'", "[rig.a] rig: it is an axis of its own"),
    "rig for all": ("[override]\nrig='a'", "[override] rig: it is an axis of its own"),
    "preset list": ("preset = ['demo']", "preset: must be one of demo, small, paper, paper-160, got ['demo']"),
    "no name": ("[grid]\nscene = ['']", "[grid] scene: it is empty"),
    "unused rig": ("[rig.a]\nviews=9", "[rig.a]: no value of [grid] rig names it"),
    "variant": ("[variant.a]\nmethod='navie'", "[variant]: unknown method 'navie'"),
    "variant's setting": ("[grid]\nmethod='a'\n[variant.a]\nmethod='naive'\nfit.x=1", "[variant]: a: FitConfig has no"),
    "variant's file": (
        "[variant.a]\nmethod='sci-gs'\nenhance.weights='w.pt'",
        "[variant]: a: enhance.weights is FOLDER/w.pt, but that file does not exist",
    ),
    "method's file": (
        "[grid]\nmethod='sci-gs'\n[override]\nenhance.weights='w.pt'",
        "sci-gs: enhance.weights is FOLDER/w.pt, but that file does not exist",
    ),
    "exclude axis": ("[[exclude]]\nscnee='cornell'", "[[exclude]] 1: unknown axis 'scnee'"),
    "exclude value": (
        "[grid]\nelectrons=[5]\n[[exclude]]\nelectrons=6", "1: electrons: 6 is not among its values in [grid] (5)"
    ),
    "exclude truth": (
        "[grid]\nelectrons=[1, 5]\n[[exclude]]\nelectrons=true", "1: electrons: True is not among its values in [grid]"
    ),
    "exclude nothing": ("[grid]\nelectrons=[5]\n[[exclude]]\nelectrons=[]", "1: electrons has no values"),
    "after a good key": ("[override]\nviews = 12\n[grid]\nspp = [1]", "[grid] spp: spp must be >= 2"),
    "exclude shape": ("exclude = 3", "[[exclude]]: each must be a table"),
    "nothing left": ("[grid]\nelectrons=[5]\n[[exclude]]\nelectrons=5", "[[exclude]]: nothing is left to run"),
    "too many": (f"[grid]\nseed={list(range(400))}\nelectrons={list(range(1, 400))}", "[grid]: 159600 combinations"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_one_line_with_the_file_and_the_key(tmp_path: Path, what: str) -> None:
    text, said = WRONG[what]
    file, said = re.escape(str(tmp_path / "study.toml")), re.escape(said.replace("FOLDER", str(tmp_path)))
    with pytest.raises(ValueError, match=rf"^{file}[^\n]*{said}[^\n]*$"):
        read(tmp_path, text)


PAIRS = {  # keys that set the same, with a value of each
    "scene = 'cornell'": "render.scene = 'tabletop'",
    "views = 9": "render.n_views = 8",
    "width = 64": "render.width = 32",
    "height = 64": "render.height = 32",
    "spp = 8": "render.spp = 16",
    "sensor = 'a7s2-iso1600'": "capture.sensor = 'imx686-iso800'",
    "electrons = 9": "capture.electrons = 5",
    "max_size = 64": "capture.max_size = 32",
    "max_size = 48": "import.max_size = 32",
    "iterations = 9": "fit.iterations = 8",
    "denoiser_steps = 9": "denoiser.warmup_steps = 8",
    "refine_cameras = true": "fit.refine_cameras = 'default'",
    "level = 'lom'": "capture.electrons = 5",
}


@pytest.mark.parametrize("one", PAIRS)
def test_two_keys_that_set_the_same_are_refused_wherever_they_stand(tmp_path: Path, one: str) -> None:
    """Rationale: one of them won without a word, so that rows of the table stated what their runs did not have."""
    other, given = PAIRS[one], "[grid]\nmethod = 'nova'\n"
    name, same = (line.partition(" =")[0] for line in (one, other))
    for text, said in (
        (f"{given}{one}\n{other}", rf"\[grid\] {same}: {same} is set by \[grid\] {name} too: remove one of them"),
        (f"{given}{one}\n[override]\n{other}", rf"\[override\]: {same} is set by \[grid\] {name} too"),
        (f"{given}[override]\n{one}\n{other}", rf"\[override\] {same}: .* sets the same: remove one of them"),
        (f"{given}rig = 'a'\n{one}\n[rig.a]\n{other}", rf"\[grid\] {name}: .* is set by \[grid\] rig too"),
    ):
        with pytest.raises(ValueError, match=said):
            read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[grid]\nscene='set'\nwidth=[64]\nmethod='naive'", "belong to a render"),
        ("[grid]\nscene='set'\nrig='a'\nmethod='naive'\n[rig.a]\nviews=9", "belong to a render"),
    ],
)
def test_what_belongs_to_a_render_does_not_go_with_a_set_that_is_there(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "set").mkdir()
    with pytest.raises(ValueError, match=said) as error:
        read(tmp_path, text)
    assert str(tmp_path / "study.toml") in str(error.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *((key, value) for key in ("views", "width", "height", "spp", "points", "iterations", "denoiser_steps",
                                   "max_size", "render.max_depth", "render.sensor_index", "capture.jpeg_quality",
                                   "fit.sh_every", "fit.cap_max") for value in ("-1", str(10**12), str(2**63 - 1))),
        *((key, value) for key in ("electrons", "fps", "capture.time", "render.target_error", "import.white",
                                   "fit.dssim_weight", "fit.opacity_reg")
          for value in ("-1.0", "inf", "-inf", "1e308")),
        ("method", '"' + "x" * 5000 + '"'), ("cameras", f'"sfm:max_features={3 * 10**9}"'),
        ("scene", f'"tabletop:{"9" * 400}"'),
    ],
)  # fmt: skip
@pytest.mark.parametrize("table", ["grid", "override"])
def test_a_number_that_nobody_can_mean_is_one_line_with_its_key(
    tmp_path: Path, table: str, key: str, value: str
) -> None:
    """Rationale: 10**12 views took all memory before anything was said."""
    (tmp_path / "study.toml").write_text(f"[{table}]\n{key} = {f'[{value}]' if table == 'grid' else value}\n")
    with pytest.raises(ValueError, match=key.rpartition(".")[2]) as error:
        read_study(tmp_path / "study.toml")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500 + len(str(tmp_path))


def test_axes_that_make_too_many_runs_together_are_refused_before_they_are_made(tmp_path: Path) -> None:
    """Rationale: ranges of scenes were counted as one value each."""
    for axes, count in (
        ('scene = "tabletop:0..9999"\nseed = [' + ", ".join(map(str, range(50))) + "]", "500000"),
        ('scene = ["tabletop:0..99999", "busts:0..99999"]', "more than 100000"),
    ):
        (tmp_path / "study.toml").write_text(f"[grid]\n{axes}\n")
        with pytest.raises(ValueError, match=f"{count}.*split the study"):
            read_study(tmp_path / "study.toml")


def test_without_a_seed_of_its_own_a_study_has_that_of_its_preset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(EXPERIMENTS, "mine", adapted(EXPERIMENTS["demo"], seed=4))
    text = '[grid]\nmethod = ["naive"]\n'
    for head, seed in (('preset = "mine"\n', 4), ('preset = "demo"\n', 0)):
        study = read(tmp_path, head + text)
        assert study.axes["seed"] == (seed,)
        assert [cell.preset.capture.seed for cell in study.cells] == [seed]
    assert read(tmp_path, f'preset = "mine"\n{text}[override]\nseed = 6\n').axes["seed"] == (6,)


@pytest.mark.parametrize("scenes", ["['cornell', 'data:LOM/*']", "['data:LOM/*', 'cornell']"])
def test_one_scene_that_is_there_is_enough_for_a_study(tmp_path: Path, scenes: str) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "study.toml").write_text(f"[grid]\nscene = {scenes}\nmethod = 'naive'")
    study = read_study(tmp_path / "study.toml", tmp_path / "data")
    assert (study.absent, [cell.values["scene"] for cell in study.cells]) == (("LOM",), ["cornell"])
