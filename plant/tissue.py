"""What a contact law means at rest and at its worst: functions of the configuration alone."""

import math

import numpy as np

from plant.config import ContactConfig, ContactLaw
from plant.viper import FloatArray

GRIP = 1.0
"""Largest lateral force that a unilateral contact without bristles carries, relative to its normal
force [-]: chosen well above the 0.22 of the paper's setpoint, so that the tool slips only when it
hardly presses."""

_OWN: dict[str, tuple[ContactLaw, ...]] = {
    "damping": ("kelvin_voigt", "hunt_crossley"),
    "relaxation": ("standard_linear_solid",),
    "relaxation_time": ("standard_linear_solid",),
    "exponent": ("hunt_crossley",),
    "reference_depth": ("hunt_crossley",),
    "dissipation": ("hunt_crossley",),
    "bristles": ("hunt_crossley",),
}
"""Keys that only some laws have."""


def contradiction(contact: ContactConfig) -> tuple[str, str] | None:
    """Return what does not fit in a configuration, as key and reason; None where all does."""
    default = ContactConfig()
    for key, laws in _OWN.items():
        if contact.law not in laws and getattr(contact, key) != getattr(default, key):
            return key, f"no effect under cell.contact.law = {contact.law!r}; {_or(laws)} has it"
    if contact.law == "hunt_crossley" and not contact.unilateral:
        return "law", "'hunt_crossley' only pushes: needs cell.contact.unilateral = true"
    if contact.bristles.kinetic > contact.bristles.static:
        return (
            "bristles.kinetic",
            f"{contact.bristles.kinetic:g} exceeds cell.contact.bristles.static = "
            f"{contact.bristles.static:g}",
        )
    if contact.gap > 0 and not contact.unilateral:
        return "gap", "needs cell.contact.unilateral = true"
    return None


def power_coefficient(contact: ContactConfig) -> float:
    """Return the K of K depth^n whose slope at the reference depth is the stiffness [N/m^n]."""
    n = contact.exponent
    return float(contact.stiffness * contact.reference_depth ** (1.0 - n) / n)


def sideways(contact: ContactConfig) -> float:
    """Return the largest lateral force that can be held at rest, relative to the normal one [-]."""
    return contact.bristles.static if contact.law == "hunt_crossley" else GRIP


def rest_displacement(contact: ContactConfig, force: FloatArray, factor: float) -> FloatArray:
    """Return where a tool rests that presses with a force.

    Args:
        contact: see there.
        force: that the tool exerts, ``(3,)`` [N]; where the contact only pushes, z is negative.
        factor: by which the tissue is stiffer than its configuration says.

    Returns:
        Displacement of the tip from the undeformed surface, ``(3,)`` [m].
    """
    relaxed = contact.relaxation if contact.law == "standard_linear_solid" else 0.0
    displacement = np.asarray(force / ((1.0 - relaxed) * contact.stiffness * factor))
    if contact.law == "hunt_crossley":
        pressure = max(-float(force[2]), 0.0) / (power_coefficient(contact) * factor)
        displacement[2] = -(pressure ** (1.0 / contact.exponent))
    return displacement


def worst_force(contact: ContactConfig, force: float, way: float, speed: float) -> float:
    """Return the largest force that a contact can reach [N].

    Args:
        contact: see there.
        force: largest that has been seen [N].
        way: by which tool and tissue come closer after that [m].
        speed: largest at which they do [m/s].
    """
    factor = 1.0 + contact.systolic_stiffening
    stiffness, force = contact.stiffness * factor, force * factor
    linear = force + stiffness * way + contact.damping * speed
    if contact.law != "hunt_crossley":
        return linear
    # As long as it goes deeper, what has been seen is at least the elastic force there.
    K, n = power_coefficient(contact) * factor, contact.exponent
    deepest = (force / K) ** (1.0 / n) + way
    normal = K * deepest**n * (1.0 + contact.dissipation * speed)
    return math.hypot(normal, min(contact.bristles.static * normal, linear))


def _or(laws: tuple[str, ...]) -> str:
    return " or ".join(repr(law) for law in laws)
