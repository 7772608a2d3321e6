"""What can be set on the robot cell: frozen records, SI units, defaults of the realistic cell."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt, MinLen

SensorModel = Literal["ideal", "nano17", "mini45"]
ContactLaw = Literal["spring", "kelvin_voigt", "standard_linear_solid", "hunt_crossley"]
PerJoint = Annotated[float, Ge(0)] | tuple[Annotated[float, Ge(0)], ...]
"""One number for all joints, or one for each, from the base on."""


@dataclass(frozen=True)
class BristleConfig:
    """Friction of the bristles that the tool bends, under the law ``hunt_crossley``."""

    static: Annotated[float, Gt(0), Le(10)] = 0.6
    """Coefficient of friction at rest [-]. Estimated, for a tip with teeth: wet tissue on smooth
    steel has 0.05 to 0.3, and slips at the paper's setpoint, which needs 0.22."""
    kinetic: Annotated[float, Gt(0), Le(10)] = 0.5
    """Coefficient of friction of a fast slide [-]; estimated."""
    stribeck_velocity: Annotated[float, Gt(0), Le(10)] = 0.01
    """Speed at which the coefficient is half way from static to kinetic [m/s]; estimated."""
    break_away: Annotated[float, Ge(0), Le(1)] = 0.7
    """Share of the largest deflection up to which bristles only bend, and none of them slips [-];
    estimated."""


@dataclass(frozen=True)
class ContactConfig:
    """The tissue between the two arms: which force law it follows, see ``docs/plant.md``."""

    law: ContactLaw = "kelvin_voigt"
    """``spring``; ``kelvin_voigt``, a damper beside the spring, which with ``damping`` 0 is the
    spring; ``standard_linear_solid``, whose stress relaxes; ``hunt_crossley``, a surface that
    dents, with bristle friction."""
    stiffness: Annotated[float, Gt(0), Le(1e6)] = 2500.0
    """Stiffness of the tissue at rest between beats, the same on every axis [N/m]: of a fast
    deformation under ``standard_linear_solid``; of the normal force at ``reference_depth``, and of
    the bristles, under ``hunt_crossley``."""
    damping: Annotated[float, Ge(0)] = 0.0
    """Damping in parallel to the spring, under ``hunt_crossley`` to the bristles [N s/m]; neither
    ``spring`` nor ``standard_linear_solid`` has one."""
    relaxation: Annotated[float, Ge(0), Lt(1)] = 0.3
    """``standard_linear_solid``: share of the stiffness that relaxes [-]; estimated."""
    relaxation_time: Annotated[float, Gt(0), Le(1e3)] = 0.2
    """``standard_linear_solid``: time constant with which it does [s]; estimated."""
    exponent: Annotated[float, Ge(1), Le(4)] = 1.5
    """``hunt_crossley``: exponent of the depth [-]; 1.5 for a round tip, after Hertz."""
    reference_depth: Annotated[float, Gt(0), Le(0.1)] = 0.006
    """``hunt_crossley``: depth at which ``stiffness`` is the slope of the force [m]; there the
    force is stiffness x depth / exponent, 10 N by default."""
    dissipation: Annotated[float, Ge(0), Le(100)] = 0.02
    """``hunt_crossley``: lambda / K, the damping per newton of elastic force [s/m]; slow impacts
    have a coefficient of restitution of 1 - 2/3 x dissipation x speed. Estimated."""
    bristles: BristleConfig = field(default_factory=BristleConfig)
    systolic_stiffening: Annotated[float, Ge(0), Le(20)] = 0.0
    """How much stiffer the tissue is at the height of systole, relative to ``stiffness`` [-]. The
    motion must have beats."""
    unilateral: bool = False
    """Whether the tissue can only push: the tool lifts off, and sideways forces last only while
    they touch, from where they touched, with at most as much force as the tool presses with.
    ``hunt_crossley`` is of this kind only."""
    gap: Annotated[float, Ge(0), Le(0.1)] = 0.0
    """Distance between tool and tissue at the start, for a unilateral contact; 0: start in contact
    with the given force [m]."""


@dataclass(frozen=True)
class SensorConfig:
    """Force sensor in the instrument."""

    model: SensorModel = "nano17"
    """``ideal`` (no noise, no quantisation), ``nano17`` or ``mini45`` (ATI)."""
    bias_drift: Annotated[float, Ge(0), Le(10)] = 0.0
    """Random walk of each axis' zero: standard deviation of its change in one second [N]."""
    spike_rate: Annotated[float, Ge(0), Le(200)] = 0.0
    """Mean number of single wrong readings on each axis in a second [1/s]."""
    spike_size: Annotated[float, Gt(0), Le(1e3)] = 5.0
    """How far such a reading is off, to either side [N]."""
    dropout_rate: Annotated[float, Ge(0), Le(200)] = 0.0
    """Mean number of times in a second that the sensor stops telling anything [1/s]."""
    dropout_time: Annotated[float, Gt(0), Le(10)] = 0.02
    """How long it is silent then: the reading is NaN on every axis [s]."""


@dataclass(frozen=True)
class ToolConfig:
    """Inner loop of Robot_Tool: computed torque to a unit mass, velocity damping, orientation."""

    velocity_damping: Annotated[float, Ge(0), Le(1e3)] = 20.0
    """K2 of the paper: gain of the velocity loop closed around the unit mass [1/s]."""
    orientation_stiffness: Annotated[float, Gt(0), Le(1e6)] = 2500.0
    """Proportional gain that holds the orientation of the instrument [1/s^2]."""
    orientation_damping: Annotated[float, Gt(0)] = 100.0
    """Derivative gain that holds the orientation of the instrument [1/s]."""
    position_stiffness: Annotated[float, Gt(0), Le(1e6)] = 2500.0
    """Proportional gain that holds the axes that are not force-controlled [1/s^2]."""
    position_damping: Annotated[float, Gt(0)] = 100.0
    """Derivative gain that holds the axes that are not force-controlled [1/s]."""
    posture_stiffness: Annotated[float, Ge(0), Le(1e6)] = 100.0
    """Proportional gain that brings an arm of more than six joints back to the posture in which it
    began, as far as its tip is not moved by it [1/s^2]."""
    posture_damping: Annotated[float, Gt(0), Le(1e4)] = 20.0
    """Derivative gain of the same [1/s]."""
    friction_velocity: Annotated[float, Gt(0)] = 0.02
    """Joint speed over which the compensation of Coulomb friction changes sign [rad/s]."""


RelativeError = Annotated[float, Gt(-1)]
"""Of a model: 0.2 is 20 % too large [-]."""


@dataclass(frozen=True)
class ArmConfig:
    """An arm of one's own in the place of Robot_Tool, see ``docs/plant.md``.

    What a file has stands in it; a key given here counts instead. For a joint that slides read m, N
    for rad, N m.
    """

    file: Annotated[str, MinLen(1)]
    """MJCF or URDF file; in a scenario, relative to the scenario's own place."""
    tip: Annotated[str, MinLen(1)]
    """Site or body (in URDF: link) that carries the instrument, along its z axis."""
    instrument: bool = True
    """Whether the cell's instrument is mounted there; false: the tip is that of an instrument which
    the file has."""
    home: tuple[float, ...] | None = None
    """Roughly where the joints stand when it presses straight down [rad]; if not given, the file's
    first keyframe, else it is searched for."""
    base: tuple[float, float, float] | None = None
    """Where it stands [m]; if not given, upright on the floor, as far away as its home asks for."""
    base_yaw: float | None = None
    """Turn of its base about the vertical [rad]; if not given, its x axis points to the tissue."""
    joint_range: tuple[tuple[float, float], ...] | None = None
    """Least and greatest angle of each joint [rad]."""
    joint_speed: PerJoint | None = None
    """Rated speed of the joints [rad/s]."""
    torque_limit: PerJoint | None = None
    """Torque at which the motors saturate [N m]."""
    armature: PerJoint | None = None
    """Rotor inertia, seen at the joint [kg m^2]; 0: none."""
    coulomb_friction: PerJoint | None = None
    """Coulomb friction of the joints [N m]; 0: none."""
    viscous_friction: PerJoint | None = None
    """Viscous friction of the joints [N m s/rad]; 0: none."""


@dataclass(frozen=True)
class ImperfectionConfig:
    """What separates Robot_Tool from its model, see ``docs/plant.md``."""

    inertia_error: RelativeError | tuple[RelativeError, ...] = 0.2
    """Relative error of the masses, inertias and armatures in the model of the tool: one for all,
    or one for each link and, as the last, for what the flange carries; the armature of a joint goes
    with its link [-]."""
    friction: Annotated[float, Ge(0)] = 1.0
    """Joint friction of both arms as a multiple of the identified one [-]."""
    friction_compensation: Annotated[float, Ge(0), Le(1)] = 0.8
    """Share of the joint friction that the tool's inner loop compensates; it knows nothing of
    Stribeck friction [-]."""
    stribeck: Annotated[float, Ge(0), Le(5)] = 0.0
    """Stribeck friction of the tool: by which share of the Coulomb friction the friction at rest
    exceeds it [-]."""
    stribeck_speed: Annotated[float, Gt(0), Le(10)] = 0.05
    """Joint speed at which half of that excess is left [rad/s]."""
    torque_lag: Annotated[float, Ge(0), Lt(0.1)] = 0.001
    """Time constant of the first-order lag from torque command to torque [s]."""
    torque_limit: Annotated[float, Gt(0), Le(1)] = 1.0
    """Torque at which the tool's motors saturate, as a share of the rated one [-]."""
    joint_frequency: Annotated[float, Ge(0), Le(200)] = 0.0
    """Frequency of the first mode of the tool's flexible joints at home, with the motors held;
    0: rigid joints [Hz]."""
    joint_damping: Annotated[float, Ge(0), Le(1)] = 0.05
    """Damping ratio of that mode [-]."""
    encoder_resolution: Annotated[float, Ge(0), Le(0.1)] = 0.0
    """The tool's joint angles are read as whole multiples of this, speeds as their difference over
    a physics step; 0: as they are [rad]."""
    velocity_filter: Annotated[float, Ge(0), Lt(0.1)] = 0.0
    """Time constant of the first-order filter behind that difference; 0: no filter [s]."""
    delay: Annotated[int, Ge(0), Le(20)] = 1
    """Whole control cycles between a command and the torque that it causes [cycles]."""
    delay_jitter: Annotated[float, Ge(0), Le(0.9)] = 0.0
    """Probability that a command takes one cycle more than that; two more: its square, and so on.
    None overtakes another; of two that arrive together the later one counts [-]."""
    command_resolution: Annotated[float, Ge(0), Lt(1)] = 0.001
    """Commands reach the inner loop as whole multiples of this [m/s^2]; 0: as they are."""
    tip_mass: Annotated[float, Ge(0), Le(10)] = 0.0
    """Part of the instrument's mass that is beyond the force sensor: its inertial force and the
    change of its weight are read as contact force [kg]."""


@dataclass(frozen=True)
class ProtectionConfig:
    """Limits of the guard that watches the cell at every physics step, apart from the controller.

    Estimated, where nothing else is said: two to three times what the shipped scenarios reach.
    """

    enabled: bool = True
    """Whether it is there."""
    joint_speed: Annotated[float, Gt(0), Le(1)] = 0.5
    """Speed of the tool's joints, as a share of the rated one [-]."""
    joint_margin: Annotated[float, Ge(0), Le(0.3)] = 0.035
    """How far before the end of its range a joint must be able to stop [rad]."""
    tip_speed: Annotated[float, Gt(0), Le(2)] = 0.5
    """Speed of the tool's tip [m/s]."""
    tracking_velocity: Annotated[float, Gt(0)] = 0.4
    """Difference of the tip's velocity from the one that the commands ask for [m/s]."""
    tracking_orientation: Annotated[float, Gt(0), Le(3)] = 0.05
    """Angle between the instrument and its orientation at the start [rad]."""
    tracking_heart: Annotated[float, Gt(0)] = 0.01
    """Difference of Robot_Heart's joints from their programme [rad]."""
    force: Annotated[float, Gt(0)] = 30.0
    """Magnitude of the contact force [N]."""
    heartbeat: Annotated[int, Ge(0)] = 5
    """Periods in a row that may pass without a command that can be used [cycles]."""
    command: Annotated[float, Gt(0), Le(1e4)] = 200.0
    """Largest command on any axis that can be used; beyond it counts as none [m/s^2]."""
    retraction: Annotated[float, Ge(0), Le(0.1)] = 0.03
    """Distance from the tissue's surface to which the tool is taken away after a trip [m]."""
    retraction_speed: Annotated[float, Gt(0), Le(0.5)] = 0.25
    """Speed at which it is taken away [m/s]; by default the reduced speed of ISO 10218-1."""


@dataclass(frozen=True)
class CellConfig:
    """The two-robot cell."""

    period: Annotated[float, Gt(0), Le(0.1)] = 0.001
    """Control period [s]."""
    substeps: Annotated[int, Ge(1), Le(1000)] = 8
    """Physics steps in one control period [-]."""
    arm: ArmConfig | None = None
    """Robot_Tool; None: a Viper, as Robot_Heart is."""
    contact: ContactConfig = field(default_factory=ContactConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    tool: ToolConfig = field(default_factory=ToolConfig)
    imperfections: ImperfectionConfig = field(default_factory=ImperfectionConfig)
    protection: ProtectionConfig = field(default_factory=ProtectionConfig)
