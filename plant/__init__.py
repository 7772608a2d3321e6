"""The two-robot cell: arms, contact, sensors, inner loop. It knows no controller."""

from plant.cell import Cell
from plant.config import (
    CellConfig,
    ContactConfig,
    ImperfectionConfig,
    SensorConfig,
    ToolConfig,
)
from plant.errors import PlantError
from plant.interface import JointPlant, JointSpace, Measurement, Plant, Truth
from plant.playback import UnreachableMotionError

__all__ = [
    "Cell",
    "CellConfig",
    "ContactConfig",
    "ImperfectionConfig",
    "JointPlant",
    "JointSpace",
    "Measurement",
    "Plant",
    "PlantError",
    "SensorConfig",
    "ToolConfig",
    "Truth",
    "UnreachableMotionError",
]
