"""The two-robot cell: arms, contact, sensors, inner loop. It knows no controller."""

from plant.cell import Cell
from plant.config import (
    ArmConfig,
    BristleConfig,
    CellConfig,
    ContactConfig,
    ImperfectionConfig,
    ProtectionConfig,
    SensorConfig,
    ToolConfig,
)
from plant.errors import ArmError, PlantError
from plant.indentation import Indentation, indent
from plant.interface import Cause, JointPlant, JointSpace, Measurement, Plant, Trip, Truth
from plant.own_arm import tool_arm
from plant.playback import UnreachableMotionError
from plant.protection import force_cap

__all__ = [
    "ArmConfig",
    "ArmError",
    "BristleConfig",
    "Cause",
    "Cell",
    "CellConfig",
    "ContactConfig",
    "ImperfectionConfig",
    "Indentation",
    "JointPlant",
    "JointSpace",
    "Measurement",
    "Plant",
    "PlantError",
    "ProtectionConfig",
    "SensorConfig",
    "ToolConfig",
    "Trip",
    "Truth",
    "UnreachableMotionError",
    "force_cap",
    "indent",
    "tool_arm",
]
