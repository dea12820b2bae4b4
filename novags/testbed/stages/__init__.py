"""The stages: folder in, folder out. `cache.run_stage` makes them resumable and keeps finished work.

`stale` names files elsewhere that describe an earlier result; they are removed together with it.
"""

from novags.testbed.stages.capture import capture as capture
from novags.testbed.stages.denoise import denoise as denoise
from novags.testbed.stages.importing import import_photographs as import_photographs
from novags.testbed.stages.poses import poses as poses
from novags.testbed.stages.reconstruct import reconstruct as reconstruct
from novags.testbed.stages.render import render as render
from novags.testbed.stages.score import score as score
