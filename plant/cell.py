"""The two-robot cell: MuJoCo physics, Robot_Heart's programme, Robot_Tool's inner loop, sensors."""

import ctypes
import math
from collections.abc import Sequence
from functools import cache
from typing import Literal

import mujoco
import numpy as np
import pinocchio as pin

from plant.arm_model import build_arm_model, viper_arm
from plant.chain import Arm
from plant.config import CellConfig, ContactConfig, ImperfectionConfig
from plant.contact import Contact
from plant.encoders import Encoders
from plant.errors import PlantError, UnstableSimulationError
from plant.flexibility import JointSprings, joint_springs
from plant.friction import StribeckFriction
from plant.inner_loop import InnerLoop
from plant.interface import JointSpace, Measurement, TissueMotion, Truth
from plant.memory import HEART_JOINTS, Memory, memory
from plant.mjcf import SERVO_STIFFNESS, cell_mjcf
from plant.own_arm import tool_arm
from plant.playback import Programme, programme
from plant.posture import reach
from plant.protection import Guard, close_brakes
from plant.sensors import ForceSensor
from plant.stepping import CompiledStepper, PythonStepper, Stepper
from plant.tip_mass import TipMass
from plant.tissue import contradiction, rest_displacement, sideways
from plant.transport import Transport
from plant.viper import HEART, VIPER_S650, FloatArray

Axis = Literal["x", "y", "z"]
_ABSURD = 1e4
"""Contact force that no run reaches that is still under control [N]."""
_AXES: tuple[Axis, ...] = ("x", "y", "z")


class Cell:
    """A `plant.interface.JointPlant`: the tool presses on the heart, the heart moves.

    Made in equilibrium: the tool at rest with the given force at the first sample of the motion,
    or with a gap between it and the tissue. One `measure` and one `apply` make a cycle. With the
    brakes closed the tool stays where it is, whatever is commanded: the paper's run without
    compensation. A guard watches every physics step, see `plant.protection`.
    """

    def __init__(
        self,
        config: CellConfig,
        motion: TissueMotion,
        *,
        force: FloatArray,
        seed: int,
        axes: Sequence[Axis] = _AXES,
        heart: Programme | None = None,
        library: ctypes.CDLL | None = None,
        tool: Arm | None = None,
        contraction: FloatArray | None = None,
        repeats: bool = False,
    ) -> None:
        """Build both arms and put them into contact.

        Args:
            config: see there.
            motion: of the tissue from home at the control instants.
            force: contact force to start with, ``(3,)`` [N]; with a gap, it counts only after
                `move_tool`.
            seed: of the sensor noise.
            axes: which axes follow the command, in the order of the columns of `joint_space`;
                the tool holds its position on the others.
            heart: the programme of `heart_programme` for this motion, where it is at hand.
            library: the physics loop, compiled from `plant.stepping.source_text` for as many
                joints as the tool has; the run is the same without it, and slower.
            tool: the arm of `plant.own_arm.tool_arm` for this configuration, where it is at hand.
            contraction: how far the heart is contracted at the control instants, ``(n,)``, from 0
                to 1; for ``contact.systolic_stiffening``, which needs it.
            repeats: whether the motion begins anew after its last sample, again and again.

        Raises:
            UnreachableMotionError: Robot_Heart cannot play the motion.
            ArmError: Robot_Tool is an arm of one's own that cannot be used.
            PlantError: the contact contradicts itself, or is unilateral and cannot carry the force,
                or stiffens with a beat that is not told; imperfections do not fit the arm; or the
                library is not what it should be.
        """
        self._load = np.asarray(force, dtype=np.float64)
        _check_start(config.contact, self._load)
        self._factor = _factor(config.contact, contraction, motion.position.shape[0])
        after = self._factor[:1] if repeats else self._factor[-1:]
        self._stiffens = np.diff(self._factor, append=after) / config.substeps
        self._scale = self._wanted_scale = 1.0
        self._repeats, self._substeps = repeats, config.substeps
        self.period = config.period
        self.cycles = motion.position.shape[0]
        """How many cycles the motion lasts."""
        self._heart = heart or heart_programme(config, motion)
        flaws, timestep = config.imperfections, config.period / config.substeps
        tool = self._arm = tool or tool_arm(config)
        self.joints = tool.joints
        """How many joints the tool has."""
        self._springs = _springs(flaws, tool, timestep)
        self.model = mujoco.MjModel.from_xml_string(
            cell_mjcf(
                _heart_arm(),
                tool,
                timestep=timestep,
                stiffness=config.contact.stiffness,
                damping=config.contact.damping,
                friction=flaws.friction,
                torque_lag=flaws.torque_lag,
                springs=self._springs,
            )
        )
        self.data = mujoco.MjData(self.model)
        share = flaws.friction * flaws.friction_compensation
        self._inner = InnerLoop(
            build_arm_model(tool, flaws.inertia_error),
            config.tool,
            coulomb=share * tool.coulomb,
            viscous=share * tool.viscous,
            lead=(flaws.delay + 0.5) * config.period + flaws.torque_lag,
            force_axes=np.array([_AXES.index(axis) for axis in axes]),
        )
        self._sensor = ForceSensor(config.sensor, config.period, np.random.SeedSequence([seed, 1]))
        self._limit = tool.torque_limit
        data = self.data
        block = memory(self.model, data, tool.joints)
        block["substeps"] = config.substeps
        self._peak = block["peak"]
        self._contact = Contact(block, self.model, data, config.contact)
        self._guard = Guard(
            config, block, (self.model, data), self._contact, (self._heart, tool), repeats=repeats
        )
        self._config = config.contact
        self._stepper = self._steps(library, block, flaws)
        # Views into MuJoCo's memory: looking them up costs as much as a small matrix product.
        self._own = own = slice(HEART_JOINTS, HEART_JOINTS + tool.joints)
        self._joints = data.qpos[: own.stop]
        self._q, self._qdot = data.qpos[own], data.qvel[own]
        self._motors = data.qpos[-tool.joints :]
        self._heart_ctrl, self._tool_ctrl = data.ctrl[:HEART_JOINTS], data.ctrl[own]
        self._surface = data.site("heart_surface").xpos
        self._force, self._read, self._tissue = np.zeros(3), np.zeros(3), np.zeros(3)
        self._angle = np.zeros(own.stop)
        self._torque, self._saturated = np.zeros(tool.joints), False
        self._joint_velocity = np.zeros(tool.joints)
        self._line: Transport[tuple[FloatArray, FloatArray]] = Transport(
            flaws.delay, flaws.delay_jitter, np.random.SeedSequence([seed, 2])
        )
        self._follows = np.isin(np.arange(3), [_AXES.index(axis) for axis in axes])
        self._protection = config.protection
        self._resolution = flaws.command_resolution
        if config.contact.gap > 0:
            self._place(motion.position[0] + [0.0, 0.0, config.contact.gap], np.zeros(3))
        else:
            pressed = rest_displacement(config.contact, self._load, self._factor[0])
            self._place(motion.position[0] + pressed, self._load)

    def close_brakes(self) -> None:
        """Lock the tool's joints where they are, and let the guard rest."""
        close_brakes(self.model, self.data, self.joints)
        self._guard.stand_down()

    def rest(self, force: FloatArray) -> FloatArray:
        """Return where the tool rests that presses with ``force (3,)`` [N] on the tissue at home.

        Displacement of its tip from home, ``(3,)`` [m], at the mean stiffness of the motion.
        """
        return rest_displacement(self._config, force, float(self._factor.mean()))

    def move_tool(self, displacement: FloatArray) -> None:
        """Put the tool elsewhere, at rest: its tip ``displacement (3,)`` [m] from home.

        The run starts anew. Robot_Heart leans against the force to start with, whatever the force
        in the new place. A unilateral contact touches as if it had done so at no lateral force.
        """
        self._place(np.asarray(displacement), self._load)

    def measure(self) -> Measurement:
        """Read force sensor and encoders; the physics has been brought up to this instant.

        Raises:
            UnstableSimulationError: force and arms have left what can be computed.
        """
        inner = self._inner
        inner.observe(self._encoders.angle, self._encoders.speed)
        self._contact.force(self._force)
        if not np.dot(self._force, self._force) < _ABSURD**2:  # NaN is not, either
            raise UnstableSimulationError(self._cycle * self.period)
        felt = self._force
        if self._tip_mass.mass:
            felt = felt + self._tip_mass.force()
        reading = self._sensor.read(felt)
        if not np.count_nonzero(np.isnan(reading)):
            self._read = reading  # the inner loop goes on with the last one there was
        self._tissue[:] = self._surface
        self._angle[:] = self._joints
        self._joint_velocity[:] = self._qdot
        self._touching = self._contact.touching
        self._peak_read = float(self._peak)
        return Measurement(
            self._cycle * self.period,
            reading.copy(),
            inner.position.copy(),
            inner.twist[:3].copy(),
        )

    def apply(self, command: FloatArray | None) -> None:
        """Run the inner loop once on the last measurement, then the physics for one period.

        Under protection a command that is not finite or beyond ``protection.command`` counts as
        none, and where none came the last one goes on until the heartbeat is missed for too long.
        After a trip commands have no effect.

        Raises:
            PlantError: the motion has ended; or, without protection, the command is not finite.
        """
        if self._cycle >= self.cycles and not self._repeats:
            raise PlantError(f"the motion ended after {self.cycles} cycles")
        guard, usable = self._guard, self._usable(command)
        guard.heard(usable)
        if usable:
            self._command[:] = command
            if self._resolution:
                self._command /= self._resolution
                np.rint(self._command, out=self._command)
                self._command *= self._resolution
        if guard.tripped:
            self._torque, self._saturated = self._tool_ctrl.copy(), False
        else:
            wanted = self._inner.torque(self._command, self._read)
            torque = np.minimum(np.maximum(wanted, -self._limit), self._limit)
            self._saturated = bool(np.count_nonzero(torque != wanted))
            self._torque = torque
            sent = torque, self._command * self._follows
            self._tool_ctrl[:], self._asked = self._line.carry(self._cycle, sent)
        guard.expect(self._cycle, self._asked)
        row = self._cycle % self.cycles
        np.add(self._heart.ctrl[row], self._lean, out=self._heart_ctrl)
        self._peak[()] = 0.0
        if self._contact.varies:
            self._stiffen(row)
        self._stepper.advance()
        guard.notice()
        self._cycle += 1

    def _stiffen(self, row: int) -> None:
        """Tell the contact the tissue's stiffness in the coming period."""
        scale, wanted, factor = self._scale, self._wanted_scale, float(self._factor[row])
        step = float(self._stiffens[row]) * wanted
        if wanted != scale:
            step += factor * (wanted - scale) / self._substeps
            self._scale = wanted
        self._contact.beat(factor * scale, step)

    def stiffen(self, scale: float) -> None:
        """Let the tissue be ``scale`` times as stiff as configured at the end of the next `apply`.

        It gets there linearly. The damping is left as it is.

        Raises:
            PlantError: the scale is not positive.
        """
        if not 0.0 < scale < math.inf:
            raise PlantError(f"the tissue cannot be {scale:g} times as stiff")
        self._contact.let_vary()
        self._wanted_scale = scale

    def silence(self, cycles: int) -> None:
        """Let the force sensor say nothing in the next ``cycles`` measurements."""
        self._sensor.silence(cycles)

    def follow(self, heart: Programme) -> None:
        """Let Robot_Heart follow another programme of the same length from the next `apply` on.

        Raises:
            PlantError: it has another length.
        """
        if heart.ctrl.shape != self._heart.ctrl.shape:
            raise PlantError(
                f"the programme has {len(heart.ctrl)} periods, the motion {self.cycles}"
            )
        self._heart = heart
        self._guard.follow(heart)

    def _steps(
        self, library: ctypes.CDLL | None, block: Memory, flaws: ImperfectionConfig
    ) -> Stepper:
        """Make what goes on by a period, with what is imperfect at every physics step."""
        data = self.data
        self._friction = StribeckFriction(
            block, data, self.model,
            coulomb=flaws.friction * self._arm.coulomb,
            excess=flaws.stribeck,
            velocity=flaws.stribeck_speed,
        )  # fmt: skip
        self._encoders = Encoders(block, data, flaws)
        effector = self._arm.effector
        carried = effector.inertia if effector is not None else None
        self._tip_mass = TipMass(
            block, self.model, data, flaws.tip_mass, carried.mass if carried else math.inf
        )
        if library:
            return CompiledStepper(library, block, self.model, data)
        between = [self._friction.renew] if self._friction.present else []
        between += [] if self._encoders.exact else [self._encoders.read]
        return PythonStepper(
            block, self.model, data, self._contact, self._guard,
            before=[self._tip_mass.remember] if flaws.tip_mass else [],
            between=between,
        )  # fmt: skip

    def _usable(self, command: FloatArray | None) -> bool:
        """Whether a command can be applied.

        Raises:
            PlantError: it is not finite, and nothing protects the cell.
        """
        if command is None:
            return False
        x, y, z = command.tolist()
        most = self._protection.command
        if self._protection.enabled:  # NaN is in no interval
            return bool(-most <= x <= most and -most <= y <= most and -most <= z <= most)
        if not math.isfinite(x + y + z):
            raise PlantError(f"command {command} at t = {self._cycle * self.period:.3f} s")
        return True

    def truth(self) -> Truth:
        """Return what is really there.

        Torque, saturation and trip are those of the last `apply`.
        """
        return Truth(
            self._force.copy(),
            self._tissue.copy(),
            self._torque,
            self._saturated,
            self._touching,
            self._joint_velocity.copy(),
            self._angle.copy(),
            self._peak_read,
            self._guard.trip,
        )

    def joint_space(self, force: FloatArray, previous: FloatArray) -> JointSpace:
        """Return what tool velocity, force and command mean for the joints, at the last `measure`.

        Args:
            force: contact force as it was measured, ``(3,)`` [N].
            previous: command that was applied last, ``(3,)`` [m/s^2].
        """
        return self._inner.joint_space(force, previous)

    def _place(self, displacement: FloatArray, load: FloatArray) -> None:
        """Set both arms to the start of the motion and the tool at rest at ``displacement``.

        Robot_Heart leans against ``load (3,)`` [N].
        """
        model, data = self.model, self.data
        self._cycle = 0
        mujoco.mj_resetData(model, data)
        heart = slice(HEART_JOINTS)
        data.qpos[heart], data.qvel[heart] = self._heart.q, self._heart.qdot
        self._q[:] = _displaced(self._arm, displacement)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        J = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, J, None, model.site("heart_surface").id)
        # The heart's servos lean against the force to start with, else they give way at once.
        self._lean = -(load @ J[:, heart]) / SERVO_STIFFNESS
        self._heart_ctrl[:] = self._heart.ctrl[0] + self._lean
        if self._springs is not None:
            self._motors[:] = self._q
        if self._friction.present:
            self._friction.renew()
        mujoco.mj_step1(model, data)
        self._contact.begin(float(self._factor[0]))
        # Torques that really hold the tool; the inner loop's own model may be wrong.
        self._inner.observe(self._q, self._qdot)
        self._contact.force(self._force)
        self._torque = data.qfrc_bias[self._own] + self._inner.J[:3].T @ self._force
        if self._springs is not None:
            self._motors += self._torque / self._springs.stiffness  # wound up by them
            mujoco.mj_step1(model, data)
        self._encoders.begin()
        self._tip_mass.begin()
        self._guard.begin()
        self._peak[()] = 0.0
        self.measure()
        self._inner.hold()
        self._tool_ctrl[:] = self._torque
        self._command, self._asked = np.zeros(3), np.zeros(3)
        self._line.begin((self._torque, self._asked))
        if model.na:
            data.act[:] = self._torque


def _springs(flaws: ImperfectionConfig, tool: Arm, timestep: float) -> JointSprings | None:
    if flaws.joint_frequency == 0:
        return None
    return joint_springs(
        tool, frequency=flaws.joint_frequency, damping=flaws.joint_damping, timestep=timestep
    )


def heart_programme(config: CellConfig, motion: TissueMotion) -> Programme:
    """Return Robot_Heart's programme for a motion, see `plant.playback.programme`."""
    return programme(
        _heart_arm(),
        build_arm_model(_heart_arm()),
        motion,
        period=config.period,
        friction=config.imperfections.friction,
    )


@cache
def _heart_arm() -> Arm:
    return viper_arm(VIPER_S650, HEART)


def _displaced(arm: Arm, displacement: FloatArray) -> FloatArray:
    """Return joint angles that bring the tip to a displacement from home, ``(n,)`` [rad].

    Raises:
        PlantError: none do, or they are out of range.
    """
    exact = build_arm_model(arm)
    data = exact.model.createData()
    pin.framesForwardKinematics(exact.model, data, arm.home)
    goal = pin.SE3(data.oMf[exact.tip])
    goal.translation = goal.translation + displacement
    q = reach(exact, data, goal, arm.home)
    if q is None or (q < arm.lower).any() or (q > arm.upper).any():
        x, y, z = (1e3 * displacement).tolist()
        raise PlantError(f"Robot_Tool cannot start {x:.1f}, {y:.1f}, {z:.1f} mm from its home")
    return q


def _check_start(contact: ContactConfig, force: FloatArray) -> None:
    found = contradiction(contact)
    if found is not None:
        raise PlantError(f"contact.{found[0]}: {found[1]}")
    x, y, z = force.tolist()
    grip = sideways(contact)
    if contact.unilateral and contact.gap == 0 and (z > 0 or math.hypot(x, y) > -grip * z):
        raise PlantError(
            f"a unilateral contact cannot start with a force of {x:g}, {y:g}, {z:g} N: it only "
            f"pushes, and carries sideways at most {grip:g} times what it carries downwards"
        )


def _factor(contact: ContactConfig, contraction: FloatArray | None, cycles: int) -> FloatArray:
    """By how much the tissue is stiffer at the control instants than at rest, ``(cycles,)``."""
    if contact.systolic_stiffening == 0:
        return np.ones(cycles)
    if contraction is None:
        raise PlantError("contact.systolic_stiffening: nothing is told of the heart's beats")
    contraction = np.asarray(contraction, dtype=np.float64)
    within = contraction.shape == (cycles,) and bool((contraction >= 0.0).all())
    if not (within and bool((contraction <= 1.0).all())):
        raise PlantError(f"contraction: must be {cycles} numbers from 0 to 1")
    return 1.0 + contact.systolic_stiffening * contraction
