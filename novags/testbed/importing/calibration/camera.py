"""A camera from its frames: at one setting, or at several ISOs, from FOLDER/isoN as `frames` describes each.

Without flat frames gain is assumed, by a rule; nothing in a folder of dark frames shows it. Some dark frames are held
out, and compared with what the camera that was found shows without light.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from novags.testbed.folders.photographs.dng_tags import directories
from novags.testbed.importing.calibration.frames import (
    Frames,
    colours,
    iso_folders,
    listed,
    plane,
    read_frames,
    stacks_in,
)
from sensor_model.capture import expose
from sensor_model.characterisation import (
    HOT,
    Characterisation,
    GainFit,
    Stack,
    average,
    characterise,
    gain_fits,
    parabola,
    temporal_variance,
)
from sensor_model.files.camera_file import sensor_from_dict
from sensor_model.files.reading import reading
from sensor_model.frame.measured import DarkFrames, Measured
from sensor_model.params import Exposure, Sensor, require
from sensor_model.presets import ASSUMED_QE, DAYLIGHT

RULE = 0.1  # DN/e- at ISO 100 and 14 bits: "Noise modelling in one hour", 5 % off for the A7S II
HELD_OUT = 4  # of so many dark frames one is kept for the test
ENOUGH = 8  # frames for a test, and for maps
NOISE_PROFILE, BLACK, WHITE = 51041, 50714, 50717  # tags of DNG


@dataclass(frozen=True, kw_only=True)
class MeasuredSetting:
    """A camera at one ISO.

    Attributes:
        sensor: The camera.
        found: Everything that its frames say; None without flat frames.
        assumed: What they do not say, and where it is from.
        test: Dark frames that were held out beside the camera without light, as lines of a table.
        maps: Of single pixels, if they were asked for.
        profile: Gain by the files' own NoiseProfile, DN/e-.
    """

    sensor: Sensor
    found: Characterisation | None
    assumed: Mapping[str, str]
    test: tuple[str, ...]
    maps: Measured | None
    profile: float | None

    def lines(self) -> list[str]:
        """What is known, for people."""
        s = self.sensor
        told = [f"{name:>16} {getattr(s, name):.5g} assumed: {why}" for name, why in self.assumed.items()]
        measured = [f"{name:>16} {getattr(s, name):.5g}" for name in ("black_level", "sigma_d", "sigma_row", "dsnu")]
        told += measured if self.found is None else str(self.found).splitlines()
        if self.profile is not None:
            share = self.profile / s.gain
            told.append(f"{'gain by file':>16} {self.profile:.5g} DN/e- (DNG's NoiseProfile), {share:.3g} of the above")
        return [*told, *self.test]


@dataclass(frozen=True, kw_only=True)
class OwnCamera:
    """A camera at every ISO that was measured; of one setting the ISO is 0."""

    settings: Mapping[int, MeasuredSetting]
    fits: tuple[GainFit, ...]

    def __str__(self) -> str:
        """A table."""
        lines = []
        for iso, setting in self.settings.items():
            lines += [f"ISO {iso}"] * bool(iso) + setting.lines()
        for fit in self.fits:
            miss = f"misses by {fit.residual:.2%} at most" if fit.residual else "too few ISOs for a line to miss"
            lines.append(
                f"ISO {fit.isos[0]:g} to {fit.isos[1]:g}: gain = {fit.slope:.5g} ISO {fit.start:+.3g} DN/e-, {miss}"
            )
        for low, high in zip(self.fits[:-1], self.fits[1:], strict=True):
            lines.append(f"dual gain: the pixels switch between ISO {low.isos[1]:g} and {high.isos[0]:g}")
        return "\n".join(lines)


def characterise_folder(folder: Path, *, window: int = 1024, maps: bool = False) -> OwnCamera:
    """Estimate a camera from its frames.

    Args:
        folder: As above.
        window: Side of the central square of the sensor that is used, in pixels: bounds memory.
        maps: Also measure every pixel of it.

    Raises:
        ValueError: If the folder is not laid out as above, or does not hold enough.
    """
    isos = iso_folders(folder) if folder.is_dir() else {}
    if not isos:
        return OwnCamera(settings={0: _setting(folder, folder, window, maps)}, fits=())
    settings = {}
    for iso, place in isos.items():
        settings[int(iso)] = _setting(place, place if (place / "frames.toml").exists() else folder, window, maps)
    kinds = {(setting.sensor.bits, setting.sensor.cfa) for setting in settings.values()}
    require(len(kinds) == 1, f"bits and filters of the ISOs of {folder}", "the same", sorted(map(str, kinds)))
    sensors = [setting.sensor for setting in settings.values()]
    fits = gain_fits(list(isos), [s.gain for s in sensors], [s.sigma_d for s in sensors])
    return OwnCamera(settings=settings, fits=tuple(fits))


def _setting(folder: Path, notes: Path, window: int, maps: bool) -> MeasuredSetting:
    frames, largest, held = _held_out(read_frames(folder, window, notes))
    if frames.flat:
        sensor, found, assumed = *_measured(frames, folder, notes), dict[str, str]()
    else:
        found, assumed = None, _assumed(frames)
        sensor = _in_the_dark(frames, largest, assumed, notes)
    told = _maps(frames, sensor, folder) if maps else None
    sensor = sensor if told is None else replace(sensor, defects=None)  # the hot pixels are in the maps
    test = () if held is None else _test(sensor, largest, held)
    return MeasuredSetting(sensor=sensor, found=found, assumed=assumed, test=test, maps=told, profile=_profile(folder))


def _held_out(frames: Frames) -> tuple[Frames, Stack, Stack | None]:
    """Without every fourth frame of the largest dark stack; that stack without them; and these."""
    most = max(range(len(frames.dark)), key=lambda k: len(frames.dark[k].frames))
    stack = frames.dark[most]
    if len(stack.frames) < ENOUGH:
        return frames, stack, None
    kept = np.arange(len(stack.frames)) % HELD_OUT < HELD_OUT - 1
    rest = replace(stack, frames=stack.frames[kept])
    dark = [rest if k == most else other for k, other in enumerate(frames.dark)]
    return replace(frames, dark=dark), rest, replace(stack, frames=stack.frames[~kept])


def _measured(frames: Frames, folder: Path, notes: Path) -> tuple[Sensor, Characterisation]:
    """For a mosaic, the green pixels give everything except the colours."""
    if frames.cfa == "none":
        found, of_colour = characterise(frames.dark, frames.flat), {}
    else:
        place = frames.cfa.index("G")
        found = characterise(plane(frames.dark, place), plane(frames.flat, place))
        of_colour = colours(frames)
    for name in ("eta", "mu_e_sat"):
        if getattr(found, name) is None and name not in frames.camera:
            why = "give the photons of every flat stack" if name == "eta" else "add a flat stack beyond saturation"
            alone = "" if name == "eta" else "; inf where the converter saturates first"
            raise ValueError(
                f"{folder} does not determine {name}: {why}, or {name} under [camera] in frames.toml{alone}"
            )
    gain = frames.camera.get("gain")
    with reading(notes / "frames.toml", "correct it"):
        told = found.at_gain(gain) if isinstance(gain, (int, float)) and gain > 0 else found
        known = {name: frames.camera.get(name, getattr(told, name)) for name in ("eta", "mu_e_sat")}
        measured = asdict(told.sensor(bits=frames.bits, **known))
        return sensor_from_dict(measured | {"cfa": frames.cfa} | of_colour | frames.camera), found


def _assumed(frames: Frames) -> dict[str, str]:
    """Where fields come from that dark frames do not show and frames.toml does not give."""
    rules = {"gain": f"{RULE:g} DN/e- at ISO 100 and 14 bits, and proportional to both", "eta": "a usual sensor's",
             "mu_e_sat": "the converter saturates first"}  # fmt: skip
    return {name: why for name, why in rules.items() if name not in frames.camera}


def _in_the_dark(frames: Frames, stack: Stack, assumed: Mapping[str, str], notes: Path) -> Sensor:
    green = plane([stack], frames.cfa.index("G"))[0] if frames.cfa != "none" else stack
    gain = frames.camera.get("gain")
    if gain is None:
        require(frames.iso is not None, "the ISO of dark frames without flat frames", "known", None,
                "name the folder isoN, or give gain under [camera] in frames.toml")  # fmt: skip
        assert frames.iso is not None
        gain = RULE * frames.iso / 100 * 2.0 ** (frames.bits - 14)
    black = float(average(green).mean())
    fields = {"gain": gain, "eta": ASSUMED_QE, "bits": frames.bits, "black_level": black, "cfa": frames.cfa,
              "mu_e_sat": ((1 << frames.bits) - 1 - black) / gain,
              **({} if frames.cfa == "none" else {"rgb_response": DAYLIGHT})}  # fmt: skip
    with reading(notes / "frames.toml", "correct it"):
        drawn = DarkFrames(codes=stack.frames, sensor=sensor_from_dict(fields | frames.camera))
        camera = drawn.described
        left = drawn.noise / (len(stack.frames) - 1) / camera.gain**2  # of their noise, in their average; e-**2
        camera = replace(camera, sigma_d=(camera.sigma_d**2 + left) ** 0.5, dsnu=max(camera.dsnu**2 - left, 0.0) ** 0.5)
        return sensor_from_dict(asdict(camera) | frames.camera)


def _test(sensor: Sensor, stack: Stack, held: Stack) -> tuple[str, ...]:
    """Frames that were held out, dark frames that are drawn from the others, and the camera in numbers."""
    frames = DarkFrames(codes=stack.frames, sensor=sensor)
    shape, exposure = stack.frames.shape[1:], Exposure(time=stack.time)
    taken = {
        "held out": held.frames,
        "drawn": _without_light(frames.described, shape, exposure, len(held.frames), Measured(dark=frames)),
        "by numbers": _without_light(sensor, shape, exposure, len(held.frames), None),
    }
    rows = [f"{name:>17}" + "".join(f"{value:>18.5g}" for value in statistics(dn)) for name, dn in taken.items()]
    titles = ("mean", "variance", "variance of rows", "99.9 % quantile")
    return f"{'without light, DN':>17}" + "".join(f"{title:>18}" for title in titles), *rows


def _without_light(
    sensor: Sensor, shape: tuple[int, ...], exposure: Exposure, n: int, measured: Measured | None
) -> np.ndarray:
    light = np.zeros(shape)
    return np.stack([expose(light, sensor, exposure, seed=0, view=k, measured=measured).dn for k in range(n)])


def statistics(frames: np.ndarray) -> tuple[float, float, float, float]:
    """Mean, variance, variance of the means of rows, and 99.9 % quantile of frames [n,h,w]."""
    dn = frames.astype(np.float64)
    return (
        float(dn.mean()),
        float(dn.var((1, 2)).mean()),
        float(dn.mean(2).var(1).mean()),
        float(np.quantile(dn, 0.999)),
    )


def _maps(frames: Frames, sensor: Sensor, folder: Path) -> Measured:
    """Offset and response of every pixel, from the largest dark stack and the largest flat one below saturation.

    The dark stack nearest to the time of the flat one is taken off that: hot pixels have their own charge in both.
    """
    dark = max(frames.dark, key=lambda stack: len(stack.frames))
    below = [
        s for s in frames.flat if float(average(s).mean()) - sensor.black_level < 0.7 * sensor.capacity_e * sensor.gain
    ]
    flat = max(below, key=lambda stack: (len(stack.frames), float(average(stack).mean())), default=None)
    for kind, stack in (("dark", dark), *((("flat", flat),) if flat else ())):
        if len(stack.frames) < ENOUGH:
            raise ValueError(f"{folder} must hold a {kind} stack of {ENOUGH} frames or more for maps, below "
                             f"saturation and without those held out, got {len(stack.frames)}: take some dozens, or "
                             "leave out --maps")  # fmt: skip
    offset, response = np.zeros(dark.frames.shape[1:]), np.ones(dark.frames.shape[1:])
    cells = [(slice(None), slice(None))] if frames.cfa == "none" else [
        (slice(y, None, 2), slice(x, None, 2)) for y in (0, 1) for x in (0, 1)]  # fmt: skip
    for cell in cells:
        shade = replace(dark, frames=dark.frames[(slice(None), *cell)])
        left = temporal_variance(shade) / len(shade.frames)
        base = average(shade)
        offset[cell] = _pattern(base - base[_usual(base - np.median(base), left)].mean(), left) / sensor.gain
        if flat is not None:
            lit = replace(flat, frames=flat.frames[(slice(None), *cell)])
            near = min(frames.dark, key=lambda stack: (abs(stack.time - flat.time), -len(stack.frames)))
            shade = replace(near, frames=near.frames[(slice(None), *cell)])
            left = temporal_variance(shade) / len(shade.frames)
            signal = average(lit) - average(shade)
            smooth = parabola(signal.shape)
            even = (smooth @ np.linalg.lstsq(smooth, signal.ravel(), rcond=None)[0]).reshape(signal.shape)
            left += temporal_variance(lit) / len(lit.frames)
            response[cell] = np.maximum(1 + _pattern(signal / even - 1, left / float(even.mean()) ** 2), 0)
    return Measured(offset=offset.astype(np.float32), response=response.astype(np.float32), time=dark.time)


def _pattern(seen: np.ndarray, noise: float) -> np.ndarray:
    """A pattern of which so much variance is noise, with its own variance; pixels far off stay as they are."""
    usual = _usual(seen, noise)
    whole = float(np.square(seen[usual]).mean())
    share = max(whole - noise, 0.0) / whole if whole else 0.0
    return np.where(usual, share**0.5 * seen, seen)


def _usual(seen: np.ndarray, noise: float) -> np.ndarray:
    """Pixels that are not far off, where so much variance is noise."""
    away = np.abs(seen)
    return np.asarray(away <= HOT * max(1.4826 * float(np.median(away)), noise**0.5))


def _profile(folder: Path) -> float | None:
    """The gain of green that a DNG among the frames states, DN/e-: variance = S x + O of x from 0 to 1."""
    for place in stacks_in(folder, "flat") + stacks_in(folder, "dark"):
        for path in listed(place)[:1]:
            tags: dict[int, list[float]] = {}
            for found in directories(path) if path.suffix.lower() == ".dng" else ():
                tags |= {tag: found.numbers(tag) for tag in (NOISE_PROFILE, BLACK, WHITE) if found.numbers(tag)}
            if len(tags.get(NOISE_PROFILE, ())) >= 2 and tags.get(WHITE):
                stated = tags[NOISE_PROFILE]
                return float(stated[2 if len(stated) >= 6 else 0] * (tags[WHITE][0] - np.mean(tags.get(BLACK, [0]))))
    return None
