"""Claims about which code a result depends on, on a copy of the sources in which something is changed."""

import ast
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from novags.cameras import parse_cameras
from novags.methods import METHODS, chosen
from novags.testbed.ledger.code import code_of, modules_of
from novags.testbed.ledger.contents import jsonable
from novags.testbed.ledger.reach import OUTSIDE, PACKAGES, reached, source_of
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from sensor_model.presets import PRESETS
from simscenes.scenes import SCENES

ROOT = Path(__file__).resolve().parents[4]
STAGE = "novags.testbed.stages."
# Prints the key of the code of every result that this installation can make.
KEYS = """
import json, sys
from novags.methods import METHODS, VARIANTS, chosen
from novags.testbed.folders.set import for_photographs
from novags.testbed.ledger.code import code_of
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.configs.rendering import RenderConfig
from simscenes.scenes import SCENES
from simscenes.sets.writers.layouts import EXPORTS

keys = {f"scene {name}": RenderConfig(scene=name).code.key for name in SCENES}
keys |= {name: ReconstructConfig(variant=chosen(name)).code.key for name in (*METHODS, *VARIANTS)}
keys |= {"capture": CaptureConfig().code.key, "score": code_of("novags.testbed.stages.scores.scoring").key}
keys["layout"] = code_of(EXPORTS.module_of("llff")).key
keys["import"] = ImportConfig().code.key
keys["capture of photographs"] = CaptureConfig().code.along_with(for_photographs()).key
assert not {"torch", "numba", "mitsuba", "pycolmap"} & sys.modules.keys()
print(json.dumps(keys))
"""
Edit = Callable[..., set[str]]


@pytest.fixture(scope="module")
def edit(tmp_path_factory: pytest.TempPathFactory) -> Edit:
    """A function (file, text, another text, further files with theirs) -> the results that these changes make again."""
    root = tmp_path_factory.mktemp("sources")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, root / package)  # with their bytecode

    def keys(**more: str) -> dict[str, str]:
        environment = {**os.environ, "XDG_CACHE_HOME": str(root / "cache"), "PYTHONPATH": str(root), **more}
        done = subprocess.run([sys.executable, "-c", KEYS], env=environment, cwd=root, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        found: dict[str, str] = json.loads(done.stdout)
        return found

    before = keys()

    def changed(*edits: str) -> set[str]:
        contents = {}
        for file, text, other in zip(edits[::3], edits[1::3], edits[2::3], strict=True):
            contents[file] = content = (root / file).read_text("utf-8")
            assert content.count(text) == 1, f"{file} holds {text!r} {content.count(text)} times"
            (root / file).write_text(content.replace(text, other), "utf-8")
        try:
            after = keys(PYTHONDONTWRITEBYTECODE="1")  # what is changed is put right within a second
        finally:
            for file, content in contents.items():
                (root / file).write_text(content, "utf-8")
        return {name for name in after if after[name] != before.get(name)}

    return changed


def of(*methods: str) -> set[str]:
    """These methods and their variants."""
    from novags.methods import VARIANTS

    return {*methods, *(name for name in VARIANTS if chosen(name).method in methods)}


FITS = {name for name, method in METHODS.items() if method.family != "NeRF"} - {"nerf-oracle", "averaging"}


def test_a_constant_of_a_method_makes_its_runs_again_and_no_others(edit: Edit) -> None:
    assert edit("novags/methods/rivals/gaussian_dk.py", "ANCHOR = 0.5", "ANCHOR = 0.6") == {"gaussian-dk"}
    assert edit("novags/methods/rivals/rows/luminance_gs.py", "contrast: float = 0.5", "contrast: float = 0.6") == {
        "luminance-gs"
    }
    assert edit("novags/methods/nova/consistency.py", "FARTHEST = 1e10", "FARTHEST = 1e9") == of("nova")


def test_a_constant_of_what_methods_share_makes_the_runs_of_all_that_use_it_again(edit: Edit) -> None:
    splats = edit("novags/splats/training/updates/adam.py", "EPS = 1e-15", "EPS = 1e-14")
    assert splats >= of(*FITS)
    assert not {name for name in splats if name.startswith("scene")} | ({"capture", "score"} & splats)
    assert edit("novags/splats/raster/raster_torch.py", "ALPHA_MAX = 0.999", "ALPHA_MAX = 0.998") == of(*FITS)


def test_a_constant_of_a_score_makes_scores_again_and_no_fit(edit: Edit) -> None:
    assert edit("novags/testbed/metrics/tone.py", "CONTRAST = 1 / 255", "CONTRAST = 2 / 255") == {"score"}
    assert edit("novags/testbed/stages/scores/scoring.py", "BLUR_SIGMA = 1.2", "BLUR_SIGMA = 1.3") == {"score"}


def test_a_constant_of_a_scene_makes_that_scene_again(edit: Edit) -> None:
    assert edit("simscenes/scenes/cornell.py", "58.0", "59.0") == {"scene cornell"}


def test_what_shows_and_tells_and_what_no_result_reaches_makes_nothing_again(edit: Edit) -> None:
    charts = (ROOT / "novags/testbed/report/charts.py").read_text("utf-8").splitlines()[0]
    assert charts.startswith('"""')
    changes = [
        ("novags/testbed/report/charts.py", charts, charts.replace('"""', '"""It was: ', 1)),
        ("novags/testbed/console/terminal.py", "PLAIN_INTERVAL = 5.0", "PLAIN_INTERVAL = 6.0"),
        ("sensor_model/files/lock.py", "COMMAND_LENGTH = 160", "COMMAND_LENGTH = 161"),
        ("sensor_model/presets.py", "(0.55, 1.0, 0.65)", "(0.55, 1.0, 0.66)"),
        ("novags/commands/store.py", "dry_run: bool = False", "dry_run: bool = True"),
        ("novags/splats/files/ply.py", "def read_ply(", "def read_ply(unused=0, *, "),
    ]
    assert edit(*(text for change in changes for text in change)) == set()


def test_the_values_of_a_preset_count_as_configuration() -> None:
    for config in (CaptureConfig(sensor="imx385-iso1600"), ImportConfig(sensor="imx385-iso1600")):
        assert jsonable(config.resolved())["camera"] == jsonable(PRESETS["imx385-iso1600"])


def test_a_further_layout_makes_neither_set_nor_capture_again(edit: Edit) -> None:
    assert edit("simscenes/sets/writers/export.py", "CENTRED = 0.01", "CENTRED = 0.02") == {"layout"}


@pytest.mark.parametrize(
    ("file", "text", "other"),
    [
        ("simscenes/sets/readers/llff.py", "SHOWN = 3", "SHOWN = 4"),
        ("novags/testbed/folders/photographs/linear.py", "WHITE_QUANTILE = 0.99", "WHITE_QUANTILE = 0.98"),
        ("novags/methods/noise_estimate.py", "BINS = 16", "BINS = 17"),
    ],
)
def test_what_photographs_alone_need_keeps_the_results_of_rendered_sets(
    edit: Edit, file: str, text: str, other: str
) -> None:
    made = edit(file, text, other)
    assert made >= {"import", "capture of photographs"}
    assert not made & {"capture", "naive", "score", *(f"scene {name}" for name in SCENES)}


def test_a_new_row_of_a_table_makes_nothing_again(edit: Edit) -> None:
    row = '"averaging": "novags.methods.averaging.row:METHOD",'
    assert edit("novags/methods/__init__.py", row, f'{row} "mine": "novags.methods.averaging.row:METHOD",') == {"mine"}


def test_weights_that_lie_beside_code_count_where_that_code_is_used() -> None:
    names = {name: code_of(METHODS.module_of(name)).files for name in ("denoise-gs", "naive", "gaussian-dk")}
    weights = "novags/methods/denoised/weights.safetensors"
    assert [weights in files for files in names.values()] == [True, False, False]


def test_a_run_depends_on_the_sources_and_the_enhancers_that_it_uses() -> None:
    def files(name: str, **how: object) -> set[str]:
        return set(ReconstructConfig(variant=chosen(name), **how).code.files)  # type: ignore[arg-type]

    sfm = "novags/cameras/motion/sfm.py"
    assert sfm not in files("naive")
    assert sfm in files("naive", cameras=parse_cameras("sfm"))
    assert "novags/methods/nova/denoiser.py" in files("naive", cameras=parse_cameras("sfm:pictures=denoised"))
    assert "novags/methods/nova/denoiser.py" not in files("naive", cameras=parse_cameras("sfm:pictures=enhanced"))
    enhancers = {"naive": "guided", "sci-gs": "networks/sci", "gamma-gs": "curves/gamma"}
    for name, file in enhancers.items():
        found = files(name)
        assert f"novags/methods/enhancers/{file}.py" in found
        others = {f"novags/methods/enhancers/{other}.py" for other in enhancers.values() if other != file}
        assert not others & found


def test_no_result_depends_on_the_row_of_another_method() -> None:
    rows = {name: METHODS.module_of(name) for name in METHODS}
    for name, row in rows.items():
        config = METHODS[name].config()
        found = reached([f"{STAGE}reconstructing", str(row), *modules_of(config)])
        own = {row, *(modules_of(config.enhance) if hasattr(config, "enhance") else ())}  # where its enhancer is
        assert found.keys() & {other for other in rows.values() if other not in own} == set(), name


def test_stages_reach_nothing_that_shows_and_nothing_shown_is_missing_from_the_rule() -> None:
    for stage in ("rendering", "posing", "capturing", "importing", "denoising", "reconstructing", "scores.scoring"):
        found = reached([f"{STAGE}{stage}"])
        assert f"{STAGE}{stage}" in found
        assert not {name for name in found if name.startswith(OUTSIDE)}
    folders = {"metrics", "folders", "importing", "stages"}
    inside = {name.split(".")[2] for name in reached([f"{STAGE}{stage}" for stage in ("scores.scoring", "importing")])
              if name.startswith("novags.testbed.")}  # fmt: skip
    assert inside <= folders


# Modules whose names are computed: what they load would be missing from keys. Of ours there is none but by whole texts.
COMPUTED = {
    "sensor_model/files/registry.py": "names as text, which keys follow",
    "sensor_model/files/outside.py": "names as text of rows from outside, whose modules are roots of keys",
    "novags/cameras/networks/package.py": "a package of somebody else",
    "novags/cameras/motion/hloc.py": "a package of somebody else",
}


def test_no_module_of_ours_is_imported_by_a_computed_name() -> None:
    """Rationale: the rasteriser chose its backend so, and a change in the kernels of numba made nothing again."""
    found = set[str]()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_bytes())):
                name = ast.unparse(node.func).rpartition(".")[2] if isinstance(node, ast.Call) else ""
                if name in ("import_module", "__import__") and not isinstance(node.args[0], ast.Constant):
                    found.add(path.relative_to(ROOT).as_posix())
    assert found == COMPUTED.keys()
    kernels = "novags/splats/raster/raster_numba.py"
    assert kernels in ReconstructConfig(variant=chosen("naive")).code.files


def test_a_module_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="there is no module novags.methods.nothing"):
        code_of("novags.methods.nothing")


FILES = {
    "__init__": "",
    "a": "from small_tree.b import one, two\nimport small_tree.c\nfrom small_tree.h import *\nX = one()\n\n"
         "def main():\n    return two() + small_tree.c.three() + X\n",
    "b": "def one():\n    return first()\n\ndef two():\n    return second()\n\ndef first(): ...\n\ndef second(): ...\n"
         "\ndef unused(): ...\n",
    "c": "P = Q = 3\nR = 4\n\ndef three():\n    from small_tree.d import four, five\n    return four() + five() + Q\n",
    "d": "def four(): ...\n\ndef five(): ...\n\ndef six(): ...\n",
    "e": "import small_tree.f\nimport small_tree.g\n\nY = 1\n",
    "f": "def register(): ...\n\nregister()\n",
    "g": "for k in range(3):\n    print(k)\n",
    "i": "from small_tree.b import one\nfrom small_tree.d import six\n",
    "h": "def star(): ...\n\ndef stripe(): ...\n",
    "j": "from own_work import kept\nfrom installed_work import other\n\ndef main():\n    return kept() + other()\n",
}  # fmt: skip
BESIDE = {  # the package
    "own_work.py": "def kept():\n    return grown()\n\ndef grown(): ...\n\ndef unused(): ...\n",
    "site-packages/installed_work.py": "def other(): ...\n",
}


def _forget() -> None:
    from novags.testbed.ledger import reach

    for remembered in (reach._module, reach._next):
        remembered.cache_clear()


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, set[str]]]:
    """A function of modules of a small package -> the names that count, by module."""
    (tmp_path / "small_tree").mkdir()
    for name, text in FILES.items():
        (tmp_path / "small_tree" / f"{name}.py").write_text(text)
    for name, text in BESIDE.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        monkeypatch.syspath_prepend(str((tmp_path / name).parent))
    _forget()

    def names(*roots: str) -> dict[str, set[str]]:
        found = reached(f"small_tree.{root}" for root in roots)
        held = {module: source_of(module).definitions for module in found}
        return {
            module.rpartition(".")[2]: {n for k in counted.definitions for n in held[module][k].names or ["-"]}
            for module, counted in found.items() if counted.definitions
        }  # fmt: skip

    yield names  # type: ignore[misc]
    _forget()
    for name in [name for name in sys.modules if name.partition(".")[0] == "small_tree"]:
        del sys.modules[name]


def test_all_that_any_definition_uses_counts_at_any_depth_and_nothing_else(
    tree: Callable[..., dict[str, set[str]]],
) -> None:
    assert tree("a") == {"a": {"X", "main"}, "b": {"one", "two", "first", "second"}, "c": {"P", "Q", "three"},
                         "d": {"four", "five"}, "h": {"star", "stripe"}}  # fmt: skip
    assert tree("d", "h") == {"d": {"four", "five", "six"}, "h": {"star", "stripe"}}


def test_every_name_that_a_module_of_use_hands_on_counts(tree: Callable[..., dict[str, set[str]]]) -> None:
    assert tree("i") == {"b": {"one", "first"}, "d": {"six"}}


def test_the_version_of_the_code_is_of_every_module_that_results_may_depend_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from novags.testbed.ledger import code

    seen = list[frozenset[str]]()
    monkeypatch.setattr(code, "_code_of", lambda names: seen.append(names) or SimpleNamespace(key="k"))
    assert code.version.__wrapped__() == "k"
    (names,) = seen
    assert {"novags", "novags.methods", "simscenes.rigs", "sensor_model.noise"} <= names
    assert not {name for name in names if name.startswith(OUTSIDE)}
    for name in ("novags/__init__.py", "novags/a.py", "simscenes/b/c.py", "sensor_model/presets.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.setattr(code, "ROOT", tmp_path)
    code.version.__wrapped__()
    assert seen[1] == {"novags", "novags.a", "simscenes.b.c"}


@pytest.mark.usefixtures("tree")
def test_modules_of_every_package_of_a_root_are_followed() -> None:
    roots = ["sensor_model.files.records", "small_tree.c"]
    for found in (reached(roots), reached(roots[::-1])):
        assert {"small_tree.c", "small_tree.d"} <= set(found)


def test_modules_that_a_row_from_outside_imports_count_unless_they_are_installed(
    tree: Callable[..., dict[str, set[str]]],
) -> None:
    assert tree("j") == {"j": {"main"}, "own_work": {"kept", "grown"}}


def test_what_runs_when_any_of_the_imports_is_loaded_counts(tree: Callable[..., dict[str, set[str]]]) -> None:
    assert tree("e") == {"e": {"Y"}, "f": {"-", "register"}, "g": {"k"}}


def test_code_is_of_all_roots_with_all_data_beside_them_and_all_packages_they_are_from(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from novags.testbed.ledger import code
    from novags.testbed.ledger.code import Code

    roots = ("simscenes.scenes.printed.pages", "novags.methods.denoised.config", "sensor_model.noise")
    found = code_of(*roots, None)
    assert found.roots == tuple(sorted(roots))
    assert {f"{root.replace('.', '/')}.py" for root in roots} <= set(found.files) == set(found.texts)
    beside = [path for path in (ROOT / "simscenes/scenes/printed").iterdir() if path.is_file() and path.suffix != ".py"]
    assert len(beside) > 1
    assert {path.relative_to(ROOT).as_posix() for path in beside} <= set(found.files)
    packages = {root: SimpleNamespace(name=f"package-{k}", version=f"{k}.0") for k, root in enumerate(roots)}
    monkeypatch.setattr(code, "origin_of", packages.get)
    with_origins = code._code_of.__wrapped__(frozenset(roots))
    assert isinstance(with_origins, Code)
    assert with_origins.outside == {f"package-{k}": f"{k}.0" for k in range(3)}
