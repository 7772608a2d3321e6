"""Experiments on the two-robot cell: scenarios, motions, the control loop, figures of merit."""

from scenarios.config import AxesChange, BoundsStep, Scenario, SetpointConfig, SetpointStep
from scenarios.errors import ScenarioError, ScenarioKeyError, UnknownScenarioError
from scenarios.experiment import Experiment, run_experiment
from scenarios.load import check_scenario, dump_scenario, load_scenario, shipped
from scenarios.log import Log
from scenarios.loop import control_loop, watch_loop
from scenarios.metrics import Summary, summarise
from scenarios.schedule import Schedule
from scenarios.setpoint import Setpoint

__all__ = [
    "AxesChange",
    "BoundsStep",
    "Experiment",
    "Log",
    "Scenario",
    "ScenarioError",
    "ScenarioKeyError",
    "Schedule",
    "Setpoint",
    "SetpointConfig",
    "SetpointStep",
    "Summary",
    "UnknownScenarioError",
    "check_scenario",
    "control_loop",
    "dump_scenario",
    "load_scenario",
    "run_experiment",
    "shipped",
    "summarise",
    "watch_loop",
]
