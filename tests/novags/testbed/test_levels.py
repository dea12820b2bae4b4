"""Claims about the light levels: what their names stand for, everywhere alike, and that the paper's words fit them."""

from pathlib import Path

import numpy as np
import pytest

from novags.commands.answers.catalogue import listing
from novags.testbed.stages.capturing import expose_view
from novags.testbed.study.cells.grid import read_study
from novags.testbed.study.cells.levels import LEVELS, level_named
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testing.making import make_capture
from sensor_model import (
    PRESETS,
    Exposure,
    clean_response,
    develop,
    develop_linear,
    from_linear16,
    photons_for_electrons,
)

NAMES = ("lom", "llnerf", "llrs", "mvtv")


def seen(name: str) -> tuple[np.ndarray, float]:
    """The 8-bit values of a scene of a wide range at a level, and the SNR of its linear picture, dB."""
    level, rng = LEVELS[name], np.random.default_rng(0)
    sensor = PRESETS[level.sensor]
    light = rng.lognormal(0.0, 1.0, (96, 96, 1)) * rng.uniform(0.7, 1.0, 3)
    how = {"electrons": level.electrons, "mean_green": float(light[..., 1].mean())}
    developed = develop(expose_view(light, sensor, Exposure(time=1 / 30), seed=0, view=0, **how), sensor)
    clean = clean_response(photons_for_electrons(light, sensor=sensor, **how), sensor, Exposure(time=1 / 30))
    linear, true = from_linear16(developed.linear16), develop_linear(clean, sensor).astype(np.float64)
    return developed.srgb8, float(10 * np.log10((true**2).mean() / ((linear - true) ** 2).mean()))


def test_the_levels_are_ordered_as_the_paper_describes_its_data_sets() -> None:
    """Expectation: its words: noise added in LLNeRF, LLRS near zero, MVTV dark and wide."""
    codes, snr = zip(*(seen(f"{name}-3chip") for name in NAMES), strict=True)
    mean = [picture.mean() for picture in codes]
    assert mean[1] == pytest.approx(mean[0], rel=0.25)  # llnerf is lom with noise added
    assert snr[0] > snr[1] + 8
    assert mean[2] < mean[1] / 5  # llrs is concentrated near zero ...
    assert snr[2] < 5  # ... with noise as strong as the signal
    assert (codes[2] == 0).mean() > 0.2
    assert np.quantile(codes[3], 0.75) <= 4  # 8 bits show next to nothing of mvtv
    assert [LEVELS[name].pictures for name in NAMES] == ["8bit", "8bit", "8bit", "16bit"]
    stops = {name: np.log2(PRESETS[LEVELS[name].sensor].capacity_e / PRESETS[LEVELS[name].sensor].sigma_d)
             for name in NAMES}  # fmt: skip
    assert max(stops, key=lambda name: stops[name]) == "mvtv"


@pytest.mark.parametrize("name", NAMES)
def test_every_level_has_a_twin_without_demosaicing(name: str) -> None:
    level, twin = level_named(name), level_named(f"{name}-3chip")
    assert (PRESETS[level.sensor].cfa, PRESETS[twin.sensor].cfa) == ("RGGB", None)
    assert level.settings() | {"sensor": twin.sensor} == twin.settings()


def test_a_level_sets_camera_light_and_pictures_and_what_is_given_by_itself_wins() -> None:
    preset = adapted(EXPERIMENTS["demo"], level="mvtv", methods=("naive",))
    assert (preset.capture.sensor, preset.capture.electrons) == ("d850-iso400", 5.0)
    assert preset.reconstruct("naive").config.pictures == "16bit"
    other = adapted(
        EXPERIMENTS["demo"], level="mvtv", sensor="ideal", electrons=7.0, pictures="8bit", methods=("naive",)
    )
    assert (other.capture.sensor, other.capture.electrons) == ("ideal", 7.0)
    assert other.reconstruct("naive").config.pictures == "8bit"
    with pytest.raises(ValueError, match="unknown level 'llner'; did you mean 'llnerf'"):
        adapted(EXPERIMENTS["demo"], level="llner")


def test_a_study_takes_levels_as_an_axis_and_refuses_a_second_word_on_the_light(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text('[grid]\nlevel = ["lom", "mvtv-3chip"]\nmethod = ["naive"]\n')
    cells = read_study(file).cells
    found = [(c.values["level"], c.preset.capture.sensor, c.preset.capture.electrons) for c in cells]
    assert found == [("lom", "a7s2-iso1600", 150.0), ("mvtv-3chip", "d850-iso400-3chip", 5.0)]
    assert [c.preset.reconstruct("naive").config.pictures for c in cells] == ["8bit", "16bit"]
    for more, message in (
        ("electrons = [5]\n", r"electrons is set by \[grid\] level too"),
        ('[override]\nsensor = "ideal"\n', r"sensor is set by \[grid\] level too"),
    ):
        file.write_text('[grid]\nlevel = ["lom"]\n' + more)
        with pytest.raises(ValueError, match=message):
            read_study(file)
    file.write_text('[grid]\nlevel = ["dark"]\n')
    with pytest.raises(ValueError, match=r"\[grid\] level: unknown level 'dark'"):
        read_study(file)


def test_a_capture_for_a_test_has_one_number_of_electrons(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="level sets electrons, which is given too"):
        make_capture(tmp_path, "cornell", 20.0, {"level": "lom"})


def test_the_list_shows_every_level_with_its_camera() -> None:
    text = listing("levels")
    for name, level in LEVELS.items():
        assert f"\n  {name} " in text
        assert level.sensor in text
