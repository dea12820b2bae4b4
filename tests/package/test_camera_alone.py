"""The camera alone: `pip install ./sensor_model` brings what `sensor_model` needs, and nothing that it does not."""

import os
import re
import subprocess
import sys
from pathlib import Path

from sensor_model.files.toml_file import read_toml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "sensor_model"
TABLE, WHOLE = read_toml(FOLDER / "pyproject.toml"), read_toml(ROOT / "pyproject.toml")
CAMERA = TABLE["project"]
THEIRS = {"llvmlite", "packaging"}  # what numba and lazy-loader need themselves

# Of the packages on this machine only those exist that the camera asks for.
FEW = """
import sys

class Few:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if not (top in {known} or top in sys.stdlib_module_names or top.startswith("_sysconfigdata")):
            raise ModuleNotFoundError(f"the camera alone has no {{name}}", name=name)

sys.meta_path.insert(0, Few())
"""
EVERYTHING = """
import pkgutil, importlib
import sensor_model
for module in pkgutil.walk_packages(sensor_model.__path__, "sensor_model."):
    importlib.import_module(module.name)
for name in sensor_model.__all__:
    getattr(sensor_model, name)
for demosaic in ("menon", "malvar", "bilinear", "half"):
    develop(frame, camera, demosaic=demosaic)
sensor_model.plan_effects(camera, Exposure(time=0.02), [1.0, 20.0], 0.01)
sensor_model.write_sensor(sys.argv[1], camera)
assert sensor_model.read_sensor(sys.argv[1]) == camera
for call in (lambda: develop(frame, camera, jpeg_quality=90),
             lambda: sensor_model.write_dng(sys.argv[1], frame.dn, camera, Exposure(time=0.02))):
    try:
        call()
    except ImportError as error:
        print(error)
"""


def names_of(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=;\s]", line)[0] for line in requirements}


def test_the_camera_works_with_what_its_distribution_asks_for(tmp_path: Path) -> None:
    """Its README's example, every module, and what needs a package more says which."""
    known = {name.replace("-", "_") for name in names_of(CAMERA["dependencies"])} | THEIRS | {"sensor_model"}
    example = re.findall(r"```python\n(.*?)```", (FOLDER / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    program = FEW.format(known=known) + "".join(example) + EVERYTHING
    command = [sys.executable, "-c", program, str(tmp_path / "camera.toml")]
    clean = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=clean, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "jpeg_quality needs OpenCV: pip install opencv-python-headless",
        "a DNG needs the package pidng: pip install pidng",
    ]


def test_nothing_heavy_is_asked_for_and_all_of_it_is_what_the_whole_asks_for() -> None:
    heavy = {"torch", "mitsuba", "drjit", "opencv-python-headless", "colour-science", "colour-demosaicing"}
    assert not names_of(CAMERA["dependencies"]) & heavy
    of_whole = {line.partition(";")[0].strip() for line in WHOLE["project"]["dependencies"]}
    of_camera = [
        *CAMERA["dependencies"],
        *(line for extra in CAMERA["optional-dependencies"].values() for line in extra),
    ]
    assert {line.partition(";")[0].strip() for line in of_camera} <= of_whole
    assert CAMERA["requires-python"] == WHOLE["project"]["requires-python"]


def test_the_camera_has_the_version_and_the_licence_of_the_whole() -> None:
    assert CAMERA["version"] == WHOLE["project"]["version"]
    assert CAMERA["license"] == WHOLE["project"]["license"]
    assert (FOLDER / "LICENSE").read_text(encoding="utf-8") == (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert all((FOLDER / name).is_file() for name in CAMERA["license-files"])


def test_every_folder_of_the_camera_is_in_its_distribution() -> None:
    folders = {path.parent.relative_to(ROOT) for path in FOLDER.rglob("*.py")}
    assert set(TABLE["tool"]["setuptools"]["packages"]) == {".".join(folder.parts) for folder in folders}
