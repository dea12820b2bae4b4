"""The stages, folder in, folder out. What makes them resumable and keeps finished work is `cache.run_stage`.

`stale` names files elsewhere that describe an earlier result; they go when it goes.
"""

from novags.testbed.stages.capture import capture as capture
from novags.testbed.stages.reconstruct import reconstruct as reconstruct
from novags.testbed.stages.render import render as render
from novags.testbed.stages.score import score as score
