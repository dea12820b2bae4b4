"""Claims about scenes of published data sets in a study: which runs there are, and what is said of missing data."""

import io
import re
import shutil
from pathlib import Path

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.stages.importing import material_of
from novags.testbed.study.cells.grid import Study, read_study
from novags.testbed.study.plan import StudyPlan, plan_of
from tests.miniatures import llnerf, llrs, lom, mvtv

PAPER = Path(__file__).resolve().parents[4] / "docs" / "studies" / "paper.toml"
QUIET = Console(quiet=True)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two scenes of LOM, one of LLNeRF; nothing of the others."""
    for made in (tmp_path / "data" / "lom" / "buu", tmp_path / "data" / "lom" / "sofa"):
        lom(made)
    llnerf(tmp_path / "data" / "LLNeRF")
    return tmp_path / "data"


def read(tmp_path: Path, scene: str, data: Path | None, more: str = "") -> Study:
    file = tmp_path / "study.toml"
    file.write_text(f'[grid]\nscene = {scene}\nmethod = ["naive", "nova-fast"]\n{more}')
    return read_study(file, data)


def planned(study: Study, tmp_path: Path) -> StudyPlan:
    return plan_of(study, tmp_path / "store", QUIET)


def scenes(study: Study) -> list[str]:
    return list(dict.fromkeys(cell.values["scene"] for cell in study.cells))


def test_a_pattern_stands_for_the_scenes_that_are_there_and_what_is_absent_leaves_none(
    tmp_path: Path, data: Path
) -> None:
    study = read(tmp_path, '["data:lom/*", "data:LLRS/*", "data:llnerf/Still[234]"]', data)
    assert scenes(study) == ["data:LOM/buu", "data:LOM/sofa", "data:LLNeRF/still2"]
    assert study.absent == ("LLRS",)
    assert study.cells[0].preset.dark == data / "lom" / "buu"


def test_any_scene_that_is_there_is_enough_wherever_it_is_listed(tmp_path: Path, data: Path) -> None:
    study = read(tmp_path, '["data:LLRS/*", "data:LOM/buu"]', data)
    assert scenes(study) == ["data:LOM/buu"]
    assert study.absent == ("LLRS",)


def test_dark_scenes_are_imported_once_for_all_methods_and_seeds_and_nothing_is_rendered(
    tmp_path: Path, data: Path
) -> None:
    plan = planned(
        read(tmp_path, '"data:LOM/*"', data, "seed = [0, 1]\n[override]\nelectrons = 5\nviews = 4"), tmp_path
    )
    kinds = [task.kind for task in plan.tasks.values()]
    assert {kind: kinds.count(kind) for kind in kinds} == {"capture": 2, "run": 8}
    captures = [task for task in plan.tasks.values() if task.kind == "capture"]
    assert [task.name.rpartition("-")[0] for task in captures] == ["LOM-buu", "LOM-sofa"]
    assert captures[0].pixels == 8 * 32 * 24  # in their own size; the view for validation alone stays out


def test_settings_of_the_import_reach_it_and_other_pictures_are_another_capture(tmp_path: Path, data: Path) -> None:
    def key(more: str) -> str:
        plan = planned(read(tmp_path, '"data:LOM/buu"', data, f"[override]\n{more}"), tmp_path)
        return next(key for key, task in plan.tasks.items() if task.kind == "capture")

    keys = {more: key(more) for more in ("", 'import.split = "every8"', "max_size = 16", 'import.dataset = "LOM"')}
    assert len({keys[more] for more in ("", 'import.split = "every8"', "max_size = 16")}) == 3
    assert keys[""] == keys['import.dataset = "LOM"']
    (data / "lom" / "buu" / "high" / "IMG_20.png").write_bytes(
        (data / "lom" / "buu" / "high" / "IMG_21.png").read_bytes()
    )
    assert key("") != keys[""]


def test_lit_pictures_of_other_folders_make_other_captures_of_one_folder(tmp_path: Path, data: Path) -> None:
    """Rationale: what was read for the first value of the axis was taken for all of them."""
    for name in ("a", "b"):
        shutil.copytree(data / "lom" / "buu" / "high", tmp_path / name)
    (tmp_path / "b" / "IMG_20.png").write_bytes((tmp_path / "b" / "IMG_21.png").read_bytes())
    plan = planned(read(tmp_path, '"data:LOM/buu"', data, 'import.lit = ["a", "b"]'), tmp_path)
    assert [task.config.lit for task in plan.tasks.values() if task.kind == "capture"] == [
        tmp_path / "a",
        tmp_path / "b",
    ]


@pytest.mark.parametrize(
    ("scene", "given", "message"),
    [
        ('"data:LOM/*"', False, r"study.toml: \[grid\] scene: .*say with --data DIR where these are"),
        ('"data:LAMP/*"', True, r"must be data:NAME/SCENE or data:NAME/\* with one of LOM, LLNeRF, LLRS, MVTV"),
        ('"data:LOM"', True, "must be data:NAME/SCENE"),
        ('"data:LOM/bu"', True, "has no scene LOM/bu; did you mean LOM/buu?"),
        ('"data:LOM/x*"', True, "has no scene LOM/x.*; did you mean LOM/"),
        ('["data:MVTV/*", "data:LLRS/*"]', True, "holds none of LLRS, MVTV: download .*github.com/XuJiacong"),
        ('"tabletop"', True, "no scene begins with 'data:', so that nothing is read there"),
    ],
)
def test_what_cannot_be_found_is_one_line_that_says_what_to_do(
    scene: str, given: bool, message: str, tmp_path: Path, data: Path
) -> None:
    with pytest.raises(ValueError, match=message) as error:
        read(tmp_path, scene, data if given else None)
    assert "\n" not in str(error.value)


def test_axes_of_a_simulated_exposure_do_not_go_with_photographs(tmp_path: Path, data: Path) -> None:
    with pytest.raises(ValueError, match="electrons belong to a simulated exposure, and .*buu is dark already"):
        read(tmp_path, '"data:LOM/buu"', data, "electrons = [5, 20]")


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder: .*nowhere"):
        read(tmp_path, '"data:LOM/*"', tmp_path / "nowhere")


def test_the_protocol_of_the_paper_has_its_methods_its_split_and_its_pictures(tmp_path: Path, data: Path) -> None:
    """Expectation: of Table 1 eight methods on each lit scene; MVTV with the curves and all 16 bits instead."""
    llrs(data)
    mvtv(data)
    study = read_study(PAPER, data)
    assert study.absent == ()
    by_scene: dict[str, list[str]] = {}
    for cell in study.cells:
        by_scene.setdefault(cell.values["scene"], []).append(cell.values["method"])
        assert cell.preset.imported.split == "every8"
        assert cell.preset.imported.max_size is None
        config = cell.preset.reconstruct(cell.values["method"]).config
        assert config.fit.iterations == 7000
        assert config.pictures == ("16bit" if cell.values["method"] == "nova-16bit" else "8bit")
    table = ["sci-plus-gs", "zero-dce-gs", "aleth-nerf", "ll-nerf", "i2-nerf-truth", "luminance-gs", "lita-gs", "nova"]
    assert by_scene == {
        **{f"data:{scene}": table for scene in ("LOM/buu", "LOM/sofa", "LLRS/chair", "LLNeRF/still2")},
        "data:MVTV/hall": [*table[:4], "luminance-gs", "lita-gs", "gamma-gs", "drago-gs", "nova-16bit"],
    }
    assert len(planned(study, tmp_path).runs) == 4 * 8 + 9


def test_every_scene_of_the_protocol_may_be_absent_but_one(tmp_path: Path) -> None:
    mvtv(tmp_path / "data")
    study = read_study(PAPER, tmp_path / "data")
    assert study.absent == ("LOM", "LLNeRF", "LLRS")
    assert {cell.values["scene"] for cell in study.cells} == {"data:MVTV/hall"}


def test_links_to_scenes_and_to_data_sets_have_the_names_of_these(tmp_path: Path) -> None:
    """Rationale: the names where links led were taken, so that a data set behind one was not there."""
    disk, linked = tmp_path / "disk", tmp_path / "linked"
    lom(disk / "a")
    llrs(disk)
    (disk / "LLRS-sRGB").rename(disk / "b")
    (linked / "LOM").mkdir(parents=True)
    (linked / "LOM" / "buu").symlink_to(disk / "a")
    (linked / "LLRS").symlink_to(disk / "b")
    study = read(tmp_path, '["data:LOM/*", "data:LLRS/*"]', linked)
    assert scenes(study) == ["data:LOM/buu", "data:LLRS/chair"]
    captures = [task for task in planned(study, tmp_path).tasks.values() if task.kind == "capture"]
    assert [task.name.rpartition("-")[0] for task in captures] == ["LOM-buu", "LLRS-chair"]
    for task in captures:
        assert task.source is not None
        assert material_of(task.source, task.config, QUIET).lit is not None


def test_the_planner_says_what_a_scene_was_taken_for(tmp_path: Path, data: Path) -> None:
    stream = io.StringIO()
    plan_of(read(tmp_path, '"data:LOM/*"', data), tmp_path / "store", Console(stream=stream))
    assert len(re.findall("is taken for a scene of LOM", stream.getvalue())) == 2
