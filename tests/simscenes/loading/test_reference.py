"""One type tells a catalogue name, a file and a dict apart, and everything else asks it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import default_rig, fit_rig
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.loading.reference import SceneRef
from simscenes.render.fitting import usual_rig

BALL = {"type": "scene", "ball": {"type": "sphere"}}


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ("tabletop", ("catalogue", "tabletop", None, None)),
        ("tabletop:3", ("catalogue", "tabletop:3", None, None)),
        ("some/room.xml", ("file", "room", Path("some/room.xml"), None)),
        (Path("some/room.xml"), ("file", "room", Path("some/room.xml"), None)),
        (Path("tabletop"), ("file", "tabletop", Path("tabletop"), None)),
        (BALL, ("dict", "custom", None, BALL)),
    ],
)
def test_names_files_and_dicts_are_told_apart(scene: Any, expected: tuple[Any, ...]) -> None:
    ref = SceneRef.of(scene)
    assert (ref.kind, ref.name, ref.path, ref.description) == expected
    assert ref.in_catalogue == (expected[0] == "catalogue")
    assert SceneRef.of(ref) is ref


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("no-such-scene", "no scene 'no-such-scene' in the catalogue"),
        ("tabletop:x", "whole number"),
        ("room.XML", "no scene 'room.XML'"),
        ({"type": "sphere"}, "Mitsuba dict of type 'scene'"),
        (3, "got 3"),
        (None, "got None"),
    ],
)
def test_what_is_none_of_the_three_is_refused(scene: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SceneRef.of(scene)


def test_only_catalogue_scenes_are_seen_with_a_default_rig() -> None:
    mi = activate()
    camera = {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, -4, 1], [0, 0, 0], [0, 0, 1])}
    foreign = BALL | {"camera": {**camera, "film": {"type": "hdrfilm", "width": 20, "height": 16}}}
    loaded = build_scene(foreign, mi)
    rig = usual_rig(SceneRef.of(foreign), loaded, 5, 9, 7)
    assert (len(rig), rig.width, rig.height) == (5, 20, 16)
    assert np.array_equal(rig.viewmats, fit_rig(loaded, 5).viewmats)
    rig = usual_rig(SceneRef.of("cornell:2"), loaded, 5, 9, 7)
    assert np.array_equal(rig.viewmats, default_rig("cornell", 5, 9, 7).viewmats)
    assert (rig.width, rig.height) == (9, 7)


def test_all_parameters_of_a_file_are_given_in_their_order_and_each_is_checked() -> None:
    ref = SceneRef.of("room.xml").given(["b=2", "a=x=y", "c.d-e="], 1)
    assert (ref.parameters, ref.sensor) == ((("b", "2"), ("a", "x=y"), ("c.d-e", "")), 1)
    for given, said in (
        (["a=1", "b"], "must be NAME=VALUE, .* got 'b'"),
        (["a=1", "b c=2"], "must be NAME=VALUE, .* got 'b c=2'"),
        (["a=1", "a=2"], "must be given once, got a several times"),
        (["a=1", "b=1", "b=2"], "must be given once, got b several times"),
    ):
        with pytest.raises(ValueError, match=said):
            SceneRef.of("room.xml").given(given)
