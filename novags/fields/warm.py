"""Every kernel of the fields, called once: `novags.warm` compiles them ahead of their first use."""

import torch

from novags.fields.box import box_of
from novags.fields.layout import FieldLayout
from novags.fields.training.batch import Batch
from novags.fields.training.config import FieldFitConfig
from novags.fields.training.fit import fit_field
from novags.splats.views import Views


def warm() -> None:
    """Fit a field of a few rows for two steps."""
    viewmat = torch.eye(4)
    viewmat[2, 3] = 3.0
    K = torch.tensor([[16.0, 0, 8], [0, 16.0, 8], [0, 0, 1]])
    views, points = Views(viewmat[None], K[None], 16, 16), torch.rand(40, 3, generator=torch.Generator().manual_seed(0))
    config = FieldFitConfig(iterations=2, rays=64, samples=4, layout=FieldLayout(finest=32, log2_rows=10))
    fit_field(views, points, box_of(views.centers, points), _loss, config)


def _loss(batch: Batch) -> torch.Tensor:
    return batch.rendered(torch.sigmoid(batch.raw[..., 1:4])).square().mean()
