"""A scene in, a ground-truth multiview set out. Importing this does not import mitsuba."""

from simscenes.backend import VariantStatus as VariantStatus
from simscenes.backend import activate as activate
from simscenes.backend import choose_variant as choose_variant
from simscenes.backend import variant_report as variant_report
from simscenes.job.render_set import render_set as render_set
from simscenes.optics import Optics as Optics
from simscenes.render.fitting import fit_rig as fit_rig
from simscenes.render.framing import own_cameras as own_cameras
from simscenes.rigs import Rig as Rig
from simscenes.rigs import forward_rig as forward_rig
from simscenes.rigs import orbit_rig as orbit_rig
from simscenes.scenes import SCENES as SCENES
from simscenes.scenes import default_rig as default_rig
from simscenes.sets.geometry.correspondence import flow as flow
from simscenes.sets.geometry.tracks import SparsePoints as SparsePoints
from simscenes.sets.multiview import MultiviewSet as MultiviewSet
from simscenes.sets.multiview import load_set as load_set
from simscenes.sets.multiview import write_cameras as write_cameras
from simscenes.sets.pictures.exr import read_exr as read_exr
from simscenes.sets.pictures.exr import write_exr as write_exr
from simscenes.sets.writers.export import EXPORTS as EXPORTS
from simscenes.sets.writers.export import export_blender as export_blender
from simscenes.sets.writers.export import export_llff as export_llff
from simscenes.transport import TransportPlan as TransportPlan
from simscenes.transport import plan_transport as plan_transport
