"""Claims about rows of tables that results were made with and that are gone: all of them are named."""

from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.metrics import METRICS
from novags.testbed.report.blocks.absent import absent


def made(method: str, source: str = "known", lacks: str | None = None, scene: str = "cornell") -> Any:
    record = {"config": {}, "cameras": {"source": source}, "enhancement": {"enhancer": "theirs"}}
    stage = {"inputs": {"scene": scene}, "config": {"scene": scene}}
    return SimpleNamespace(run=SimpleNamespace(method=method, record=record, lacks=lacks), rendered={"stage": stage})


def test_what_is_gone_is_named_whichever_run_and_column_has_it() -> None:
    runs = {1: made("naive"), 2: made("gone"), 3: made("naive", "lost", "no package"), 4: made("naive", scene="moon:3")}
    rows = [
        {"lit.beauty": 1.0, "enhanced.aligned_psnr": 1.0},
        {"lit.glow": 2.0, "noise.strange": 1.0, "enhanced.shine": 3},
    ]
    found = absent(SimpleNamespace(made=runs, rows=rows), None)  # type: ignore[arg-type]
    assert found is not None
    assert list(found["facts"]) == ["method gone", "enhancer theirs", "cameras lost", "scene moon:3", "metric beauty",
                                    "metric glow", "metric shine"]  # fmt: skip


def test_nothing_is_said_where_all_is_here() -> None:
    beside = {"enhanced.aligned_psnr_error": 0.1, "lit.ssim_bias": 0.0, "lit.truth_variance": 1e-5}
    rows = [{"enhanced.aligned_psnr": 1.0}, {"lit.psnr": 2.0} | beside]
    assert absent(SimpleNamespace(made={1: made("naive")}, rows=rows), None) is None  # type: ignore[arg-type]


def test_a_metric_that_is_here_may_be_called_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METRICS, "angular_error", METRICS["psnr"])
    assert absent(SimpleNamespace(made={}, rows=[{"lit.angular_error": 3.0}]), None) is None  # type: ignore[arg-type]
