"""The commands about photographs of one's own, and about single pictures: import, denoise."""

from pathlib import Path
from typing import Literal

from novags.commands.shared import next_, say, typed, writing
from novags.options import Device, Folder


def import_(
    folder: Folder, *, out: Path, lit: Path | None = None, clean: Path | None = None, sensor: str | None = None,
    time: float | None = None, black: float = 0.0, white: float = 65535.0,
    curve: Literal["auto", "linear", "srgb"] = "auto", demosaic: Literal["menon", "malvar", "bilinear"] = "menon",
    max_size: int | None = None, split: Literal["own", "every8"] = "own",
    dataset: Literal["auto", "none", "LOM", "LLNeRF", "LLRS", "MVTV", "RealX3D"] = "auto",
    overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Make a capture of photographs that were taken in the dark, with all truth there is about them.

    Args:
        folder: Dark photographs with cameras: a nerfstudio, instant-ngp or NeRF-synthetic folder (transforms*.json), a
            COLMAP folder (sparse/0, images) or an LLFF folder (poses_bounds.npy, images) with 8-bit or 16-bit pictures
            or camera raw files; raw files of the pictures in raw/. Or a scene of a published data set
            (--dataset), whose lit pictures are found too.
        out: Folder of the capture.
        lit: Folder of the same views in good light: pictures of the same names, or as many in the same order.
        clean: Folder of long exposures of the same views in the same light: the noise-free exposures.
        sensor: The camera that took them, of sensor_model.PRESETS or a TOML file: tells methods the noise.
        time: Exposure time in seconds, which then counts for all views; from the raw files if not given.
        black: Code of no light in 16-bit pictures.
        white: Code of white in 16-bit pictures.
        curve: Of the codes of 16-bit pictures; auto: as the file says (PNG chunks, colour profile), else linear.
        demosaic: Interpolation of the colour filter array of raw files.
        max_size: Scale larger images down to this longest side, in pixels.
        split: Which views are held out: own, as the folder or the data set says, every 8th where it says nothing; or
            every8, every 8th of all.
        dataset: The published data set that the folder is a scene of; auto goes by its looks, none leaves it.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.testbed import stages
    from novags.testbed.stages.configs.importing import ImportConfig

    config = ImportConfig(
        lit=lit, clean=clean, sensor=sensor, time=time, black=black, white=white, curve=curve, demosaic=demosaic,
        max_size=max_size, split=split, dataset=dataset,
    )  # fmt: skip
    with writing(out, wait, dry_run=dry_run) as console:
        stages.import_photographs(folder, out, config, console, overwrite=overwrite)
        say(out)
        next_(f"novags reconstruct {typed(out)} --method nova-fast --out RUN")


def denoise(
    capture: Folder, *, out: Path, adapt: bool = True, turns: int = 8, seed: int = 0, device: Device = "auto",
    overwrite: bool = False, wait: bool = False,
    dry_run: bool = False,
) -> None:  # fmt: skip
    """Take the noise out of the pictures of a capture, one by one: no cameras, no 3D model.

    A network that was trained on simulated cameras works on the raw data, and demosaics them as well. Dark photographs
    of your own become a capture with `novags import`; their camera has to be known.

    Args:
        capture: Folder of the capture.
        out: Folder of the pictures: linear/*.png (16 bits, linear, 65535 is white) and srgb/*.png (8 bits).
        adapt: Train the network further on these pictures themselves, without truth: ten seconds to half a minute.
        turns: Flips and quarter turns whose estimates are averaged, 1 to 8: time goes with it.
        seed: Of the adaptation.
        device: Where the network runs; auto takes a GPU if there is one that can be used.
        overwrite: Replace a finished result of another request in the same folder.
        wait: If another process is writing there, wait until it is done instead of refusing.
        dry_run: Only say whether it would be made, or made again and why. Nothing is written.
    """
    from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
    from novags.testbed import stages
    from novags.testbed.stages.configs.denoising import DenoisePicturesConfig

    how = DenoiseConfig(adapt=AdaptConfig() if adapt else None, turns=turns)
    config = DenoisePicturesConfig(denoise=how, seed=seed, device=device)
    with writing(out, wait, dry_run=dry_run) as console:
        stages.denoise(capture, out, config, console, overwrite=overwrite)
        say(out)
        next_(f"novags reconstruct {typed(capture)} --method nova-fast --out RUN")
