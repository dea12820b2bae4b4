"""`novags run`: a whole comparison."""

from pathlib import Path

from novags.commands.shared import announce, cameras_of, command_line, variants_of, writing
from novags.options import Define, Device, PresetName, Repeated


def run(
    *,
    preset: PresetName = "demo",
    scene: str | None = None,
    define: Define = (),
    sensor: str | None = None,
    electrons: float | None = None,
    out: Path | None = None,
    methods: tuple[str, ...] | None = None,
    variant: Repeated = (),
    cameras: str | None = None,
    refine_cameras: bool = False,
    views: int | None = None,
    width: int | None = None,
    height: int | None = None,
    spp: int | None = None,
    points: int | None = None,
    iterations: int | None = None,
    denoiser_steps: int | None = None,
    seed: int | None = None,
    device: Device = "auto",
    wait: bool = False,
) -> None:
    """Run a whole experiment: render, capture in the dark, reconstruct with several methods, score, report.

    Finished work is kept: the same command again does only what is missing.

    Args:
        preset: Source of every setting that is not given here.
        scene: A scene of the catalogue ("tabletop", or "tabletop:3" for its variation 3), or a Mitsuba .xml file.
        define: What a parameter of a Mitsuba file stands for, NAME=VALUE; may be given several times.
        sensor: A camera of sensor_model.PRESETS, or a TOML file of your own.
        electrons: Mean signal of the green channel over the set, electrons per pixel and exposure.
        out: Folder of the experiment; out/PRESET if not given.
        methods: Methods and variants to compare; `novags list methods` names them.
        variant: A method with settings changed, NAME=METHOD:SETTING=VALUE,SETTING=VALUE, compared as well; may be given
            several times. Or a TOML file with tables [variant.NAME].
        cameras: Where cameras come from: known, known:rotation_deg=1, sfm, vggt:checkpoint=FILE; see `novags help
            cameras`.
        refine_cameras: Let every fit correct its training cameras.
        views: Number of views.
        width: Image width in pixels.
        height: Image height in pixels.
        spp: Samples per pixel of the render.
        points: Gaussians at the start.
        iterations: Of the fit.
        denoiser_steps: Of the denoiser before the fit starts.
        seed: Of noise and training.
        device: Where training runs; auto takes a GPU if there is one that can be used.
        wait: If another process is writing there, wait until it is done instead of refusing.
    """
    from novags.testbed import experiment
    from novags.testbed.presets import EXPERIMENTS, adapted

    chosen = adapted(
        EXPERIMENTS[preset], scene=scene, sensor=sensor, electrons=electrons, methods=methods, n_views=views,
        width=width, height=height, spp=spp, points=points, iterations=iterations,
        denoiser_steps=denoiser_steps, seed=seed,
        variants=variants_of(variant), cameras=cameras_of(cameras), refine_cameras=refine_cameras, device=device,
        parameters=define or None,
    )  # fmt: skip
    folder = out if out is not None else Path("out") / preset
    with writing(folder, wait) as console:
        report_path = experiment.run(chosen, folder, console, command=command_line())
    announce(report_path)
