"""Physical camera model: radiance in, digital numbers out. Arrays only."""

from sensor_model.capture import RawFrame as RawFrame
from sensor_model.capture import expose as expose
from sensor_model.dng import write_dng as write_dng
from sensor_model.isp import Developed as Developed
from sensor_model.isp import develop as develop
from sensor_model.isp import develop_linear as develop_linear
from sensor_model.isp import from_linear16 as from_linear16
from sensor_model.isp import linear_to_srgb as linear_to_srgb
from sensor_model.isp import srgb_to_linear as srgb_to_linear
from sensor_model.mosaic import mosaic as mosaic
from sensor_model.params import Exposure as Exposure
from sensor_model.params import Sensor as Sensor
from sensor_model.plan import Effect as Effect
from sensor_model.plan import Plan as Plan
from sensor_model.planner import plan_effects as plan_effects
from sensor_model.presets import PRESETS as PRESETS
from sensor_model.radiometry import photons_for_electrons as photons_for_electrons
