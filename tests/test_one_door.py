"""Every path that is read goes through `sensor_model.files.door`, every file that is written through `atomic`.

What does not is listed here with its reason; a reason without a place is an error too.
"""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("sensor_model", "simscenes", "novags")
DOOR = {"read_bytes", "read_text", "as_text", "opened", "admitted", "appending"}

# What opens a file by name: functions, and methods of paths. Some names mean something else in other modules, so that
# their module belongs to them.
READERS = {
    "open", "read_bytes", "read_text", "fromfile", "loadtxt", "genfromtxt", "memmap", "imread", "imreadmulti",
    "VideoCapture", "open_file", "TiffFile", "safe_open", "load_file", "parse_file", "copyfile", "copy2", "copytree",
    "np.load", "json.load", "json.loads", "pickle.load", "pickle.loads", "tomllib.load", "tomllib.loads",
    "OpenEXR.File", "pycolmap.Reconstruction", "pycolmap.Database.open", "torch.load", "h5py.File", "zipfile.ZipFile",
    "ElementTree.parse",
}  # fmt: skip
WRITERS = {"write_text", "write_bytes", "touch", "np.save", "np.savez", "np.savez_compressed", "VideoWriter"}
WRITERS |= {"tarfile.open"}

OWN = "files of the installed package"
SYSTEM = "the system's own, in /proc, /sys or /dev"
SCRATCH = "this process's own scratch folder, which it or its child has filled"
PIPE = "what a process of ours says, or text made in the line itself"
PASSED = "every file that it opens has passed the door before"
CACHE = "this user's own cache folder, whose owner is checked"
ATOMIC = "a function that is given the name that `atomic` gives"
EXCEPTIONS = {
    ("sensor_model/files/door.py", "os.open"): "the door itself",
    ("sensor_model/files/door.py", "json.loads"): "a variable of the environment",
    ("sensor_model/files/outside.py", "json.loads"): "a variable of the environment",
    ("sensor_model/files/outside.py", "path.read_bytes"): "the code of an installed package, whose rows run",
    ("sensor_model/files/scratch.py", "os.open"): "folders, to lock them",
    ("novags/testbed/study/engines/cluster.py", "os.open"): "the working directory, to return to it",
    ("sensor_model/fast/machine_code.py", "path.read_bytes"): OWN,
    ("novags/warm.py", "done.touch"): CACHE,
    ("novags/commands/new.py", "(Path(__file__).with_name('answers') / 'new' / f'{kind}.txt').read_text"): OWN,
    ("novags/testbed/report/charts.py", "STYLE.read_text"): OWN,
    ("novags/commands/answers/topics.py", "(_folder() / f'{topic}.txt').read_text"): OWN,
    ("novags/testbed/report/page.py", "(files('novags.testbed.report') / name).read_text"): OWN,
    ("novags/testbed/ledger/code.py", "path.read_bytes"): f"{OWN}, and of modules that are loaded already",
    ("novags/testbed/ledger/reach.py", "path.read_bytes"): f"{OWN}, and of modules that are loaded already",
    ("novags/testbed/ledger/reach.py", "stub.read_bytes"): OWN,
    ("novags/testbed/ledger/source.py", "Path(__file__).read_bytes"): OWN,
    ("novags/testbed/ledger/contents.py", "Path(__file__).read_bytes"): OWN,
    ("simscenes/backend.py", "driver.read_text"): SYSTEM,
    ("simscenes/loading/checks/trial_process.py", "os.open"): SYSTEM,
    ("simscenes/loading/checks/trial_process.py", "Path('/proc/self/status').read_text"): SYSTEM,
    ("simscenes/loading/checks/trial_process.py", "Path('/proc/meminfo').read_text"): SYSTEM,
    ("novags/failure.py", "os.open"): SYSTEM,
    ("novags/testbed/importing/programs.py", "(thread / 'children').read_text"): SYSTEM,
    ("novags/testbed/importing/programs.py", "Path(f'/proc/{process}/status').read_text"): SYSTEM,
    ("novags/testbed/console/cores.py", "(group / name).read_text"): SYSTEM,
    ("novags/testbed/console/groups.py", "MEMBERSHIP.read_text"): SYSTEM,
    ("novags/testbed/console/memory.py", "MEMINFO.read_text"): SYSTEM,
    ("novags/testbed/console/memory.py", "(group / name).read_text"): SYSTEM,
    ("novags/testbed/console/memory.py", "(group / 'memory.stat').read_text"): SYSTEM,
    ("novags/testbed/console/memory.py", "Path(f'/proc/{process}/statm').read_text"): SYSTEM,
    ("novags/testbed/console/provenance.py", "Path('/proc/cpuinfo').read_text"): SYSTEM,
    ("novags/testbed/console/provenance.py", "Path('/proc/self/status').read_text"): SYSTEM,
    ("novags/testbed/console/provenance.py", "Path('/proc/self/clear_refs').write_text"): SYSTEM,
    ("simscenes/loading/checks/trial.py", "json.loads"): PIPE,
    ("simscenes/loading/checks/trial_process.py", "json.loads"): PIPE,
    ("novags/fields/training/checkpoint.py", "json.loads"): PIPE,
    ("novags/splats/training/checkpoint.py", "json.loads"): PIPE,
    ("novags/testbed/study/knobs/splat_engine/child.py", "json.loads"): PIPE,
    ("novags/testbed/study/knobs/splats.py", "json.loads"): PIPE,
    ("novags/testbed/study/engines/worker.py", "pickle.loads"): PIPE,
    ("novags/testbed/study/versions/sides.py", "tarfile.open"): PIPE,
    ("simscenes/loading/load.py", "mi.load_file"): f"{PASSED} in check_xml",
    ("simscenes/loading/load.py", "mi.parser.parse_file"): f"{PASSED} in check_xml",
    ("simscenes/sets/readers/colmap.py", "pycolmap.Reconstruction"): f"{PASSED} in check_model",
    ("simscenes/sets/writers/camera_files.py", "pycolmap.Reconstruction"): "an empty model, to be filled and written",
    ("novags/cameras/motion/hloc.py", "pycolmap.Database.open"): SCRATCH,
    ("novags/cameras/motion/mapping.py", "pycolmap.Database.open"): SCRATCH,
    ("novags/cameras/motion/registration.py", "pycolmap.Database.open"): SCRATCH,
    ("novags/cameras/motion/registration.py", "listed.write_text"): SCRATCH,
    ("novags/cameras/motion/sfm.py", "pycolmap.Database.open"): SCRATCH,
    ("novags/cameras/networks/vggsfm.py", "pycolmap.Reconstruction"): SCRATCH,
    ("novags/testbed/study/engines/node.py", "open"): SCRATCH,
    ("novags/testbed/study/knobs/splat_engine/child.py", "np.save"): SCRATCH,
    ("sensor_model/files/own.py", "(own_folder(cache_folder(kind)) / name).touch"): CACHE,
    ("simscenes/job/finish.py", "np.save"): "into memory",
    (
        "simscenes/sets/pictures/exr.py",
        "OpenEXR.File",
    ): "in memory; what is written goes to the name that `atomic` gives",
    ("novags/testbed/dataset/shards.py", "tarfile.open"): ATOMIC,
    ("novags/testbed/dataset/recipes/write.py", "np.savez"): ATOMIC,
    ("sensor_model/files/camera_file.py", "np.savez_compressed"): "a buffer in memory, which `atomic` writes",
    ("novags/methods/averaging/scene.py", "archive.open"): ATOMIC,
    ("novags/testbed/flight/film.py", "self._path.touch"): ATOMIC,
    ("novags/testbed/flight/film.py", "cv2.VideoWriter"): ATOMIC,
    ("simscenes/loading/gltf/describe.py", "file.write_bytes"): SCRATCH,
    ("simscenes/loading/obj_files.py", "path.write_bytes"): SCRATCH,
    ("simscenes/sets/readers/colmap_check.py", "(Path(scratch) / f'points3D.{suffix}').write_bytes"): SCRATCH,
}


def text_of(node: ast.expr) -> str:
    return ast.unparse(node)


def is_one_of(function: ast.expr, names: set[str]) -> bool:
    whole = text_of(function)
    return whole in names or whole.rpartition(".")[2] in names or any(whole.endswith(f".{name}") for name in names)


def passed_names(tree: ast.AST) -> set[str]:
    """Names of what has come through the door: `with opened(path) as file`, `name = admitted(path)`."""
    bound: list[tuple[ast.expr, ast.expr]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.withitem) and node.optional_vars is not None:
            bound.append((node.context_expr, node.optional_vars))
        elif isinstance(node, ast.Assign):
            bound += [(node.value, target) for target in node.targets]
    pairs = [
        pair for value, target in bound
        for pair in (zip(value.elts, target.elts, strict=False)
                     if isinstance(value, ast.Tuple) and isinstance(target, ast.Tuple) else [(value, target)])
    ]  # fmt: skip
    return {target.id for value, target in pairs if isinstance(target, ast.Name) and has_passed(value, set())}


def has_passed(argument: ast.expr, names: set[str]) -> bool:
    parts = list(ast.walk(argument))
    called = {text_of(part.func).rpartition(".")[2] for part in parts if isinstance(part, ast.Call)}
    return bool(called & {*DOOR, "BytesIO"}) or any(isinstance(part, ast.Name) and part.id in names for part in parts)


def unguarded(source: str) -> set[str]:
    """Functions in a source text that open a file and have not been given what came through the door or `atomic`."""
    tree, found = ast.parse(source), set[str]()
    names = passed_names(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or (
            isinstance(node.func, ast.Name) and node.func.id in DOOR | {"write_text"}
        ):
            continue
        argument = node.args[0] if node.args else None
        owner = text_of(node.func.value) if isinstance(node.func, ast.Attribute) else ""
        temporary = owner == "temporary" or any(text_of(part) == "temporary" for part in node.args)
        if is_one_of(node.func, READERS) and not temporary and not (argument and has_passed(argument, names)):
            if owner not in ("webbrowser", "Image") or (argument and owner == "Image"):
                found.add(text_of(node.func))
        elif is_one_of(node.func, WRITERS) and not temporary:
            found.add(text_of(node.func))
    return found


def everything() -> dict[tuple[str, str], Path]:
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    return {
        (file.relative_to(ROOT).as_posix(), name): file
        for file in files
        for name in unguarded(file.read_text(encoding="utf-8"))
    }


def test_what_is_read_comes_through_the_door_and_what_is_written_appears_whole() -> None:
    assert {f"{file}: {name}" for file, name in everything().keys() - EXCEPTIONS.keys()} == set()


def test_no_exception_is_left_over() -> None:
    assert EXCEPTIONS.keys() - everything().keys() == set()


@pytest.mark.parametrize(
    "line",
    [
        "open(path)",
        "io.open(path, 'rb')",
        "path.open()",
        "path.read_bytes()",
        "Path(a, b).read_text(encoding='utf-8')",
        "json.loads(path.read_text())",
        "json.load(file)",
        "np.load(path)",
        "cv2.imread(str(path))",
        "OpenEXR.File(str(path))",
        "rawpy.imread(path)",
        "tifffile.imread(path)",
        "pycolmap.Reconstruction(folder)",
        "safe_open(path, 'pt')",
        "torch.load(path)",
        "mi.load_file(str(path))",
        "h5py.File(path)",
        "tomllib.loads(text)",
        "path.write_text('')",
        "np.save(path, values)",
        "open(path, 'w')",
    ],
)
def test_every_way_to_open_a_file_is_seen(line: str) -> None:
    assert unguarded(line) != set()


@pytest.mark.parametrize(
    "line",
    [
        "read_bytes(path)",
        "torch.load(BytesIO(read_bytes(path)))",
        "safe_open(admitted(path), 'pt')",
        "with opened(path) as file:\n    np.load(file)",
        "with atomic(path) as temporary:\n    temporary.write_bytes(b'')",
        "with atomic(path) as temporary:\n    np.save(temporary, values)",
        "name = admitted(path)\nraw.open_file(name)",
    ],
)
def test_what_has_come_through_the_door_passes(line: str) -> None:
    assert unguarded(line) == set()
