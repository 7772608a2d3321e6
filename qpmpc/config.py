"""What can be set on the force controller: frozen records, SI units, tuned defaults.

Plain data: whoever reads a file checks it against the types and the ranges in the annotations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from qpmpc.rivals.config import ActiveObserverConfig, LearningConfig, PaperLawConfig, PiConfig

Disturbance = Literal["none", "constant", "ramp", "fused", "tracked", "beats"]
Interval = tuple[float, float]
"""Lower and upper bound; infinite: none."""

INFINITE = float("inf")
FREE: Interval = (-INFINITE, INFINITE)


@dataclass(frozen=True)
class ModelConfig:
    """The controller's idea of the plant: eqs. (7)-(9) of the paper, delay and lag added."""

    stiffness: Annotated[float, Gt(0), Le(1e6)] = 2500.0
    """Estimated stiffness of the tissue, K_s with a hat [N/m]."""
    velocity_damping: Annotated[float, Ge(0), Le(1e3)] = 20.0
    """K2, gain of the velocity loop around the unit mass [1/s]."""
    delay: Annotated[int, Ge(0), Le(20)] = 1
    """Whole cycles between a command and the torque it causes [cycles]."""
    lag: Annotated[float, Ge(0), Le(0.1)] = 0.001
    """Time constant of a first-order lag from command to acceleration [s]; 0: none."""
    damping: Annotated[float, Ge(0), Le(1e4)] = 0.0
    """Damping of the tissue in parallel to its stiffness, B [N s/m]."""


@dataclass(frozen=True)
class RhythmConfig:
    """``tracked`` and ``beats``: what is assumed of motion that nearly repeats itself."""

    jerk_drift: Annotated[float, Gt(0)] = 20.0
    """Change per cycle of the tissue's jerk where no rhythm is found [m/s^3], standard
    deviation."""
    residual_jerk_drift: Annotated[float, Gt(0)] = 0.8
    """The same for what the learned beat leaves over [m/s^3]."""
    memory: Annotated[float, Gt(0), Le(1000)] = 8.0
    """Beats after which one has lost 63 % of its weight in the learned beat."""
    amplitude_spread: Annotated[float, Gt(0), Le(1)] = 0.15
    """Relative spread of the beats' amplitude, standard deviation [-]."""
    amplitude_memory: Annotated[float, Ge(0), Lt(1)] = 0.7
    """Share of an amplitude's deviation that the next beat keeps [-]."""
    beat_delay: Annotated[float, Gt(0), Le(0.1)] = 0.002
    """``beats``: spread of the time from R peak to motion, standard deviation [s]."""
    interval_spread: Annotated[float, Gt(0), Le(0.2)] = 0.04
    """``tracked``: spread of an interval about the one expected, standard deviation [s]."""


@dataclass(frozen=True)
class ObserverConfig:
    """Steady-state Kalman observer: which disturbance it models, and the noise it is told."""

    disturbance: Disturbance = "fused"
    """``none``: the paper's own state, force and encoder velocity; ``constant`` or ``ramp``: a
    disturbance matched to the input, seen by the force sensor; ``fused``: tissue velocity seen by
    the force sensor and input error seen by the encoders; ``tracked``, ``beats``: input error as
    a state, the tissue's motion previewed from a learned beat whose phase is found in the motion,
    or told by the R peaks of an ECG (``docs/rhythm.md``)."""
    force_noise: Annotated[float, Gt(0)] = 0.003
    """Standard deviation of the measured force [N]; a scenario that does not give it gets the
    figure of its sensor."""
    velocity_noise: Annotated[float, Gt(0)] = 1e-5
    """Standard deviation of the tool's measured velocity [m/s]."""
    input_drift: Annotated[float, Gt(0)] = 0.3
    """``constant``, and the input error of ``fused``, ``tracked``, ``beats``: change of the
    disturbance per cycle [m/s^2], standard deviation."""
    input_slope_drift: Annotated[float, Gt(0)] = 3.0
    """``ramp``: change per cycle of the disturbance's slope [m/s^3], standard deviation."""
    tissue_jerk_drift: Annotated[float, Gt(0)] = 100.0
    """``fused``: change per cycle of the tissue's jerk [m/s^3], standard deviation."""
    tissue_acceleration: Annotated[float, Gt(0)] = 1.5
    """``fused``: what is known of the tissue's acceleration beforehand, standard deviation around 0
    [m/s^2]; used where the force goes missing."""
    tissue_jerk: Annotated[float, Gt(0)] = 60.0
    """``fused``, ``ramp``: the same of its jerk [m/s^3]."""
    patience: Annotated[float, Ge(0), Le(10)] = 0.04
    """How long force or velocity may be missing and the estimate still be what is decided on [s];
    then the last plan goes on and the command is held until all is measured again."""
    force_gate: Annotated[float, Gt(0)] = 2.0
    """How far a measured force may be off what is expected, in the steady state [N]; one that is
    further off is not used, three times in a row at most."""
    rhythm: RhythmConfig = field(default_factory=RhythmConfig)


@dataclass(frozen=True)
class PerAxis:
    """An interval for each axis; the axes that are not named are free."""

    x: Interval = FREE
    y: Interval = FREE
    z: Interval = FREE


Band = Interval | PerAxis
"""The same interval for every axis, or one for each."""


@dataclass(frozen=True)
class TangentialConfig:
    """Bound on the norm of the force on x and y, ``limit + friction * pressure``: no slip."""

    limit: Annotated[float, Ge(0)] = INFINITE
    """Norm allowed without pressure [N]; infinite: no bound."""
    friction: Annotated[float, Ge(0)] = 0.0
    """Coefficient of the pressing force, -z [-]."""
    facets: Annotated[int, Ge(3), Le(64)] = 8
    """Sides of the polygon that stands for the circle."""


@dataclass(frozen=True)
class JointsConfig:
    """Bounds on Robot_Tool's joints as shares of their own limits."""

    speed: Annotated[float, Gt(0)] = INFINITE
    """Share of each joint's largest speed [-]; infinite: no bound."""
    torque: Annotated[float, Gt(0)] = INFINITE
    """Share of each joint's largest torque [-]; infinite: no bound."""


SoftBoundName = Literal["joint_torque", "joint_speed", "velocity", "tangential", "force"]


@dataclass(frozen=True)
class BoundsConfig:
    """Bounds, each side of which may be infinite; command and rate are hard, the others soft."""

    command: Band = (-20.0, 20.0)
    """Acceleration command, every axis or per axis [m/s^2]."""
    rate: Band = FREE
    """Change of the command per cycle, every axis or per axis [m/s^2]."""
    force: Band = FREE
    """Contact force, every axis or per axis [N]."""
    force_margin: Annotated[float, Ge(0)] = 0.0
    """What the controller keeps away from the bounds on force, for what it cannot predict [N]."""
    velocity: Band = FREE
    """Velocity of the tool, every axis or per axis [m/s]."""
    velocity_margin: Annotated[float, Ge(0)] = 0.0
    """What the controller keeps away from the bounds on velocity [m/s]."""
    tangential: TangentialConfig = field(default_factory=TangentialConfig)
    joints: JointsConfig = field(default_factory=JointsConfig)
    order: tuple[SoftBoundName, ...] = (
        "joint_torque",
        "joint_speed",
        "velocity",
        "tangential",
        "force",
    )
    """All soft bounds, the strongest first: the last one gives way first."""
    largest_error: Annotated[float, Gt(0)] = 25.0
    """Force error up to which each bound holds before those that stand after it [N]."""


@dataclass(frozen=True)
class SolverConfig:
    """How the QP of each cycle is solved."""

    max_iterations: Annotated[int, Ge(1)] | None = None
    """Iterations after which the solver stops, an error if it has no such limit; its own limit if
    not given."""
    time_limit: Annotated[float, Gt(0)] | None = None
    """Time after which the solver stops, an error if it has no such limit [s]; none if not
    given."""
    deadline: Annotated[float, Gt(0)] | None = None
    """Time from the start of a step by which its answer has to be there [s]; one that is later is
    not applied, the last plan goes on. None if not given: an answer is applied however late."""
    compiled: Literal["auto", "on", "off"] = "auto"
    """Whether a step is compiled C: where it can be had, or always (else an error), or never."""
    form: Literal["auto", "condensed", "structured"] = "auto"
    """``condensed``: one matrix over the horizon; ``structured``: stage by stage, at a cost that
    grows linearly with the horizon; ``auto``: whichever is faster, where the backend leaves the
    choice."""
    smallest_part: Annotated[int, Ge(1)] | None = None
    """Variables that make a component of the QP worth a call of its own, smaller ones are packed
    together; the backend's own figure if not given."""


@dataclass(frozen=True)
class ControllerConfig:
    """The force controller: the receding-horizon one, or a rival with a table of its own."""

    kind: str = "mpc"
    """Which controller, see ``pulsempc controllers``; the rivals read ``model``, ``observer``'s
    noise, the bounds on command and rate, and the table that is theirs."""
    horizon: Annotated[int, Ge(1), Le(512)] = 8
    """N, predicted steps."""
    control_horizon: Annotated[int, Ge(1), Le(512)] | None = None
    """N_u, free increments; N if not given."""
    decision: Literal["increment", "absolute"] = "increment"
    """Whether Theta multiplies increments, or absolute commands (eq. (10) to the letter)."""
    force_weight: Annotated[float, Gt(0)] = 1.0
    """delta, cost of a squared newton of force error."""
    increment_weight: Annotated[float, Gt(0)] = 0.003
    """lambda, cost of a squared m/s^2 of decision."""
    reference_time: Annotated[float, Ge(0)] = 0.02
    """T_ref, time constant with which the reference approaches the setpoint [s]; 0: at once."""
    model: ModelConfig = field(default_factory=ModelConfig)
    observer: ObserverConfig = field(default_factory=ObserverConfig)
    bounds: BoundsConfig = field(default_factory=BoundsConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)
    pi: PiConfig = field(default_factory=PiConfig)
    ilc: LearningConfig = field(default_factory=LearningConfig)
    aob: ActiveObserverConfig = field(default_factory=ActiveObserverConfig)
    paper_law: PaperLawConfig = field(default_factory=PaperLawConfig)
