"""Claims about the commands that a report gives: run where it lies, they lead to the same configuration."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from novags import cli
from novags.cameras import parse_cameras
from novags.methods import METHODS, VARIANTS
from novags.methods.variant import parse_variant
from novags.testbed import stages
from novags.testbed.folders.run import Run
from novags.testbed.ledger.contents import jsonable
from novags.testbed.report.again import relative_command, run_again
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted


def made(folder: Path, config: ReconstructConfig) -> Run:
    """A run of this configuration, with only the record that a command is made from."""
    record = {"name": config.variant.name, "method": config.variant.method, "capture": "../capture",
              "stage": {"config": jsonable(config.resolved())}, "config": jsonable(asdict(config.config))}  # fmt: skip
    return Run(path=folder / "experiment" / config.variant.name, record=record)


def asked(command: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> dict[str, Any]:
    """What `novags reconstruct` is asked for by a command that is run in `folder`."""
    seen: list[Any] = []
    monkeypatch.setattr(stages, "reconstruct", lambda *given, **_: seen.append(given))
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr("sys.argv", shlex.split(command))
    monkeypatch.chdir(folder)
    cli.main()
    (capture, out, config, _), = seen  # fmt: skip
    return {"capture": capture, "out": out, "config": jsonable(config.resolved())}


def configurations() -> list[tuple[str, ReconstructConfig]]:
    own = [
        parse_variant("mine=nova-fast:consistency=none;denoiser.network.widths=8,16;fit.rates.means=0.00032"),
        parse_variant("a.b=naive:pictures=16bit"),
    ]
    small = adapted(EXPERIMENTS["demo"], methods=("naive", "mine", "a.b"), variants=tuple(own), points=321, seed=4,
                    iterations=77, denoiser_steps=9, cameras=parse_cameras("known:rotation_deg=2.5"),
                    hold_out=2, refine_cameras=True)  # fmt: skip
    found = [(f"{preset}:{name}", EXPERIMENTS[preset].reconstruct(name)) for preset in EXPERIMENTS
             for name in ({**METHODS, **VARIANTS} if preset == "paper" else ("nova-fast", "oracle"))]  # fmt: skip
    return [*found, *((f"own:{name}", small.reconstruct(name)) for name in small.methods)]


@pytest.mark.parametrize(("name", "config"), [pytest.param(*pair, id=pair[0]) for pair in configurations()])
def test_the_command_of_a_run_asks_for_what_the_run_was_made_from(
    name: str, config: ReconstructConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = made(tmp_path, config)
    command = run_again(run, tmp_path / "experiment")
    assert command is not None
    assert str(tmp_path) not in command
    (tmp_path / "experiment").mkdir()
    found = asked(command, monkeypatch, tmp_path / "experiment")
    assert found["config"] == jsonable(config.resolved())
    assert (found["capture"], found["out"]) == (Path("capture"), Path(f"{config.variant.name}-again"))


def test_a_run_of_a_method_that_is_gone_has_no_command(tmp_path: Path) -> None:
    run = made(tmp_path, EXPERIMENTS["demo"].reconstruct("naive"))
    run.record["method"] = "withdrawn"
    assert run_again(run, tmp_path) is None
    run = made(tmp_path, EXPERIMENTS["demo"].reconstruct("naive"))
    run.record["stage"]["config"]["config"]["setting of a later version"] = 3
    assert run_again(run, tmp_path) is None


def test_a_typed_command_is_made_relative_to_the_folder_of_its_result(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "photos of it").mkdir()
    (tmp_path / "mine.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    typed = f"run --photos '{tmp_path}/photos of it' --sensor=mine.toml --out out/x --wait --methods naive oracle "
    typed += f"--overwrite --electrons 5 --cameras vggt:checkpoint={tmp_path}/w.pt,drop_percent=20 --scene tabletop"
    command = relative_command(shlex.split(typed), Path("out/x"))
    assert shlex.split(command) == [
        "novags", "run", "--photos", "../../photos of it", "--sensor=../../mine.toml", "--methods", "naive", "oracle",
        "--electrons", "5", "--cameras", "vggt:checkpoint=../../w.pt,drop_percent=20", "--scene", "tabletop", "--out",
        "again",
    ]  # fmt: skip


def test_files_among_the_settings_of_a_variant_and_the_folder_of_curves_are_made_relative(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.pt", "b.pt", "naive"):
        (tmp_path / name).write_text("")
    (tmp_path / "curves").mkdir()
    monkeypatch.chdir(tmp_path)
    typed = ["run", "--budget", "60s", "--curves", "curves", "--variant", "l=naive:enhance.weights=a.pt,b.pt;points=3"]
    assert shlex.split(relative_command(typed, Path("out/x")))[4:8] == [
        "--curves", "../../curves", "--variant", "l=naive:enhance.weights=../../a.pt,../../b.pt;points=3"
    ]  # fmt: skip


def test_a_run_with_weights_from_a_file_is_made_again_with_its_own_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sci.pt").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    given = parse_variant("given=sci-gs:enhance.weights=sci.pt")
    run = made(tmp_path, adapted(EXPERIMENTS["demo"], methods=("given",), variants=(given,)).reconstruct("given"))
    run.record["enhancement"] = {"enhancer": "sci", "pictures": "8bit", "config": {"weights": ["enhancer.safetensors"]}}
    run.path.mkdir(parents=True)
    (run.path / "enhancer.safetensors").write_bytes(b"")
    command = run_again(run, tmp_path / "experiment")
    assert command is not None
    found = asked(command, monkeypatch, tmp_path / "experiment")["config"]["config"]["enhance"]["weights"]
    assert [(tmp_path / "experiment" / path).resolve() for path in found] == [run.path / "enhancer.safetensors"]


def test_every_path_among_the_settings_of_a_camera_source_is_made_relative(tmp_path: Path) -> None:
    typed = f"run --cameras vggsfm:home={tmp_path}/clone,checkpoint={tmp_path}/w.bin,python=/envs/x/bin/python"
    command = relative_command(shlex.split(typed), tmp_path / "out" / "x")
    assert shlex.split(command)[3] == "vggsfm:home=../../clone,checkpoint=../../w.bin,python=/envs/x/bin/python"
