"""The splat engine: 3D Gaussians, their rasterisers, 3DGS-MCMC and the training loop every method shares."""

from .files.ply import read_ply as read_ply
from .files.ply import write_ply as write_ply
from .gaussians import Gaussians as Gaussians
from .raster.rasterize import rasterize as rasterize
from .training.fit import FitConfig as FitConfig
from .training.fit import FitResult as FitResult
from .training.fit import fit as fit
from .training.guard import NotFinite as NotFinite
from .training.losses import photometric_loss as photometric_loss
from .training.losses import ssim as ssim
from .training.step import Step as Step
from .training.updates.adam import LearningRates as LearningRates
from .training.updates.camera_refinement import CameraRefinement as CameraRefinement
from .training.updates.mcmc import McmcConfig as McmcConfig
from .views import Views as Views
