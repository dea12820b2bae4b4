"""Which light transport a scene calls for, with the error of leaving the rest out."""

from simscenes.transport.plan import TransportPlan as TransportPlan
from simscenes.transport.planner import plan_transport as plan_transport
