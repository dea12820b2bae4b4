"""Hard cases of the enhancement: no light, one bright pixel, images smaller than the window."""

from novags.testbed.stability.case import Part

PART = Part("enhance")
