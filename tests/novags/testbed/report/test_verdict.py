"""Claims about the headline: it names the best of those that see no truth, and hides no score that says otherwise."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.metrics.differences import Estimate
from novags.testbed.report import verdict
from novags.testbed.report.tables import columns

HEADINGS = {key: heading for key, heading, _, _ in columns("enhanced")}


def material(**runs: dict[str, Any]) -> Any:
    """A report of runs with these scores; scores not named are all the same."""
    even = dict.fromkeys(HEADINGS, 0.5)
    rows = {
        name: SimpleNamespace(name=name, competes=name not in ("oracle", "averaging"), family="", bound=None)
        for name in runs
    }
    return SimpleNamespace(
        rows=rows,
        one_reference=True,
        exposures={},
        main="ours" if "ours" in runs else next(iter(runs)),
        metrics={
            "methods": {name: {"mean": {"enhanced": even | scores}} for name, scores in runs.items()},
            "recovered": {
                name: Estimate(value, 0.03, 2.0, "views", 1, 1, 3)
                for name, value in (("plain", 0.0), ("ours", 0.4), ("rival", 0.62))
            },
        },
        bound=lambda end: {"floor": "plain", "ceiling": "oracle"}[end] if end == "floor" or "oracle" in runs else None,
    )


def test_the_best_that_sees_no_truth_is_named_and_ours_beside_it() -> None:
    said = verdict.verdict(
        material(
            plain={"aligned_psnr": 24.0}, ours={"aligned_psnr": 25.5}, rival={"aligned_psnr": 26.25},
            averaging={"aligned_psnr": 28.0}, oracle={"aligned_psnr": 29.0},
        )
    )  # fmt: skip
    assert said == (
        "rival comes first with 26.25 dB on the held-out views (aligned PSNR against the noise-free exposure), "
        "2.25 dB more than plain (this scene, one view and one seed: no error is known); that wins back 62 ± 3 % of "
        "what noise costs here; ours reaches 25.50 dB."
    )


def test_scores_that_put_another_run_first_are_named() -> None:
    said = verdict.verdict(
        material(
            plain={"aligned_psnr": 24.0, "flip": 0.1, "ssim": 0.9},
            ours={"aligned_psnr": 25.5, "flip": 0.2, "lpips": 0.4, "delta_e": 0.4},
            rival={"aligned_psnr": 25.4, "flip": 0.3, "psnr": 0.6},
            oracle={"aligned_psnr": 29.0, "flip": 0.0, "tone_aligned_psnr": 40.0},
        )
    )
    assert said.startswith("ours comes first with 25.50 dB")
    assert said.endswith(" Not so by PSNR: rival comes first; by SSIM and FLIP: plain comes first.")


def test_scores_of_other_tables_that_put_another_run_first_are_named_too() -> None:
    found = material(plain={"aligned_psnr": 24.0}, ours={"aligned_psnr": 25.5}, oracle={"aligned_psnr": 29.0})
    depth = {"within_5_percent": 0.5, "coverage": 1.0, "floaters": 0.0, "consistency": {"excess": 0.0}}
    for name, value, error in (("plain", 20.0, 0.1), ("ours", 18.0, 0.2), ("oracle", 25.0, 0.0)):
        method = found.metrics["methods"][name]
        method["mean"]["lit"] = dict.fromkeys(HEADINGS, 0.5) | {"tone_aligned_psnr": value, "psnr": value}
        method["geometry"] = depth | {"abs_rel": error}
    assert verdict.verdict(found).endswith(
        " Not so by PSNR tone-aligned and PSNR against the well-lit truth: plain comes first; by relative error "
        "against the true surfaces: plain comes first."
    )
    found.exposures = {"ours": object()}  # linear light, which truth exposes: its plain PSNR takes no place
    assert "Not so by PSNR tone-aligned against the well-lit truth: plain" in verdict.verdict(found)


def test_one_run_alone_comes_first_of_nothing() -> None:
    assert verdict.verdict(material(plain={"aligned_psnr": 24.0})).startswith("plain reaches 24.00 dB")


def test_methods_with_references_of_their_own_are_compared_with_the_well_lit_one() -> None:
    found = material(plain={"aligned_psnr": 24.0}, ours={"aligned_psnr": 30.0})
    for name, value in (("plain", 20.0), ("ours", 18.0)):
        found.metrics["methods"][name]["mean"]["lit"] = dict.fromkeys(HEADINGS, 0.5) | {"tone_aligned_psnr": value}
    assert verdict.verdict(found).startswith("ours comes first with 30.00 dB")
    found.one_reference = False
    said = verdict.verdict(found)
    assert said.startswith(
        "plain comes first with 20.00 dB on the held-out views (tone-aligned PSNR against the well-lit"
    )
    assert "30" not in said
    found.metrics["methods"]["ours"]["mean"]["lit"]["psnr"] = 25.0
    assert "by PSNR: ours comes first" in verdict.verdict(found)
    found.exposures = {"ours": object()}  # linear light, to whose exposure truth helps
    assert "by PSNR: ours comes first" not in verdict.verdict(found)


def by_views(name: str, *scores: float) -> dict[str, Any]:
    return {"views": {f"{i}": {"enhanced": {"aligned_psnr": score}} for i, score in enumerate(scores)}}


def test_where_a_method_without_noise_wins_nothing_the_fit_is_said_to_limit() -> None:
    found = material(plain={"aligned_psnr": 17.0}, ours={"aligned_psnr": 17.1}, oracle={"aligned_psnr": 17.2})
    said = verdict.verdict(found)
    assert "The fit limits here, not the noise: oracle, which sees no noise, is +0.20 dB from plain" in said
    far = material(plain={"aligned_psnr": 17.0}, ours={"aligned_psnr": 17.1}, oracle={"aligned_psnr": 19.0})
    assert "limits" not in verdict.verdict(far)
    far.metrics["methods"]["plain"] |= by_views("plain", 17.0, 17.0, 17.0)
    far.metrics["methods"]["oracle"] |= by_views("oracle", 18.9, 19.0, 19.1)
    assert "limits" not in verdict.verdict(far)
    far.metrics["methods"]["oracle"] |= by_views("oracle", 15.0, 19.0, 23.0)  # 2 +- 2.3 dB
    said = verdict.verdict(far)
    assert (
        "Whether noise or the fit limits is not known: oracle, which sees no noise, is +2.00 ± 2.31 dB from plain"
        in said
    )
    assert "The fit limits here" not in said
    assert "limits" not in verdict.verdict(material(plain={"aligned_psnr": 17.0}, ours={"aligned_psnr": 17.1}))


@pytest.mark.parametrize("lacking", ["plain", "oracle"])
def test_where_an_end_has_no_score_nothing_is_said_to_limit(lacking: str) -> None:
    found = material(plain={"aligned_psnr": 17.0}, ours={"aligned_psnr": 17.1}, oracle={"aligned_psnr": 17.2})
    assert "limits" in verdict.limits(found)
    for own in found.metrics["methods"].values():
        own["mean"]["lit"] = {"tone_aligned_psnr": 17.0}
    assert "limits" in verdict.limits(found)
    found.one_reference = False  # the lit score decides
    found.metrics["methods"][lacking]["mean"]["lit"]["tone_aligned_psnr"] = None
    assert verdict.limits(found) == ""


@pytest.mark.parametrize("order", [("enhanced", "other"), ("other", "enhanced")])
def test_a_reference_leads_only_if_every_run_has_it(order: tuple[str, str]) -> None:
    found = material(a={"aligned_psnr": 17.0}, b={"aligned_psnr": 18.0})
    means = {"enhanced": {"enhanced": {"aligned_psnr": 17.0}, "lit": {"tone_aligned_psnr": 1.0}},
             "other": {"lit": {"tone_aligned_psnr": 1.0}}}  # fmt: skip
    found.metrics["methods"] = {name: {"mean": means[kind]} for name, kind in zip("ab", order, strict=True)}
    leading = verdict.leading(found)
    assert leading is not None
    assert leading[0] == "lit"
    for lacking, whole in ("ab", "ba"):
        found.metrics["methods"][lacking]["mean"] = {}
        found.metrics["methods"][whole]["mean"] = {"lit": {"tone_aligned_psnr": 1.0}}
        assert verdict.leading(found) is None


def test_runs_that_views_do_not_tell_apart_share_the_headline() -> None:
    """.03 dB from two views that are dB apart names no winner; nor does a rival that is clearly below hide it."""
    found = material(plain={"aligned_psnr": 20.0}, ours={"aligned_psnr": 22.0}, rival={"aligned_psnr": 22.03})
    for name, scores in (("plain", (18.0, 22.0)), ("ours", (20.0, 24.0)), ("rival", (20.4, 23.66))):
        found.metrics["methods"][name] |= by_views(name, *scores)
    said = verdict.verdict(found)
    assert said.startswith(
        "No difference is seen between rival and ours: 22.00 to 22.03 dB on the held-out views (aligned PSNR"
    )
    assert "comes first" not in said
    assert verdict.first(found) == ["rival", "ours"]


def test_a_gain_is_said_with_its_error_and_what_that_is_over() -> None:
    found = material(plain={"aligned_psnr": 20.0}, ours={"aligned_psnr": 22.0})
    found.metrics["methods"]["plain"] |= by_views("plain", 18.0, 20.0, 22.0)
    found.metrics["methods"]["ours"] |= by_views("ours", 20.1, 22.0, 23.9)
    assert "ours comes first with 22.00 dB" in verdict.verdict(found)
    assert ", 2.00 ± 0.06 dB more than plain (this scene, 3 views)" in verdict.verdict(found)


def test_all_that_share_the_first_place_by_another_score_are_named() -> None:
    found = material(best={"aligned_psnr": 30.0, "ssim": 0.7}, x={"aligned_psnr": 25.0, "ssim": 0.8},
                     y={"aligned_psnr": 24.0, "ssim": 0.83})  # fmt: skip
    found.bound = lambda end: None
    for name, psnr, ssim in (("best", 30.0, (0.7, 0.7)), ("x", 25.0, (0.9, 0.7)), ("y", 24.0, (0.86, 0.8))):
        found.metrics["methods"][name]["views"] = {
            f"{k}": {"enhanced": {"aligned_psnr": psnr + 0.01 * k, "ssim": each}} for k, each in enumerate(ssim)
        }
    for name in ("x", "y"):  # seen to be above best, by views that go along with it
        own = found.metrics["methods"][name]["views"]
        for k in range(2, 6):
            own[str(k)] = {"enhanced": {"aligned_psnr": 25.0, "ssim": 0.8 + 0.01 * k * (-1) ** k}}
    for k in range(2, 6):
        found.metrics["methods"]["best"]["views"][str(k)] = {"enhanced": {"aligned_psnr": 30.0, "ssim": 0.7}}
    assert "by SSIM: x and y come first, not seen to differ" in verdict.verdict(found)


def test_the_leader_is_ahead_where_both_have_a_value() -> None:
    """A view within the noise of the truth has no value of the better method, and raises the mean of the other."""
    found = material(plain={"aligned_psnr": 40.7}, ours={"aligned_psnr": 40.0})
    found.metrics["methods"]["plain"] |= by_views("plain", 45.0, 39.0, 39.1)
    found.metrics["methods"]["ours"]["views"] = {
        k: {"enhanced": {"aligned_psnr": score}} for k, score in (("1", 40.0), ("2", 40.05))
    }
    assert verdict.leader(found) == "ours"
