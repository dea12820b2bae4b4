"""Claims about the colours of spectra, for the eye and for cameras."""

import numpy as np
import pytest

from simscenes.camera import WAVELENGTHS, camera_color, daylight, srgb_curves

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:colour")


def test_daylight_is_white_and_a_flat_spectrum_has_luminance_one() -> None:
    curves = srgb_curves()
    white = daylight() @ curves
    np.testing.assert_allclose(white / white[1], 1, atol=1e-3)
    assert np.ones(len(WAVELENGTHS)) @ curves @ [0.2126, 0.7152, 0.0722] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(("wavelength", "channel"), [(450.0, 2), (535.0, 1), (620.0, 0)])
def test_light_of_one_wavelength_has_the_colour_that_everybody_sees(wavelength: float, channel: int) -> None:
    seen = srgb_curves()[WAVELENGTHS == wavelength][0]
    assert seen.argmax() == channel
    assert (np.delete(seen, channel) < 0.4 * seen[channel]).all()


def test_the_matrix_of_a_camera_stands_in_for_its_filters() -> None:
    """For grey and for smooth reflectances of other colours than the chart's, in daylight."""
    found = camera_color("Nikon 5100 (NPL)")
    step = 1 / (1 + np.exp((550 - WAVELENGTHS) / 40))
    spectra = np.stack([np.ones_like(step), 0.2 + 0.6 * step, 0.8 - 0.6 * step, 0.5 + 0.1 * step]) * daylight()
    exact = np.trapezoid(spectra[:, :, None] * found.curves, WAVELENGTHS, axis=1) / found.green_integral
    by_matrix = spectra @ srgb_curves() @ found.matrix.T
    np.testing.assert_allclose(by_matrix, exact, rtol=0.06)
    assert 0.001 < found.matrix_error < 0.05
    assert np.abs(found.matrix - found.matrix.T).max() > 0.05


def test_no_matrix_is_closer_to_a_camera_on_all_patches_of_the_chart_and_white() -> None:
    """At the least squares, what is left of the error has nothing in common with the colours that are seen."""
    import colour

    found = camera_color("Nikon 5100 (NPL)")
    chart = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    spectra = np.array([[chart[name][w] for w in WAVELENGTHS] for name in chart] + [np.ones(len(WAVELENGTHS))])
    light = spectra * daylight()
    seen, exact = light @ srgb_curves(), light @ found.curves / found.curves[:, 1].sum()
    left = exact - seen @ found.matrix.T
    assert len(spectra) == 25
    assert np.abs(left).max() > 1e-3 * exact.max()
    np.testing.assert_allclose(seen.T @ left / (np.linalg.norm(seen) * np.linalg.norm(exact)), 0, atol=1e-9)
