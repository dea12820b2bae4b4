"""Simulated pairs: a clean picture, photographed by a camera drawn at random, in light drawn at random.

The camera is `sensor_model`'s own. A network is given electrons and the read variance that the camera states. It is to
find the electrons that the same light gives without noise, of all channels of all pixels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from denoising.pictures import Picture, picture
from novags.methods.denoised.packing import mask_of, spread
from sensor_model import DarkFrames, Exposure, Measured, Sensor, expose, mosaic, raw_noise
from sensor_model.params import CFAS
from simscenes.sets.multiview import load_set

Rng = np.random.Generator
EXPOSURE = Exposure(time=1 / 30)
LEVELS = (1.0, 200.0)  # e-, mean green over a picture
READ_NOISE = (0.4, 4.0)  # e-
BAYER_SHARE = 0.5
RENEWED = 4  # steps after which one picture of the stock is exchanged


Camera = tuple[Sensor, DarkFrames | None]
"""What takes a picture; the noise that is there without light is drawn from dark frames, if there are any."""
Cameras = Callable[[Rng], Camera]
"""Draws one for each picture."""


@dataclass(frozen=True)
class Pairs:
    """A batch.

    Attributes:
        electrons: The measurements, [B, 3, H, W]; 0 where nothing was measured.
        mask: 1 where something was, [B, 3, H, W].
        read_variance: [B, 3], electrons**2.
        clean: Without noise, [B, 3, H, W], electrons.
    """

    electrons: Tensor
    mask: Tensor
    read_variance: Tensor
    clean: Tensor


def random_camera(rng: Rng, *, bayer: bool) -> Sensor:
    """Any gain, read noise and filters, a small fixed pattern, some row noise; half of them with heavy tails."""
    sigma = float(np.exp(rng.uniform(*np.log(READ_NOISE))))
    bits = int(rng.integers(12, 17))
    gain = float(np.exp(rng.uniform(np.log(0.5), np.log(12.0))))
    return Sensor(
        gain=gain, eta=0.6, mu_e_sat=float(np.exp(rng.uniform(np.log(800), np.log(20_000)))), black_level=256.0,
        bits=bits, sigma_d=sigma, tukey_lambda=float(rng.uniform(-0.15, 0.14)) if rng.random() < 0.5 else None,
        sigma_row=float(rng.uniform(0, 0.15)) * sigma, prnu=float(rng.uniform(0, 0.01)),
        dsnu=float(rng.uniform(0, 0.2)) * sigma, cfa=CFAS[int(rng.integers(4))] if bayer else None,
        rgb_response=(float(rng.uniform(0.3, 1.0)), 1.0, float(rng.uniform(0.3, 1.0))),
        serial=int(rng.integers(2**32)),
    )  # fmt: skip


def any_camera(rng: Rng) -> Camera:
    """A camera that nobody built: the network is to work for all."""
    return random_camera(rng, bayer=rng.random() < BAYER_SHARE), None


class TheseCameras:
    """Copies of given cameras, each as likely as any other, mosaics and three chips alike.

    Each picture has a copy of its own, with another fixed pattern: what is learnt is a kind of camera. With dark frames
    all noise that is there without light is theirs, and each picture sees another part of them.
    """

    def __init__(self, sensors: Sequence[Sensor], dark: DarkFrames | None = None) -> None:
        if dark is not None and len(sensors) != 1:
            raise ValueError(
                f"dark frames are of one camera, got {len(sensors)} cameras beside them: name theirs alone"
            )
        self.sensors, self.dark = tuple(sensors), {}
        if dark is not None:
            for cfa in (sensors[0].cfa, None):
                self.dark[cfa] = DarkFrames(codes=dark.codes, sensor=replace(sensors[0], cfa=cfa), gain=dark.gain)

    def __call__(self, rng: Rng) -> Camera:
        """One copy of one of them."""
        sensor = self.sensors[int(rng.integers(len(self.sensors)))]
        cfa = sensor.cfa if rng.random() < BAYER_SHARE else None
        return replace(sensor, cfa=cfa, serial=int(rng.integers(2**32))), self.dark.get(cfa)


def photograph(clean: Picture, sensor: Sensor, electrons: float, seed: int, dark: DarkFrames | None = None) -> Pairs:
    """One picture, linear RGB [H, W, 3], at this mean of its green channel, as a batch of one.

    What a camera with dark frames is told of its noise is the noise of these.
    """
    mean = clean.astype(np.float64) * np.asarray(sensor.rgb_response) * (electrons / clean[..., 1].mean())
    photons = mean / sensor.eta
    light = photons if sensor.cfa is None else mosaic(photons, sensor.cfa)
    exposure, measured = EXPOSURE, None
    if dark is not None:
        exposure, measured = replace(EXPOSURE, origin=_place(dark, light, seed)), Measured(dark=dark)
    frame = expose(light, sensor, exposure, seed=seed, view=0, threads=1, measured=measured)
    told = sensor if dark is None else dark.described
    noise = raw_noise(told, EXPOSURE)
    found = torch.from_numpy((frame.dn - sensor.black_level).astype(np.float32) / sensor.gain)
    mask = mask_of(clean.shape[:2], sensor.cfa)
    spaced = found.permute(2, 0, 1)[None] if sensor.cfa is None else spread(found[None], mask)
    spaced = (spaced - torch.tensor(told.rgb_bias, dtype=torch.float32)[:, None, None] / sensor.gain) * mask
    variance = torch.tensor(noise.offset, dtype=torch.float32)[None] / sensor.gain**2
    truth = torch.from_numpy(np.minimum(mean, sensor.capacity_e).astype(np.float32)).permute(2, 0, 1)[None]
    return Pairs(spaced, mask, variance, truth)


def _place(dark: DarkFrames, light: np.ndarray, seed: int) -> tuple[int, int]:
    """Where in the dark frames a picture lies; even, as colour filters begin."""
    rng = np.random.default_rng([seed, 11])
    y, x = (
        2 * int(rng.integers((whole - part) // 2 + 1))
        for whole, part in zip(dark.codes.shape[1:], light.shape[:2], strict=True)
    )
    return y, x


class Source:
    """Clean pictures: the views of rendered sets, and a stock of synthetic ones that is renewed as training goes on."""

    def __init__(self, sets: list[Path], *, size: int, stock: int, rendered_share: float) -> None:
        self.size, self.stock, self.share = size, stock, rendered_share if sets else 0.0
        self.rendered = [radiance for folder in sets for radiance in _views(folder)]
        self.made: dict[int, tuple[int, Picture]] = {}

    def draw(self, rng: Rng, step: int, crop: int) -> Picture:
        """A crop [crop, crop, 3] with the exposure of its whole picture, flipped and turned, its colours exchanged."""
        if rng.random() < self.share:
            whole = self.rendered[int(rng.integers(len(self.rendered)))]
        else:
            whole = self._synthetic(int(rng.integers(self.stock)), step)
        if crop > min(whole.shape[:2]):
            height, width = whole.shape[:2]
            raise ValueError(f"a crop must fit into every picture, got {crop} px and a picture of {width} x {height}: "
                             "choose a smaller --crop")  # fmt: skip
        whole = whole / whole[..., 1].mean()
        top, left = (int(rng.integers(side - crop + 1)) for side in whole.shape[:2])
        part = whole[top : top + crop, left : left + crop]
        part = np.rot90(part, int(rng.integers(4)))
        part = part[:, ::-1] if rng.random() < 0.5 else part
        return np.ascontiguousarray(part[..., rng.permutation(3)])

    def _synthetic(self, slot: int, step: int) -> Picture:
        """One slot is renewed at every `RENEWED` steps, in turn; its content depends on the step alone."""
        number = slot + self.stock * ((step // RENEWED - slot) // self.stock + 1)
        held = self.made.get(slot)
        if held is None or held[0] != number:
            held = self.made[slot] = number, picture(number, self.size)
        return held[1]


def _views(folder: Path) -> list[Picture]:
    """The views of a rendered set without their Monte Carlo noise: see `_smoothed`."""
    source = load_set(folder)
    found = []
    for i in range(len(source.names)):
        geometry = source.geometry(i)
        assert geometry is not None, f"{folder} holds no albedo: render it with novags render"
        radiance = _smoothed(source.radiance(i), geometry["albedo"])
        found.append((radiance + 2e-3 * np.median(radiance)).astype(np.float32))
    return found


def _smoothed(radiance: Picture, albedo: Picture) -> Picture:
    """The albedo, which has no noise, times the light that falls on it, as a median and a blur over neighbours.

    A clean picture need not be right, but it must be clean: of noise that is left in it, a network learns to keep some.
    """
    reflecting = np.maximum(albedo, 0.02)  # black surfaces and empty space show light of their own alone
    light = np.maximum(radiance, 0) / reflecting
    planes = [cv2.medianBlur(np.ascontiguousarray(light[..., c], np.float32), 5) for c in range(3)]
    return cv2.GaussianBlur(np.stack(planes, -1), (0, 0), 1.5) * reflecting


def batch(source: Source, cameras: Cameras, rng: Rng, step: int, *, crop: int, count: int) -> Pairs:
    """So many pairs of crops."""
    low, high = np.log(LEVELS)
    made = []
    for _ in range(count):
        sensor, dark = cameras(rng)
        clean = source.draw(rng, step, crop)
        # The level belongs to a whole picture, so that dark corners are seen as well as bright ones.
        level = float(np.exp(rng.uniform(low, high))) * float(clean[..., 1].mean())
        made.append(photograph(clean, sensor, max(level, 0.02), int(rng.integers(2**31)), dark))
    return Pairs(*(torch.cat([getattr(one, name) for one in made]) for name in Pairs.__dataclass_fields__))


@dataclass
class Batches(Dataset[Pairs]):
    """Batches by the number of their step, so that another process can make them ahead."""

    source: Source
    cameras: Cameras
    seed: int
    crop: int
    count: int

    def __getitem__(self, step: int) -> Pairs:
        rng = np.random.default_rng([self.seed, step])
        return batch(self.source, self.cameras, rng, step, crop=self.crop, count=self.count)
