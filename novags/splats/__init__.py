"""The splat engine: 3D Gaussians, their rasterisers, 3DGS-MCMC and the training loop every method shares."""

from .adam import LearningRates as LearningRates
from .camera_refinement import CameraRefinement as CameraRefinement
from .fit import FitConfig as FitConfig
from .fit import FitResult as FitResult
from .fit import fit as fit
from .gaussians import Gaussians as Gaussians
from .guard import NotFinite as NotFinite
from .losses import photometric_loss as photometric_loss
from .losses import ssim as ssim
from .mcmc import McmcConfig as McmcConfig
from .ply import read_ply as read_ply
from .ply import write_ply as write_ply
from .rasterize import rasterize as rasterize
from .step import Step as Step
from .views import Views as Views
