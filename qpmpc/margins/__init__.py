"""How far a force controller is from its limits: margins, ranges of stability, rejection, tuning.

Linear, discrete and exact: the closed form with the observer, as it runs, around a plant whose
stiffness, delay and lag may be others than the controller's model of them.
"""

from qpmpc.margins.bound import prediction_error
from qpmpc.margins.frequency import Margins, margins
from qpmpc.margins.law import force_law, linear_law
from qpmpc.margins.loop import Loop
from qpmpc.margins.plant import TruePlant
from qpmpc.margins.range import stable_range
from qpmpc.margins.system import System
from qpmpc.margins.tuning import Demand, Quality, Tuned, tune

__all__ = [
    "Demand",
    "Loop",
    "Margins",
    "Quality",
    "System",
    "TruePlant",
    "Tuned",
    "force_law",
    "linear_law",
    "margins",
    "prediction_error",
    "stable_range",
    "tune",
]
