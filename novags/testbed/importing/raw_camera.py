"""The camera that a set of raw files was taken with, from their metadata and, if known, its model."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from novags.testbed.folders.photographs.raw_colors import ALIKE
from novags.testbed.folders.photographs.raw_files import RawFormat, read_digital_numbers, read_format
from sensor_model.isp import Demosaic, develop_linear
from sensor_model.params import CFAS, Cfa, Sensor

BLACK_SHARE, WHITE_SHARE = 0.01, 0.1  # of the range of codes by which a camera's model may differ from its files


@dataclass(frozen=True, kw_only=True)
class RawCamera:
    """How the raw files of an import become linear pictures.

    Attributes:
        format: The metadata of the first file; its white balance and colour matrix count for all.
        sensor: Levels, filters and balance as the development uses them; more than that only if `known`.
        known: Whether `sensor` is a camera model that was given.
        demosaic: How the colour filter array is interpolated.
    """

    format: RawFormat
    sensor: Sensor
    known: bool
    demosaic: Demosaic

    def codes(self, file: Path) -> np.ndarray:
        """The codes with one black level for all pixels, uint16 [h,w] or [h,w,3].

        Raises:
            ValueError: If the file cannot be read, or is not of the camera that the first one is of.
        """
        stated = read_format(file)
        for what, here, first in (
            ("size", stated.shape, self.format.shape),
            ("colour filter array", stated.cfa, self.format.cfa),
            ("white level", stated.white, self.format.white),
        ):
            if here != first:
                raise ValueError(f"{file} has the {what} {here}, the first raw file {first}: import one camera's files")
        dn = read_digital_numbers(file)
        blacks = np.array(stated.black) if stated.levels is None else stated.levels
        shift = np.round(common_black(self.format) - blacks).astype(np.int32)
        if not shift.any():
            return dn
        if dn.ndim == 2 and stated.levels is None:
            rows, columns = np.indices(dn.shape) % 2
            shift = shift[2 * rows + columns]
        return np.clip(dn.astype(np.int32) + shift, 0, 65535).astype(np.uint16)

    def develop(self, dn: np.ndarray) -> np.ndarray:
        """White-balanced linear RGB of these codes, float32 [h,w,3]; 0 = black, 1 = white, noise below black kept."""
        matrix = self.format.color_matrix
        return develop_linear(dn, self.sensor, demosaic=self.demosaic, color_matrix=matrix)

    def cut_sensor(self, top: int, left: int) -> Sensor:
        """The camera of the same codes without so many rows and columns, which moves the colour filter array."""
        return replace(self.sensor, cfa=moved(self.sensor.cfa, top, left))


def raw_camera(file: Path, given: Sensor | None, demosaic: Demosaic) -> RawCamera:
    """The camera of a raw file.

    Args:
        file: The first raw file.
        given: The model of the camera, or None.
        demosaic: How the colour filter array will be interpolated.

    Raises:
        ValueError: If the file cannot be read, or states other levels or filters than the model; a slightly other black
            level is taken from the file.
    """
    stated = read_format(file)
    black = common_black(stated)
    if given is None:
        sensor = Sensor(
            gain=1.0, eta=1.0, mu_e_sat=max(1.0, stated.white - black), black_level=black,
            bits=max(8, int(stated.white).bit_length()), cfa=stated.cfa, rgb_response=stated.response,
        )  # fmt: skip
        return RawCamera(format=stated, sensor=sensor, known=False, demosaic=demosaic)
    _check_alike(file, stated, black, given)
    alike = np.allclose(given.rgb_response, stated.response, rtol=ALIKE)
    response = given.rgb_response if alike else stated.response
    # The black level of a camera differs a little from one to the next, and in the dark that is much of the light.
    sensor = replace(given, cfa=stated.cfa, rgb_response=response, black_level=black)
    return RawCamera(format=stated, sensor=sensor, known=True, demosaic=demosaic)


def _check_alike(file: Path, stated: RawFormat, black: float, given: Sensor) -> None:
    """Refuse a camera model that is not of the camera that took the file."""
    span = stated.white - black
    for what, here, there, slack in (
        ("black level", black, given.black_level, max(1.0, BLACK_SHARE * span)),
        ("white level", stated.white, np.floor(given.white_dn), WHITE_SHARE * span),
    ):
        if abs(here - there) > slack:
            raise ValueError(
                f"{file} states the {what} {here:g} DN, --sensor {there:g} DN: give the sensor that took it, or none"
            )
    if (stated.cfa is None) != (given.cfa is None):
        kind = ("three full channels", "a colour filter array")
        raise ValueError(
            f"{file} has {kind[stated.cfa is not None]}, --sensor {kind[given.cfa is not None]}: give the sensor that "
            "took it, or none"
        )


def common_black(stated: RawFormat) -> float:
    """One black level for all pixels, DN: theirs, or a whole one amid them."""
    black = set(stated.black)
    return black.pop() if len(black) == 1 else float(round(sum(stated.black) / len(stated.black)))


def moved(cfa: Cfa | None, top: int, left: int) -> Cfa | None:
    """The pattern after so many rows and columns are cut off."""
    if cfa is None:
        return None
    cell = np.roll(np.array(list(cfa)).reshape(2, 2), (-top, -left), (0, 1))
    return next(known for known in CFAS if known == "".join(cell.ravel()))
