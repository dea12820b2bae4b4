"""Claims about the sides of a comparison: what a name means, and what is said of one that means nothing."""

import subprocess
from pathlib import Path

import pytest

from novags.methods.variant import Variant
from novags.testbed.study.versions import sides
from novags.testbed.study.versions.sides import PACKAGES, Side, sides_of

GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")


def sources(folder: Path) -> Path:
    """What a checkout holds, all of it empty."""
    for name in PACKAGES:
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("")
    return folder


def test_a_name_is_a_method_a_variant_or_a_checkout(tmp_path: Path) -> None:
    mine = Variant(name="mine", method="naive", settings={"fit.iterations": 3})
    one, other = sides_of("naive", "mine", [mine], tmp_path)
    assert (one.role, one.method, other.role, other.method) == ("base", "naive", "changed", "mine")
    assert one.root == other.root == Path(sides.ROOT)
    one, other = sides_of(str(sources(tmp_path / "a")), str(sources(tmp_path / "b")), [], tmp_path)
    assert (one.root, other.root) == ((tmp_path / "a").resolve(), (tmp_path / "b").resolve())
    assert one.method is other.method is None


@pytest.mark.parametrize(("name", "told"), [
    ("half", "the folder .*half is no checkout of novags, because simscenes, sensor_model are not in it"),
    ("navie", "'navie' is no folder, no revision of .*, and no method: .*did you mean 'naive'"),
    ("--output=x", "no folder, no revision"),
])  # fmt: skip
def test_a_name_that_means_nothing_is_refused_with_what_it_lacks(tmp_path: Path, name: str, told: str) -> None:
    (tmp_path / "half" / "novags").mkdir(parents=True)
    (tmp_path / "half" / "novags" / "__init__.py").write_text("")
    with pytest.raises(ValueError, match=told) as error:
        sides_of("naive", str(tmp_path / name) if name == "half" else name, [], tmp_path)
    assert "\n" not in str(error.value)


def test_a_checkout_is_not_compared_with_a_method(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"is a checkout and naive a method: compare two checkouts.*--methods naive"):
        sides_of(str(sources(tmp_path / "a")), "naive", [], tmp_path)


def test_a_revision_is_laid_out_as_it_was_committed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = sources(tmp_path / "here")
    monkeypatch.setattr(sides, "ROOT", str(here))
    for words in (("init", "-q"), ("add", "."), ("commit", "-qm", "first")):
        subprocess.run([*GIT, *words], cwd=here, check=True)
    (here / "novags" / "__init__.py").write_text("changed = True\n")
    found, other = sides_of("HEAD", str(here), [], tmp_path / "code")
    assert not (tmp_path / "code").exists()  # a dry run comes so far
    for _ in range(2):
        found.lay_out()
        other.lay_out()
    assert (found.root / "novags" / "__init__.py").read_text() == ""
    assert (other.root / "novags" / "__init__.py").read_text() == "changed = True\n"
    assert found.root.name == found.commit


def test_a_revision_without_our_packages_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sides, "ROOT", str(tmp_path))
    subprocess.run([*GIT, "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run([*GIT, "commit", "-qm", "empty", "--allow-empty"], cwd=tmp_path, check=True)
    found, _ = sides_of("HEAD", "HEAD", [], tmp_path / "code")
    with pytest.raises(ValueError, match="the revision HEAD lacks one of novags"):
        found.lay_out()


def test_a_fit_that_fails_names_its_side_and_the_last_line_of_its_log(tmp_path: Path) -> None:
    broken = sources(tmp_path / "broken")
    side = Side("changed", "./broken", broken.resolve())
    with pytest.raises(
        ValueError, match=r"changed \(\./broken\): ModuleNotFoundError: .*novags\.process.*\(log: .*a\.log\)"
    ):
        side.fit(["capture"], tmp_path / "run", tmp_path / "logs" / "a.log")
