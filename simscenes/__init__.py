"""A scene in, a ground-truth multiview set out. Importing this imports no mitsuba."""

from simscenes.backend import VariantStatus as VariantStatus
from simscenes.backend import activate as activate
from simscenes.backend import choose_variant as choose_variant
from simscenes.backend import variant_report as variant_report
from simscenes.correspondence import flow as flow
from simscenes.export import EXPORTS as EXPORTS
from simscenes.export import export_blender as export_blender
from simscenes.export import export_llff as export_llff
from simscenes.exr import read_exr as read_exr
from simscenes.exr import write_exr as write_exr
from simscenes.multiview import MultiviewSet as MultiviewSet
from simscenes.multiview import load_set as load_set
from simscenes.multiview import write_cameras as write_cameras
from simscenes.optics import Optics as Optics
from simscenes.render import render_set as render_set
from simscenes.render.curves import render_curves as render_curves
from simscenes.render.fit import fit_rig as fit_rig
from simscenes.rigs import Rig as Rig
from simscenes.rigs import forward_rig as forward_rig
from simscenes.rigs import orbit_rig as orbit_rig
from simscenes.scenes import SCENES as SCENES
from simscenes.scenes import default_rig as default_rig
from simscenes.transport import TransportPlan as TransportPlan
from simscenes.transport import plan_transport as plan_transport
