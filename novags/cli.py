"""The command line: the list of commands, and the entry point."""

import sys
from collections.abc import Callable

import tyro

from novags.commands.dataset import dataset
from novags.commands.experiment import run
from novags.commands.inquiries import doctor, help_, list_
from novags.commands.pareto import pareto
from novags.commands.photographs import denoise, import_
from novags.commands.results import characterise, export_results, report, score
from novags.commands.stages import capture, plan, poses, reconstruct, render
from novags.commands.study import study
from novags.commands.video import video
from novags.commands.view import view
from novags.failure import errors_in_one_line

COMMANDS: dict[str, Callable[..., None]] = {
    function.__name__.rstrip("_").replace("_", "-"): function
    for function in (
        run,
        study,
        dataset,
        pareto,
        list_,
        plan,
        render,
        poses,
        capture,
        import_,
        denoise,
        reconstruct,
        score,
        report,
        view,
        video,
        export_results,
        characterise,
        doctor,
        help_,
    )
}


def main() -> None:
    """Entry point: run a command."""
    if sys.argv[1:] == ["--version"]:
        from importlib.metadata import version

        print(f"novags {version('novags')}")
        return
    with errors_in_one_line():
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="novags", description=DESCRIPTION)


DESCRIPTION = "Test bed for low-light 3D reconstruction: rendered truth, dark captures, reconstructions, scores."
