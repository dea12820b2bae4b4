"""Claims about the command line: it starts without the heavy libraries, and says what is wrong in one line."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags import cli, options
from novags.__main__ import main
from novags.commands.shared import typed

Call = Callable[..., int]


def test_variants_and_cameras_reach_the_experiment(call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from novags.cameras.sources.known import KnownConfig
    from novags.testbed.study import place

    seen = []
    monkeypatch.setattr(place, "run", lambda preset, *_, **__: seen.append(preset) or tmp_path)
    words = ["--variant", "a=nova-fast:sh_weight=0.5", "--variant", "b=a:consistency=none", "--iterations", "7"]
    words += ["--cameras", "known:rotation_deg=2", "--refine-cameras", "--device", "cpu", "--out", str(tmp_path)]
    assert call("run", *words) == 0
    (preset,) = seen
    assert preset.methods[-2:] == ("a", "b")
    found = preset.reconstruct("b")
    assert (found.config.sh_weight, found.config.consistency, found.config.fit.iterations) == (0.5, None, 7)
    assert found.cameras == KnownConfig(rotation_deg=2.0)
    assert found.config.fit.refine_cameras is not None
    assert found.device == "cpu"


def test_a_variant_that_is_spelled_out_is_compared_beside_the_methods_that_are_named(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As `novags help variants` has it; a file may hold more variants than one wants."""
    from novags.testbed.study import place

    seen = []
    monkeypatch.setattr(place, "run", lambda preset, *_, **__: seen.append(preset.methods) or tmp_path)
    (tmp_path / "more.toml").write_text(
        '[variant.x]\nmethod = "naive"\n[variant.y]\nmethod = "naive"\n[variant.z]\nmethod = "naive"\n'
    )
    words = ["run", "--methods", "naive", "x", "z", "--variant", "l1=naive:fit.dssim_weight=0", "--out", str(tmp_path)]
    assert call(*words, "--variant", str(tmp_path / "more.toml")) == 0
    assert seen == [("naive", "x", "z", "l1")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "--variant", "a"), "a variant is NAME=METHOD:SETTING=VALUE"),
        (("run", "--methods", "navie"), "unknown method 'navie'; did you mean 'naive'"),
        (("run", "--cameras", "sffm"), "did you mean sfm"),
        (("help", "electron"), "did you mean 'electrons'"),
    ],
)
def test_a_wrong_word_is_one_line_with_the_near_ones(
    call: Call, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert call(*words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize("words", [("--version",), ("list", "methods"), ("help",), ("help", "scores")])
def test_the_front_door_answers(call: Call, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    assert call(*words) == 0
    assert len(capsys.readouterr().out.split()) >= 2


@pytest.mark.parametrize("command", ["plan", "render"])
def test_light_has_the_same_options_everywhere(call: Call, capsys: pytest.CaptureFixture[str], command: str) -> None:
    import dataclasses

    assert call(command, "--help") == 0
    text = capsys.readouterr().out
    for option in dataclasses.fields(options.LightOptions):
        assert re.search(rf"--{option.name.replace('_', '-')}[ ,]", text)
    where = ["--out", "x"] if command == "render" else ["--sensor", "ideal", "--electrons", "9"]
    wrong = ["--on", "motion blur", "--max-depth", "6", "--aperture-radius", "0.1", "--focus-distance", "2"]
    wrong += ["--motion", "9"]
    assert call(command, "cornell", *where, *wrong) == 2
    assert "motion is a fraction of the step between views in (0, 2], got 9" in capsys.readouterr().err


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_every_command_explains_every_option(call: Call, capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert call(command, "--help") == 0
    text = capsys.readouterr().out
    import inspect

    assert cli.COMMANDS[command].__doc__.splitlines()[0][:40] in " ".join(text.split())
    for name in inspect.signature(cli.COMMANDS[command]).parameters:
        assert f"{name}:" in cli.COMMANDS[command].__doc__


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["capture", "no-such-folder", "--out", "x"], "no such folder"),
        (["capture", "y", "--out", "x", "--sensor", "kodak"], "unknown sensor 'kodak'"),
        (["capture", "y", "--out", "x", "--electrons", "-1"], "electrons must be > 0"),
        (["capture", ".", "--out", "inside/it"], "must not lie inside its input"),
        (["reconstruct", "no-such-folder", "--out", "x"], "no such capture folder"),
        (["reconstruct", "y", "--out", "x", "--method", "magic"], "unknown method 'magic'"),
        (["reconstruct", "..", "--out", "x"], "must not lie inside"),
        (["score", "no-such-folder"], "no such folder"),
        (["score", "."], "neither a run"),
        (["report", "."], "neither a run"),
        (["render", "no-such-scene", "--out", "x"], "no-such-scene"),
        (["render", "missing.xml", "--out", "x"], "missing.xml cannot be read"),
        (["run", "--methods", "nova", "nova"], "once each"),
        (["run", "--views", "1"], "n_views must be >= 3"),
        (["run", "--budget", "soon"], "a budget is a time like 120s"),
        (["run", "--budget", "0s"], "a budget must be more than no time"),
        (["run", "--budget", "60s", "--cameras", "sfm"], "leave out --cameras or --budget"),
        (["run", "--budget", "60s", "--photos", "x"], "novags poses first"),
        (["run", "--budget", "60s", "--curves", "x"], "cannot read the curves x"),
        (["run", "--curves", "x"], "belong to a budget"),
        (["pareto", "rendr", "--out", "x"], "did you mean 'render'"),
        (["pareto", "sensor", "--out", "x", "--repeats", "0"], "repeats must be >= 1"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(
    call: Call,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*arguments) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert len(lines) == 1
    assert lines[0].startswith("novags: error: ")
    assert message in lines[0]


def test_the_traceback_is_there_for_those_who_ask(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOVAGS_TRACEBACK", "1")
    with pytest.raises(ValueError, match="no such folder"):
        call("score", "no-such-folder")


@pytest.mark.parametrize(
    "error", [RuntimeError("first\nsecond"), RecursionError("deep"), KeyError("x"), BaseException("a panic")]
)
def test_what_nobody_foresaw_is_one_line_with_the_file_and_the_way_to_a_report(
    call: Call,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    error: BaseException,
) -> None:
    from novags.testbed.folders import set as sets

    def broken(*_: object) -> None:
        raise error

    (tmp_path / "photographs").mkdir()
    monkeypatch.setattr(sets, "load_set", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert call("capture", str(tmp_path / "photographs"), "--out", str(tmp_path / "x")) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"novags: error: unexpected {type(error).__name__} (at {tmp_path / 'photographs'}): ")
    (report,) = tmp_path.glob("novags-traceback-*.txt")
    assert line.endswith(f"please report it: the traceback is in {report}")
    text = report.read_text(encoding="utf-8")
    assert "novags capture" in text.splitlines()[0]
    assert "Traceback (most recent call last)" in text


def test_too_little_memory_is_one_line_even_where_nothing_can_be_written(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from novags.testbed import stages

    def too_large(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(stages, "capture", too_large)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert call("capture", ".", "--out", "x") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "choose smaller pictures" in line
    assert line.endswith("NOVAGS_TRACEBACK=1 before the same command shows the traceback")


def test_a_path_that_is_not_utf8_is_refused_before_any_work(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("capture", "a\udcff", "--out", "x") == 2
    assert "is not valid UTF-8: rename that file or folder" in capsys.readouterr().err


@pytest.mark.parametrize("words", [("ren\x07der", "a"), ("render", "a\x07"), ("render", "a", "--out", "\x07")])
def test_a_word_that_a_terminal_would_obey_is_refused_wherever_it_stands(
    words: tuple[str, ...], call: Call, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*words) == 2
    assert "holds control characters: rename that file or folder" in capsys.readouterr().err


def test_an_interruption_says_how_to_continue(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from novags.testbed import stages

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(stages, "capture", interrupted)
    assert call("capture", ".", "--out", "x") == 130
    assert "the same command again continues" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["list", "scenes"], ["render", "--help"], ["list", "scene"]])
def test_a_command_that_nobody_listens_to_ends_without_a_word_of_it(words: list[str]) -> None:
    """As in `novags list scenes | head -1`; a fault of the command itself is still said."""
    with subprocess.Popen(
        [sys.executable, "-m", "novags", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    wrong = words == ["list", "scene"]
    assert process.returncode == (2 if wrong else 141)
    assert "pipe" not in said.lower()
    assert bool(said) == wrong


def test_a_command_without_standard_output_does_its_work() -> None:
    """As `novags list scenes >&-` does, and some servers that start commands."""
    command = shlex.join([sys.executable, "-m", "novags", "list", "scenes"])
    done = subprocess.run(["sh", "-c", f"{command} >&-"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("gsplat", ["1.5.3", None])
def test_doctor_says_whether_fits_run_on_the_gpu(gsplat: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    from novags.commands.answers import doctor

    monkeypatch.setattr(doctor, "package_version", lambda name: gsplat if name == "gsplat" else "1.0")
    monkeypatch.setattr(doctor, "_import_problem", lambda module: "")
    machine = doctor.hardware() | {"gpu": "some card"}
    monkeypatch.setattr(doctor, "hardware", lambda: machine)
    findings = {finding.name: finding for finding in doctor.examine()}
    said = "fits run on it (--device cpu: not)" if gsplat else "fits run on the processor until pip install"
    assert findings["CUDA"].detail.startswith(f"some card; {said}")
    assert findings["CUDA"].state == findings["gsplat"].state == ("ok" if gsplat else "missing")
    assert "VGGT" not in findings  # nothing here uses it


@pytest.mark.parametrize("name", ["torch", "pycolmap"])
def test_doctor_finds_what_is_installed_and_cannot_be_imported(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.py").write_text("raise ImportError('libstrange.so.1: cannot open shared object file')")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    done = subprocess.run([sys.executable, "-m", "novags", "doctor"], capture_output=True, text=True, check=False,
                          env=environment)  # fmt: skip
    assert done.returncode == 1
    assert re.search(rf"BROKEN +{name} .*cannot be imported \(ImportError: libstrange", done.stdout)
    assert "something needed is broken" in done.stdout


def test_doctor_finds_what_the_tests_themselves_need(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("doctor") == 0
    text = capsys.readouterr().out
    assert "ok       torch" in text
    assert "ok       pycolmap" in text
    assert "ok       mitsuba" in text
    assert "ready: novags run --preset demo" in text
    assert "BROKEN" not in text


@pytest.mark.parametrize("command", ["poses", "capture", "reconstruct", "import"])
def test_the_next_command_is_one_that_a_shell_takes_whatever_the_folder_is_called(
    call: Call, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str
) -> None:
    from novags.testbed import stages

    folder, out = tmp_path / "Fotos ä (1)", tmp_path / "it's $HOME & more"
    folder.mkdir()
    for stage in ("poses", "capture", "reconstruct", "import_photographs"):
        monkeypatch.setattr(stages, stage, lambda *_, **__: {})
    assert call(command, str(folder), "--out", str(out)) == 0
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("next: "))
    words = shlex.split(line.removeprefix("next: "))
    assert str(out) in words
    done = subprocess.run(["sh", "-c", f"novags() {{ printf '%s\\n' \"$@\"; }}\n{line[6:].partition(', or')[0]}"],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert str(out) in done.stdout.splitlines()


def test_commands_that_messages_advise_are_such_that_a_shell_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from novags.testbed.console.terminal import Console
    from novags.testbed.report import place
    from novags.testbed.stages import import_photographs
    from novags.testbed.stages.configs.importing import ImportConfig
    from novags.testbed.study.budget.known import known

    folder = tmp_path / "Fotos ä (1)"
    folder.mkdir()
    (folder / "curves.jsonl").write_text("")
    (folder / "one.png").touch()  # photographs without cameras
    run: Any = SimpleNamespace(path=folder, metrics=lambda: None)
    quiet = Console(quiet=True)
    for attempt, advice in (
        (lambda: import_photographs(folder, tmp_path / "out", ImportConfig(), quiet), "novags poses {} --out SET"),
        (lambda: known(folder), "novags pareto METHOD --out {} measures"),
        (lambda: place.merged({"naive": run}), "run novags score {}"),
    ):
        with pytest.raises(ValueError, match=re.escape(advice.format(f"'{folder}'"))):
            attempt()


def test_ctrl_c_while_a_library_loads_is_an_interruption(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: pycolmap makes "Cannot import the C++ backend" of it, which was to be reported with a traceback."""

    def load(*_: object) -> str:
        try:
            try:
                raise KeyboardInterrupt
            except KeyboardInterrupt as key:
                raise ImportError("initialization failed") from key
        except ImportError as error:
            raise RuntimeError("Cannot import the C++ backend") from error

    monkeypatch.setattr("novags.commands.answers.catalogue.listing", load)
    assert call("list") == 130
    assert capsys.readouterr().err.startswith("novags: interrupted; the same command again continues")


@pytest.mark.parametrize(
    ("path", "shown"), [("-dash", "./-dash"), ("a b", "'a b'"), ("out/-x", "out/-x"), ("-a b", "'./-a b'")]
)
def test_next_commands_name_paths_that_can_be_typed(path: str, shown: str) -> None:
    assert typed(Path(path)) == shown


def test_ctrl_c_while_numpy_loads_is_said_without_it(
    call: Call, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rationale: numpy, half loaded, ended the command with a thousand lines of its recursion and the exit code 1."""

    def load(*_: object) -> str:
        monkeypatch.setitem(sys.modules, "sensor_model.files.reading", None)  # importing that fails from here on
        raise KeyboardInterrupt

    monkeypatch.setattr("novags.commands.answers.catalogue.listing", load)
    assert call("list") == 130
    assert capsys.readouterr().err == "novags: interrupted; the same command again continues where this one stopped\n"


def test_folders_that_differ_after_a_dot_have_experiments_of_their_own(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Rationale: garden.v1 and garden.v2 both went to out/demo-garden, where the second was refused."""
    from novags.testbed.study import place

    seen = []
    monkeypatch.setattr(place, "run", lambda preset, out, *_, **__: seen.append(out.name) or out / "report.html")
    monkeypatch.chdir(tmp_path)
    for name in ("garden.v1", "garden.v2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "transforms.json").write_text("{}")
        assert call("run", "--scene", name) == 0
    assert seen == ["demo-garden.v1", "demo-garden.v2"]


def test_a_name_longer_than_any_file_is_not_repeated_whole(call: Call, capsys: pytest.CaptureFixture[str]) -> None:
    name = "x" * 5000
    for words in (
        ("score", name), ("report", name), ("render", name, "--out", "x"), ("capture", name, "--out", "x"),
        ("run", "--scene", name), ("run", "--methods", name), ("run", "--cameras", f"known:{name}=1"),
        ("run", "--variant", f"a=nova:{name}=1"), ("study", f"{name}.toml", "--out", "x"), ("help", name),
    ):  # fmt: skip
        assert call(*words) in (1, 2)
        (line,) = capsys.readouterr().err.splitlines()
        assert "traceback" not in line
        assert len(line) < 900


def test_on_windows_it_says_where_it_runs_before_it_imports_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(SystemExit, match="Windows has no fcntl, .*: run novags in WSL 2"):
        main()
