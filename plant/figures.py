"""Every figure of the cell with its source, as the tables of ``docs/plant.md``.

    python -m plant.figures                   prints them
    python -m plant.figures docs/plant.md     writes them between the marks of that page

A test compares the page with what the code has, so that neither can go its own way.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import mujoco
import numpy as np

from plant.arm_model import effector_inertia, link_inertias, viper_arm
from plant.config import CellConfig
from plant.mjcf import SERVO_DAMPING, SERVO_STIFFNESS, cell_mjcf
from plant.sensors import SENSORS
from plant.tissue import GRIP
from plant.viper import CONTACT_POINT, HEART, TOOL, VIPER_S650, Quantity, Station

BEGIN = "<!-- figures: python -m plant.figures docs/plant.md writes what follows -->"
END = "<!-- end of figures -->"

_PAPER = "Dominici et al., IROS 2009"
_ESTIMATED = "*estimated*"
_NAMES = {
    "d1": "height of the shoulder axis (2) above the base",
    "a1": "offset of the shoulder axis from axis 1",
    "a2": "length of the upper arm",
    "a3": "offset of the forearm's axis (4) from the elbow's (3)",
    "d4": "length of the forearm, elbow to wrist centre",
    "d6": "wrist centre to flange",
    "joint_range": "range of joints 1 to 6",
    "joint_speed": "rated speed of joints 1 to 6",
    "coulomb_friction": "Coulomb friction",
    "viscous_friction": "viscous friction",
    "armature": "rotor inertia, seen at the joint",
    "torque_limit": "torque limit",
    "link_mass": "mass of the base and of links 1 to 6",
    "link_radius": "radius of the solids of base and links 1 to 6",
}
_LOOPS = {
    "velocity_damping": ("1/s", "the paper prints no value; " + _ESTIMATED),
    "orientation_stiffness": ("1/s^2", _ESTIMATED + ": 50 rad/s, far above the heart's motion"),
    "orientation_damping": ("1/s", _ESTIMATED + ": critical for the stiffness"),
    "position_stiffness": ("1/s^2", _ESTIMATED + ": as for the orientation"),
    "position_damping": ("1/s", _ESTIMATED + ": as for the orientation"),
    "posture_stiffness": ("1/s^2", _ESTIMATED + ": 10 rad/s, below what the tip does"),
    "posture_damping": ("1/s", _ESTIMATED + ": critical for the stiffness"),
    "friction_velocity": ("rad/s", _ESTIMATED),
}
_TISSUE = "foam and silicone phantoms lie at 300 to 3000 N/m, myocardium at 200 to 1000 N/m"


@dataclass(frozen=True)
class Figure:
    """One row."""

    name: str
    value: str
    unit: str
    source: str


_LAWS = {
    "relaxation": ("1", _ESTIMATED),
    "relaxation_time": ("s", _ESTIMATED),
    "exponent": ("1", "Hertz, a round tip on a half-space"),
    "reference_depth": ("m", "chosen: there a round tip presses with the paper's 10 N"),
    "dissipation": ("s/m", _ESTIMATED + ": small, as the default controller bears little damping"),
    "static": ("1", _ESTIMATED + ": a tip with teeth; the paper's setpoint needs 0.22"),
    "kinetic": ("1", _ESTIMATED),
    "stribeck_velocity": ("m/s", _ESTIMATED),
    "break_away": ("1", _ESTIMATED),
    "systolic_stiffening": (
        "1",
        "off; H. J. Vos et al., Ultrasound Med. Biol. 43, 2017: shear waves in pigs' hearts of 2.2 "
        "and 4.2 m/s as systole begins and ends, a modulus 3.6 times as large, would be 2.6",
    ),
}
"""Keys of the contact laws."""


def tables() -> dict[str, list[Figure]]:
    """Return the rows of each table, by its heading."""
    spec = VIPER_S650
    return {
        "The Viper s650, both arms": [
            _quantity(_NAMES[f.name], getattr(spec, f.name)) for f in fields(spec)
        ],
        "Links, from their masses and solids": list(_links()),
        "Where the arms stand": [
            _quantity("contact point at home", CONTACT_POINT),
            *_station(HEART),
            *_station(TOOL),
        ],
        "Loops": list(_loops()),
        "Contact and sensors": list(_contact()),
        "Physics": list(_physics()),
    }


def markdown() -> str:
    """Return the tables as Markdown."""
    parts = []
    for heading, rows in tables().items():
        lines = [f"### {heading}", "", "| figure | value | unit | source |", "|---|---|---|---|"]
        lines += [f"| {r.name} | {r.value} | {r.unit} | {r.source} |" for r in rows]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _quantity(name: str, quantity: Quantity) -> Figure:
    source = quantity.source
    if quantity.estimated:
        source = _ESTIMATED + ": " + source.removeprefix("estimate: ")
    return Figure(name, _text(quantity.value), quantity.unit, source)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        pairs = bool(value) and isinstance(value[0], tuple)
        return ", ".join(f"{v[0]:g} to {v[1]:g}" if pairs else f"{v:g}" for v in value)
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def _links() -> Iterable[Figure]:
    inertias = [*link_inertias(VIPER_S650)[1:], *(effector_inertia(s.effector) for s in _STATIONS)]
    names = [*(f"link {i}" for i in range(1, 7)), *(s.effector.kind for s in _STATIONS)]
    for name, inertia in zip(names, inertias, strict=True):
        mm = ", ".join(f"{1e3 * x + 0.0:.1f}" for x in inertia.com)
        principal = ", ".join(f"{x:.2g}" for x in np.linalg.eigvalsh(inertia.tensor))
        source = "follows from mass and solids"
        yield Figure(f"{name}: centre of mass", mm, "mm", source)
        yield Figure(f"{name}: principal inertias", principal, "kg m^2", source)


_STATIONS = (HEART, TOOL)


def _station(station: Station) -> Iterable[Figure]:
    arm = {"heart": "Robot_Heart", "tool": "Robot_Tool"}[station.name]
    carried = station.effector
    yield _quantity(f"{arm}: base on the x axis", station.base_x)
    yield _quantity(f"{arm}: turn of the base about the vertical", station.base_yaw)
    yield _quantity(f"{arm}: q2 + q3 + q5 at home", carried.pitch)
    yield _quantity(f"{arm}: mass of the {carried.kind}", carried.mass)
    yield _quantity(f"{arm}: contact point along the flange's z axis", carried.reach)
    yield _quantity(f"{arm}: contact point along the flange's -x axis", carried.rise)
    home = np.rad2deg(viper_arm(VIPER_S650, station).home)
    angles = ", ".join(f"{angle + 0.0:.1f}" for angle in home)
    yield Figure(f"{arm}: joints at home", angles, "deg", "follows from the rest")


def _loops() -> Iterable[Figure]:
    tool = CellConfig().tool
    servo = _ESTIMATED + ": less than 0.5 mm of give under 10 N"
    yield Figure(
        "Robot_Heart: position gain of each servo", _text(SERVO_STIFFNESS), "N m/rad", servo
    )
    yield Figure("Robot_Heart: velocity gain", _text(SERVO_DAMPING), "N m s/rad", servo)
    for f in fields(tool):
        unit, source = _LOOPS[f.name]
        yield Figure(f"`cell.tool.{f.name}`", _text(getattr(tool, f.name)), unit, source)


def _contact() -> Iterable[Figure]:
    contact = CellConfig().contact
    stiffness = _ESTIMATED + ", the paper prints none: " + _TISSUE
    yield Figure("`cell.contact.stiffness`", _text(contact.stiffness), "N/m", stiffness)
    yield Figure("`cell.contact.damping`", _text(contact.damping), "N s/m", "the paper's model")
    grip = _ESTIMATED + f": well above the 0.22 of the setpoint in {_PAPER}"
    yield Figure("lateral force of a contact that only pushes", _text(GRIP), "of the normal", grip)
    for name, (unit, source) in _LAWS.items():
        record = contact.bristles if hasattr(contact.bristles, name) else contact
        key = f"bristles.{name}" if record is contact.bristles else name
        yield Figure(f"`cell.contact.{key}`", _text(getattr(record, name)), unit, source)
    for model, sensor in SENSORS.items():
        yield _quantity(f"`{model}`: step of the reading", sensor.resolution)
        yield _quantity(f"`{model}`: white noise, standard deviation", sensor.noise)


def _physics() -> Iterable[Figure]:
    config = CellConfig()
    heart, tool = (viper_arm(VIPER_S650, station) for station in _STATIONS)
    model = mujoco.MjModel.from_xml_string(
        cell_mjcf(
            heart, tool, timestep=config.period / config.substeps,
            stiffness=config.contact.stiffness, damping=config.contact.damping,
            friction=1.0, torque_lag=0.0,
        )
    )  # fmt: skip
    option = model.opt
    integrator = mujoco.mjtIntegrator(option.integrator).name.removeprefix("mjINT_").lower()
    solver = mujoco.mjtSolver(option.solver).name.removeprefix("mjSOL_").lower()
    chosen, default = "chosen", "MuJoCo's default"
    yield Figure("`cell.period`", _text(config.period), "s", _PAPER)
    yield Figure("`cell.substeps`", _text(config.substeps), "1", "chosen: a physics step of 125 µs")
    yield Figure("integrator", integrator, "", chosen + ": damping and servos are implicit")
    yield Figure("constraint solver", solver, "", chosen + ": it has joint friction and brakes")
    yield Figure("iterations, tolerance", f"{option.iterations}, {option.tolerance:g}", "", default)
    friction = ", ".join(f"{x:g}" for x in model.dof_solref[0])
    yield Figure(
        "joint friction: time constant, ratio", friction, "s, 1", chosen + ": the shortest"
    )
    impedance = ", ".join(f"{x:g}" for x in model.dof_solimp[0][:3])
    yield Figure("joint friction: impedance", impedance, "", chosen + ": least creep at rest")
    gravity = ", ".join(f"{x:g}" for x in option.gravity)
    yield Figure("gravity", gravity, "m/s^2", default)


def main(arguments: Sequence[str]) -> None:
    """Print the tables, or write them into a page between its marks."""
    if not arguments:
        print(markdown(), end="")
        return
    page = Path(arguments[0])
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n\n{markdown()}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
