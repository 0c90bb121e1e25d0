"""Faults as values in, what sensors, thrusters, joints and water do because of them out."""

from uvms_ocp.sim.faults.fault import Fault as Fault
from uvms_ocp.sim.faults.notation import parse_fault as parse_fault
