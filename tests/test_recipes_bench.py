"""Networks trained on recipes of data sets, and their rivals: both see the same frames and have the same score."""

import csv
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
import torch

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
SIZE, DISTANCE = 64, 2.0  # of a wall


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from recipes_bench import bench_recipes

    return bench_recipes


def wall(folder: Path) -> list[dict[str, str]]:
    """Five views of a painted wall at one depth, from places beside each other: rows of the index, two splits."""
    (folder / "training").mkdir()
    draw = np.random.default_rng(0)
    paint = cv2.GaussianBlur(draw.uniform(0, 1, (256, 256)).astype(np.float32), (0, 0), 2)
    paint = 0.05 + (paint - paint.min()) / np.ptp(paint)
    K = np.array([[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1]], np.float32)
    rows = []
    for i, x in enumerate(np.linspace(-0.3, 0.3, 5)):
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[0, 3] = -x
        shift = np.array([[1, 0, 96 + x * SIZE / DISTANCE], [0, 1, 96]], np.float32)
        light = cv2.warpAffine(paint, shift, (SIZE, SIZE), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        dark = np.stack([np.stack([4096 + scale * light] * 3) for scale in (2000, 20000)]).astype(np.uint16)
        depth = np.full((SIZE, SIZE), DISTANCE, np.float32)
        depth[:4] = np.inf
        np.savez(folder / f"training/{i}.npz", dark=dark, black=np.float32(4096), viewmat=viewmat, K=K, depth=depth)
        others = " ".join(str(j) for j in range(5) if j != i)
        rows.append({"file": f"training/{i}.npz", "view": str(i), "scene": "wall", "context": others,
                     "electrons": "5 1000", "split": "train" if i else "test"})  # fmt: skip
    return rows


def test_both_find_a_wall_from_the_costs_of_one_plane_sweep(bench: ModuleType, tmp_path: Path) -> None:
    """The network, before it has learnt anything, is the costs themselves."""
    from recipes_bench import depth

    rows = wall(tmp_path)
    (volume,) = depth.volumes(rows[2], tmp_path, 100.0)
    assert (volume.view, volume.electrons) == ("2", "5")  # 1000 electrons are not dark
    known = volume.place.isfinite()
    assert not known[:4].any()
    assert known[4:].all()
    assert volume.error(volume.place.nan_to_num()) == pytest.approx(0, abs=1e-3)
    far = volume.place.nan_to_num() + 1
    step, inverse = float(volume.inverse[1] - volume.inverse[0]), 1 / DISTANCE
    assert volume.error(far) == pytest.approx(100 * (1 - inverse / (inverse + step)), rel=1e-3)
    found = {who: score for _, _, who, score in depth.scores(depth.Depth(), rows[2:3], tmp_path)}
    assert set(found) == {"network", depth.RIVAL}
    assert max(found.values()) < 2


def test_the_network_of_depth_learns_where_the_wall_is(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recipes_bench import depth, unet

    monkeypatch.setattr(depth, "BATCH", 1)
    monkeypatch.setattr(unet, "WARM_UP", 1)
    rows = wall(tmp_path)
    torch.manual_seed(0)
    before = depth.Depth()
    network = depth.train(rows, tmp_path, 30, 0, tmp_path / "kept.safetensors")
    (volume,) = depth.volumes(rows[2], tmp_path, 100.0)
    place = volume.place[32, 32]

    def likelihood(network: torch.nn.Module) -> float:
        with torch.no_grad():
            found = network(volume.cost[None].float(), volume.grey[None])[0, :, 32, 32].exp()
        return float(found[max(0, int(place) - 2) : int(place) + 4].sum())

    assert 1 - likelihood(network) < 0.8 * (1 - likelihood(before))
    again = depth.train(rows, tmp_path, 30, 0, tmp_path / "kept.safetensors")
    assert likelihood(again) == likelihood(network)


def raw_frames(folder: Path) -> list[dict[str, str]]:
    """Frames of a flat grey of 20 electrons with shot and read noise, and bright ones."""
    (folder / "training").mkdir()
    draw, rows = np.random.default_rng(1), []
    for i, electrons in enumerate((20.0, 20.0, 1000.0)):
        clean = np.full((4, 48, 48), 100 + 2 * electrons, np.float32)
        noisy = 100 + 2 * (draw.poisson(electrons, clean.shape) + draw.normal(0, 2, clean.shape))
        np.savez(folder / f"training/{i}.npz", noisy=noisy.round().astype(np.uint16), clean=clean,
                 black=np.float32(100), gain=np.float32(2), sigma_d=np.float32(2))  # fmt: skip
        rows.append({"file": f"training/{i}.npz", "view": str(i), "scene": "grey", "electrons": f"{electrons:g}"})
    return rows


def test_raw_frames_are_compared_in_electrons_with_the_noisy_one_as_nought(bench: ModuleType, tmp_path: Path) -> None:
    from recipes_bench import raw
    from recipes_bench.unet import UNet

    rows = raw_frames(tmp_path)
    noisy, clean, read = raw.frame(tmp_path / "training/0.npz")
    assert float(clean.mean()) == 20
    assert float(read) == pytest.approx(4 + 1 / 48)
    assert float((noisy - clean).square().mean()) == pytest.approx(20 + 4 + 1 / 48, rel=0.1)  # 9216 pixels: 6 errors
    found = [(view, who, score) for _, view, who, score in raw.scores(UNet(4, 4), rows, tmp_path)]
    assert [found[k][:2] for k in range(4)] == [(view, who) for view in "01" for who in ("network", raw.RIVAL)]
    assert len(found) == 4  # the frame of 1000 electrons is not dark
    for _, who, score in found:
        # a network that has learnt nothing leaves the frame as it is; flat grey is what non-local means are best at
        assert score == pytest.approx(0, abs=1e-3) if who == "network" else score > 8


def test_the_rival_has_the_strength_that_is_best_by_the_truth(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recipes_bench import raw
    from recipes_bench.unet import UNet

    rows = raw_frames(tmp_path)[:1]
    tried = (lambda strength: lambda planes: strength * planes, (0.0, 1.0, 3.0))
    monkeypatch.setattr(raw, "FILTERS", {raw.RIVAL: tried})
    _, (*_, score) = raw.scores(UNet(4, 4), rows, tmp_path)
    assert score == pytest.approx(0, abs=1)  # the frame itself, but for its mean


def test_crops_are_turned_and_flipped_in_all_eight_ways(bench: ModuleType) -> None:
    from recipes_bench.unet import turned

    draw = torch.Generator().manual_seed(0)
    crop = torch.arange(4.0).reshape(2, 2)
    assert len({tuple(turned(crop, draw).flatten().tolist()) for _ in range(80)}) == 8


def test_a_network_of_raw_frames_learns(bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from recipes_bench import raw, unet

    monkeypatch.setattr(raw, "CROP", 16)
    monkeypatch.setattr(unet, "WARM_UP", 1)
    rows = raw_frames(tmp_path)
    torch.manual_seed(0)
    network = raw.train(rows, tmp_path, 150, 0, tmp_path / "kept.safetensors")
    gains = [score for _, _, who, score in raw.scores(network, rows, tmp_path) if who == "network"]
    assert min(gains) > 2


def test_dark_exposures_are_measured_and_restored_through_one_curve(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recipes_bench import poses

    draw, rows = np.random.default_rng(2), []
    light = cv2.GaussianBlur(draw.uniform(0, 1, (64, 64, 3)).astype(np.float32), (0, 0), 2).transpose(2, 0, 1)
    for i in range(3):
        dark = np.stack([512 + scale * light for scale in (2.0, 20.0)])
        np.savez(tmp_path / f"{i}.npz", dark=dark.astype(np.float32), bright=(512 + 500 * light).astype(np.float32),
                 black=np.float32(512), electrons=np.float32([5, 20]), bright_electrons=np.float32(1000),
                 viewmat=np.eye(4, dtype=np.float32), K=np.eye(3, dtype=np.float32))  # fmt: skip
        rows.append({"file": f"{i}.npz", "view": str(i), "scene": "s" if i < 2 else "t"})
    pictures, electrons, _ = poses.exposures(tmp_path / "0.npz")
    assert electrons.tolist() == [5, 20, 1000]
    torch.testing.assert_close(pictures[0], pictures[-1], atol=1e-4, rtol=1e-3)  # without noise they are one picture
    assert float(poses.shown(torch.tensor(4.0))) == 1  # of white in the file: four times the mean
    torch.testing.assert_close(poses.shown(torch.tensor(-0.1)), -poses.shown(torch.tensor(0.1)))
    looked: list[Any] = []

    def found_by_poses(codes: np.ndarray, true: np.ndarray, seed: int, **how: str) -> dict[str, float]:
        looked.append((codes.shape, true.shape, how))
        return {"rotation_auc5": len(looked) / 10}

    monkeypatch.setattr(poses, "found_by_poses", found_by_poses)
    network = poses.train(rows, tmp_path, 1, 0, tmp_path / "kept.safetensors")
    found = [(row["scene"], row["electrons"], who) for row, _, who, _ in poses.scores(network, rows, tmp_path)]
    lights = ("5", "20", "1000")
    assert found == [(s, light, who) for s in "st" for light in lights for who in ("network", poses.RIVAL)]
    assert looked[0] == looked[1] == ((2, 64, 64, 3), (2, 4, 4), {"pictures": "raw", "mapper": "global"})


def test_the_table_pairs_scenes_light_and_views_and_leaves_bright_pictures_out(bench: ModuleType) -> None:
    scores = [
        {"recipe": "denoiser", "scene": scene, "electrons": light, "view": "0", "who": who, "score": f"{score}"}
        for scene, light, ours, rival in (("a", "5", 3, 1), ("b", "5", 13, 5), ("a", "20", 2, 2), ("b", "20", 7, 5),
                                          ("a", "1000", 0, 99), ("b", "1000", 0, 99))
        for who, score in (("network", ours), ("non-local means", rival))
    ]  # fmt: skip
    rows = list(csv.DictReader(bench.table(scores).splitlines()))
    assert [row["electrons"] for row in rows] == ["5", "20", "5 20"]
    assert [row["network - rival"] for row in rows] == ["+5 ± 3", "+1 ± 1", "+3 ± 2"]
    assert [row["errors"] for row in rows] == ["1.7", "1.0", "1.5"]
    assert (rows[2]["network"], rows[2]["rival"], rows[2]["scenes"]) == ("6.25", "3.25", "2")


def test_trained_networks_and_scores_are_kept(
    bench: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    index = tmp_path / "data/training/feedforward/index.csv"
    index.parent.mkdir(parents=True)
    (tmp_path / "data/wall").mkdir()
    rows = wall(tmp_path / "data/wall")
    with index.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(row | {"file": f"wall/{row['file']}"} for row in rows)
    found = bench.measured(bench.RECIPES["feedforward"], tmp_path / "data", tmp_path, 2, 0)
    assert [row["who"] for row in found] == ["network", "semi-global matching"]
    assert (tmp_path / "feedforward-2-0.safetensors").exists()
    monkeypatch.setattr(bench.RECIPES["feedforward"], "train", None)
    assert bench.measured(bench.RECIPES["feedforward"], tmp_path / "data", tmp_path, 2, 0) == found
