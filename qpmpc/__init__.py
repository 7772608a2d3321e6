"""Constrained, QP-based model predictive control: models, prediction, QPs, backends, observers.

This package knows no robot, no file and no clock policy. It shares its import name with an
unrelated package on PyPI (``qpmpc`` by S. Caron); ours is distributed as ``pulsempc``.
"""

from qpmpc.augment import (
    Exosystem,
    combined,
    constant,
    oscillator,
    parabola,
    ramp,
    with_delay,
    with_disturbance,
)
from qpmpc.axis import AxisModel, axis_model
from qpmpc.backends import (
    Backend,
    BackendInfo,
    Family,
    Limits,
    RawSolution,
    available,
    register,
    register_family,
)
from qpmpc.bounds import CommandBound, MappedBound, OutputBound, RateBound
from qpmpc.cone import force_cone
from qpmpc.config import (
    BoundsConfig,
    ControllerConfig,
    JointsConfig,
    ModelConfig,
    ObserverConfig,
    PerAxis,
    SolverConfig,
    TangentialConfig,
)
from qpmpc.construction import NUMPY, Construction
from qpmpc.contact import ContactModel, contact_model
from qpmpc.controller import Compilation, Controller
from qpmpc.errors import (
    BackendSetupError,
    BackendUnavailableError,
    BoundsError,
    ModelError,
    ObserverError,
    QpmpcError,
    ShapeError,
    UnknownNameError,
)
from qpmpc.expectation import Ranges
from qpmpc.fallback import Source
from qpmpc.force_control import ForceController
from qpmpc.joints import JointSpace
from qpmpc.kinds import ControllerKind, controller_kind, controllers, register_controller
from qpmpc.models import LinearModel, from_state_space, stack, zero_order_hold
from qpmpc.native import CompiledStepError
from qpmpc.observer import KalmanObserver
from qpmpc.parametric import Parametric
from qpmpc.penalties import ordered
from qpmpc.prediction import Prediction, absolute_prediction, prediction
from qpmpc.problem import Problem
from qpmpc.program import QuadraticProgram
from qpmpc.protocol import ForceControl
from qpmpc.reference import ExponentialReference
from qpmpc.residuals import Residuals
from qpmpc.solver import Solution, Solver, solve
from qpmpc.status import Status
from qpmpc.step import Step, Times

__all__ = [
    "NUMPY",
    "AxisModel",
    "Backend",
    "BackendInfo",
    "BackendSetupError",
    "BackendUnavailableError",
    "BoundsConfig",
    "BoundsError",
    "CommandBound",
    "Compilation",
    "CompiledStepError",
    "Construction",
    "ContactModel",
    "Controller",
    "ControllerConfig",
    "ControllerKind",
    "Exosystem",
    "ExponentialReference",
    "Family",
    "ForceControl",
    "ForceController",
    "JointSpace",
    "JointsConfig",
    "KalmanObserver",
    "Limits",
    "LinearModel",
    "MappedBound",
    "ModelConfig",
    "ModelError",
    "ObserverConfig",
    "ObserverError",
    "OutputBound",
    "Parametric",
    "PerAxis",
    "Prediction",
    "Problem",
    "QpmpcError",
    "QuadraticProgram",
    "Ranges",
    "RateBound",
    "RawSolution",
    "Residuals",
    "ShapeError",
    "Solution",
    "Solver",
    "SolverConfig",
    "Source",
    "Status",
    "Step",
    "TangentialConfig",
    "Times",
    "UnknownNameError",
    "absolute_prediction",
    "available",
    "axis_model",
    "combined",
    "constant",
    "contact_model",
    "controller_kind",
    "controllers",
    "force_cone",
    "from_state_space",
    "ordered",
    "oscillator",
    "parabola",
    "prediction",
    "ramp",
    "register",
    "register_controller",
    "register_family",
    "solve",
    "stack",
    "with_delay",
    "with_disturbance",
    "zero_order_hold",
]
