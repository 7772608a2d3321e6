"""The two-robot cell: arms, contact, sensors, inner loop. It knows no controller."""

from plant.cell import Cell
from plant.config import (
    CellConfig,
    ContactConfig,
    ImperfectionConfig,
    ProtectionConfig,
    SensorConfig,
    ToolConfig,
)
from plant.errors import PlantError
from plant.interface import Cause, JointPlant, JointSpace, Measurement, Plant, Trip, Truth
from plant.playback import UnreachableMotionError
from plant.protection import force_cap

__all__ = [
    "Cause",
    "Cell",
    "CellConfig",
    "ContactConfig",
    "ImperfectionConfig",
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
]
