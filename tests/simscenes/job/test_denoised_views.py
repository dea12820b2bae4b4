"""`denoise`: training views lose their noise, and the truth passes no biased filter."""

from pathlib import Path

import numpy as np
import pytest

from simscenes import default_rig, render_set
from simscenes.render import smooth
from simscenes.sets.multiview import MultiviewSet
from simscenes.sets.pictures.exr import read_exr

HELD_OUT = (0, 8)


def of(folder: Path, spp: int = 8, *, denoise: bool = False, seed: int = 0) -> MultiviewSet:
    rig = default_rig("studio", 9, 48, 48)
    return render_set("studio", rig, folder, spp=spp, plan="rgb", denoise=denoise, seed=seed)


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, MultiviewSet]:
    root = tmp_path_factory.mktemp("sets")
    return {
        "plain": of(root / "plain"),
        "smooth": of(root / "smooth", denoise=True),
        "true": of(root / "true", 128, seed=1),
    }  # fmt: skip


def test_held_out_views_and_the_noise_that_is_recorded_stay_bit_for_bit(sets: dict[str, MultiviewSet]) -> None:
    for i in range(9):
        plain, smoothed = (read_exr(sets[name].path / "gt" / f"{i:04d}.exr")[0] for name in ("plain", "smooth"))
        changed = {name for name in plain if not np.array_equal(plain[name], smoothed[name])}
        assert changed == (set() if i in HELD_OUT else {"R", "G", "B"})


def test_smoothed_views_are_nearer_to_many_samples(sets: dict[str, MultiviewSet]) -> None:
    """Of 8 samples a pixel more than half of the squared error goes; the mean light stays within 2 %."""
    for i in set(range(9)) - set(HELD_OUT):
        truth = sets["true"].radiance(i)
        before, after = (((sets[k].radiance(i) - truth) ** 2).mean() for k in ("plain", "smooth"))
        assert after < 0.5 * before
        assert sets["smooth"].radiance(i).mean() == pytest.approx(sets["plain"].radiance(i).mean(), rel=0.02)
        assert sets["smooth"].radiance(i).min() >= 0


def test_a_pixel_moves_by_at_most_two_of_its_standard_errors(sets: dict[str, MultiviewSet]) -> None:
    """The edges of a lamp in view have hardly any noise, and dominate the error of a picture."""
    for i in set(range(9)) - set(HELD_OUT):
        variance = sets["plain"].variance(i)
        assert variance is not None
        plain, smoothed = (sets[name].radiance(i) for name in ("plain", "smooth"))
        moved = np.abs(smoothed - plain)
        assert (moved <= 2 * np.sqrt(variance) + 1e-6 * plain).all()
        assert (moved > 1.9 * np.sqrt(variance)).any()


def test_a_folder_of_rendered_views_is_no_folder_of_smoothed_ones(tmp_path: Path) -> None:
    plain = of(tmp_path)
    before = [plain.radiance(i) for i in range(9)]
    again = of(tmp_path, denoise=True)
    assert again.meta["denoise"] is True
    assert "denoise" not in plain.meta
    assert [np.array_equal(again.radiance(i), before[i]) for i in range(9)] == [i in HELD_OUT for i in range(9)]


def test_a_missing_package_is_named_before_anything_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(smooth, "PACKAGE", "no_such_denoiser")
    with pytest.raises(ValueError, match=r"no_such_denoiser, is not installed; pip install 'novags\[denoise\]'"):
        of(tmp_path / "set", denoise=True)
    assert not (tmp_path / "set" / "gt").exists()
