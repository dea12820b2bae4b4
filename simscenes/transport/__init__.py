"""Which light transport a scene needs, with the error of leaving the rest out."""

from simscenes.transport.plan import TransportPlan as TransportPlan
from simscenes.transport.planner import plan_transport as plan_transport
