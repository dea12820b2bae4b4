import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from novags.cameras import SOURCES, check_cameras, parse_cameras, spell_cameras
from novags.cameras.estimate import as_estimate
from novags.cameras.estimating import estimate_cameras
from novags.cameras.sources.dust3r import Dust3rConfig
from novags.cameras.sources.hloc import HlocConfig
from novags.cameras.sources.known import KnownConfig
from novags.cameras.sources.map_anything import MapAnythingConfig
from novags.cameras.sources.mast3r import Mast3rConfig
from novags.cameras.sources.sfm import SfmConfig
from novags.cameras.sources.vggsfm import VggsfmConfig
from novags.cameras.sources.vggt import VggtConfig
from simscenes.rigs import Rig

paths = st.sampled_from([Path("w.pt"), Path("a b/c=d:e.pt")])
configs = st.one_of(
    st.builds(KnownConfig, **{f.name: st.floats(0, 90) for f in fields(KnownConfig)}),
    st.builds(
        SfmConfig,
        pictures=st.sampled_from(["raw", "enhanced", "denoised"]),
        mapper=st.sampled_from(["incremental", "global"]),
        max_features=st.integers(8, 10_000),
        peak_threshold=st.floats(1e-9, 1),
        first_octave=st.sampled_from([-1, 0, 1]),
    ),
    st.builds(VggtConfig, checkpoint=paths, drop_percent=st.floats(0, 99)),
    st.builds(MapAnythingConfig, checkpoint=paths, known=st.sampled_from(["nothing", "lenses", "cameras"])),
    st.builds(Dust3rConfig, checkpoint=paths, pairs=st.sampled_from(["complete", "swin-5"])),
    st.builds(Mast3rConfig, checkpoint=paths, shared_lens=st.booleans(), iterations=st.integers(1, 900)),
    st.builds(VggsfmConfig, checkpoint=paths, home=paths, python=st.sampled_from(["python", "/opt/x=y/bin/python"])),
    st.builds(HlocConfig, features=st.sampled_from(["disk", "sift"]), matcher=st.sampled_from(["auto", "NN-ratio"])),
)


@pytest.mark.parametrize(
    ("text", "config"),
    [
        ("known", KnownConfig()),
        ("known:", KnownConfig()),
        ("known:rotation_deg=1,translation=0.01", KnownConfig(rotation_deg=1.0, translation=0.01)),
        (" known : depth_error = 1e-2 ", KnownConfig(depth_error=0.01)),
        ("sfm", SfmConfig()),
        ("sfm:pictures=enhanced,mapper=global", SfmConfig(pictures="enhanced", mapper="global")),
        ("sfm:max_features=500,first_octave=-1", SfmConfig(max_features=500)),
        (
            "vggt:checkpoint=some/where.pt,drop_percent=5",
            VggtConfig(checkpoint=Path("some/where.pt"), drop_percent=5.0),
        ),
        ("dust3r:checkpoint=w.pth,pairs=swin-5", Dust3rConfig(checkpoint=Path("w.pth"), pairs="swin-5")),
        (
            "mast3r:checkpoint=w.pth,pictures=enhanced,shared_lens=true",
            Mast3rConfig(checkpoint=Path("w.pth"), pictures="enhanced", shared_lens=True),
        ),
        (
            "vggsfm:home=clone,checkpoint=w.bin,python=/envs/vggsfm/bin/python",
            VggsfmConfig(home=Path("clone"), checkpoint=Path("w.bin"), python="/envs/vggsfm/bin/python"),
        ),
        ("hloc", HlocConfig()),
        (
            "hloc:features=superpoint_aachen,matcher=superpoint+lightglue",
            HlocConfig(features="superpoint_aachen", matcher="superpoint+lightglue"),
        ),
    ],
)
def test_sources_are_spelled_in_one_word(text, config):
    assert parse_cameras(text) == config


@settings(derandomize=True, deadline=None)
@given(config=configs)
def test_what_is_spelled_is_parsed_back(config):
    assert parse_cameras(spell_cameras(config)) == config


def test_defaults_are_not_spelled():
    assert spell_cameras(KnownConfig()) == "known"
    assert spell_cameras(SfmConfig(mapper="global")) == "sfm:mapper=global"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("knwn", r"unknown cameras 'knwn' \(did you mean known\?\); available: known, sfm, hloc, vggt, dust3r, mast3r"),
        ("sfm:maper=global", r"cameras sfm has no setting 'maper' \(did you mean mapper\?\); it has pictures, mapper"),
        ("known:translation", "cameras known: write translation=VALUE"),
        ("known:translation=", "cameras known: write translation=VALUE"),
        ("known:translation=1,translation=2", "translation is given twice"),
        ("known:translation=far", "translation must be a number, got 'far'"),
        ("sfm:max_features=1.5", "max_features must be a whole number, got '1.5'"),
        ("sfm:mapper=globl", r"mapper must be one of incremental, global, got 'globl' \(did you mean global\?\)"),
        ("known:rotation_deg=-1", "rotation_deg of known cameras must be finite and >= 0"),
        ("vggt", "cameras vggt needs checkpoint: write vggt:checkpoint=VALUE"),
        ("dust3r", "cameras dust3r needs checkpoint: write dust3r:checkpoint=VALUE"),
        ("mast3r:pairs=complete", "cameras mast3r needs checkpoint: write mast3r:checkpoint=VALUE"),
        ("vggsfm:checkpoint=w.bin", "cameras vggsfm needs home: write vggsfm:home=VALUE"),
    ],
)
def test_what_cannot_be_read_says_why(text, message):
    with pytest.raises(ValueError, match=message):
        parse_cameras(text)


def test_every_source_has_a_line_and_a_configuration_of_its_own():
    assert [*SOURCES][:7] == ["known", "sfm", "hloc", "vggt", "dust3r", "mast3r", "vggsfm"]  # ours; others follow
    assert len({source.config for source in SOURCES.values()}) == len(SOURCES)
    assert all(0 < len(source.description) < 90 and "\n" not in source.description for source in SOURCES.values())


TABLE = """
import sys
from novags.cameras import SOURCES, parse_cameras, source_of, spell_cameras

def loaded():
    return [name for name in SOURCES if SOURCES.module_of(name) in sys.modules]

assert "sfm" in SOURCES and len(list(SOURCES)) >= 7 and loaded() == [], loaded()
config = parse_cameras("known:rotation_deg=1")
assert spell_cameras(config) == "known:rotation_deg=1.0" and source_of(config).check(config) is None
assert loaded() == ["known"], loaded()
assert len(dict(SOURCES)) >= 7 and loaded() == list(SOURCES), loaded()
print([name for name in ("torch", "numba", "pycolmap", "mitsuba") if name in sys.modules])
"""


def test_a_row_is_loaded_when_it_is_asked_for_and_none_loads_what_computes():
    done = subprocess.run([sys.executable, "-c", TABLE], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("[]\n", "")


def test_sources_are_checked_before_they_are_used(monkeypatch):
    import pycolmap

    check_cameras(KnownConfig())
    check_cameras(SfmConfig(mapper="global"))
    nowhere = Path("nowhere.pt")
    for config, needed in (
        (VggtConfig(checkpoint=nowhere), "package vggt"),
        (Dust3rConfig(checkpoint=nowhere), "package dust3r"),
        (Mast3rConfig(checkpoint=nowhere), "package mast3r"),
        (VggsfmConfig(checkpoint=nowhere, home=nowhere), "program VGGSfM"),
        (MapAnythingConfig(checkpoint=nowhere), "package mapanything"),
        (HlocConfig(), "package hloc"),
    ):
        with pytest.raises(ValueError, match=f"need the {needed}"):
            check_cameras(config)
    monkeypatch.delattr(pycolmap, "global_mapping")
    check_cameras(SfmConfig())
    with pytest.raises(ValueError, match="no global mapper"):
        check_cameras(SfmConfig(mapper="global"))


def test_each_configuration_runs_its_source_on_the_views_that_are_asked_for(monkeypatch):
    calls = []
    for name, source in SOURCES.items():
        record = replace(source, estimate=lambda *a, name=name, **k: calls.append((name, a, k)))
        monkeypatch.setitem(SOURCES, name, record)
    Ks = np.stack([np.diag([focal, focal, 1.0]) for focal in range(1, 6)])
    multiview = SimpleNamespace(rig=Rig(viewmats=np.tile(np.eye(4), (5, 1, 1)), Ks=Ks, width=2, height=2))
    dark = torch.tensor([0.0, 1 / 255, 0.5, 1.0]).reshape(1, 2, 2, 1).repeat(2, 1, 1, 3)
    shared, file = {"n_points": 7, "seed": 3}, Path("w.pt")
    networks = VggtConfig(checkpoint=file), Dust3rConfig(checkpoint=file), Mast3rConfig(checkpoint=file)
    configs = KnownConfig(), SfmConfig(), HlocConfig(), *networks, VggsfmConfig(checkpoint=file, home=file)
    for config in configs:
        estimate_cameras(config, multiview, [1, 4], dark, device="meta", **shared)
    assert [call[0] for call in calls] == [*SOURCES][: len(configs)]
    (_, known_args, known_how), *others = calls
    assert known_args == (multiview, [1, 4], dark)
    assert known_how == {**shared, "config": configs[0]}
    for (name, args, how), config in zip(others, configs[1:], strict=True):
        np.testing.assert_array_equal(args[0][1, ..., 0], [[0, 1], [128, 255]])
        assert args[0].dtype == np.uint8
        assert args[-1] is dark
        if name in ("sfm", "hloc"):
            np.testing.assert_array_equal(args[1][:, 0, 0], [2.0, 5.0])
            assert how == {**shared, "config": config, "progress": None}
        else:
            assert len(args) == 2
            assert how == {**shared, "config": config, "device": "meta"}
    told = MapAnythingConfig(checkpoint=file)
    estimate_cameras(told, multiview, [1, 4], dark, device="meta", **shared)
    name, (pictures, cameras, colors_from), how = calls[-1]
    assert (name, how) == ("map-anything", {**shared, "config": told, "device": "meta"})
    assert (pictures.dtype, colors_from is dark) == (np.uint8, True)
    np.testing.assert_array_equal(cameras.Ks[:, 0, 0], [2.0, 5.0])
    assert len(cameras.viewmats) == 2
    with pytest.raises(ValueError, match="cameras from denoised pictures need these pictures"):
        estimate_cameras(SfmConfig(pictures="denoised"), multiview, [1, 4], dark, **shared)
    given = np.zeros((2, 2, 2, 3), np.uint8)
    for config in (SfmConfig(pictures="denoised"), Dust3rConfig(checkpoint=file, pictures="enhanced")):
        estimate_cameras(config, multiview, [1, 4], dark, pictures=given, **shared)
        assert calls[-1][1][0] is given


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"registered": (1, 0)}, "increasing positions"),
        ({"registered": (1, 1)}, "increasing positions"),
        ({"registered": (-1, 0)}, "increasing positions"),
        ({"registered": (0,)}, "one camera for each of 1 registered views"),
        ({"Ks": np.tile(np.eye(3), (3, 1, 1))}, r"Ks \[C,3,3\]"),
        ({"colors": np.zeros((3, 3))}, r"points and colors must be \[P, 3\]"),
        ({"points": np.full((4, 3), np.inf)}, "points of a camera estimate must be finite"),
        ({"viewmats": np.full((2, 4, 4), np.nan)}, "viewmats of a camera estimate must be finite"),
    ],
)
def test_an_estimate_that_contradicts_itself_is_refused(change, message):
    right = {
        "registered": (0, 2), "viewmats": np.tile(np.eye(4), (2, 1, 1)), "Ks": np.tile(np.eye(3), (2, 1, 1)),
        "size": (4, 3), "made_of": {}, "points": np.zeros((4, 3)), "colors": np.zeros((4, 3)), "extent": 1.0,
    }  # fmt: skip
    as_estimate(**right)
    with pytest.raises(ValueError, match=message):
        as_estimate(**(right | change))
