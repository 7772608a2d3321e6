"""A tool led through tissue by hand, without arms: which force a contact law answers with."""

from types import SimpleNamespace

import numpy as np

from plant.config import ContactConfig
from plant.contact import Contact
from plant.memory import layout
from plant.viper import FloatArray


class Indentation:
    """One contact in a surface that does not turn, at rest at first."""

    def __init__(
        self, config: ContactConfig, start: FloatArray, step: float, factor: float = 1.0
    ) -> None:
        """Begin.

        Args:
            config: see there.
            start: of the tip from the undeformed surface, ``(3,)`` [m].
            step: between two instants [s].
            factor: by which the tissue is stiffer than its configuration says, now.
        """
        self._length, self._speed = np.zeros(15), np.zeros(15)
        site = SimpleNamespace(xmat=np.eye(3).ravel())
        block = np.zeros((), layout(6))
        block["timestep"] = step
        self.contact = Contact(
            block,
            SimpleNamespace(
                actuator_biasprm=np.zeros((15, 10)), actuator=lambda _: SimpleNamespace(id=12)
            ),
            SimpleNamespace(
                actuator_length=self._length, actuator_velocity=self._speed, site=lambda _: site
            ),
            config,
        )
        self._length[12:] = start
        self.contact.begin(factor)

    def go(self, place: FloatArray, velocity: FloatArray, factor: float = 1.0) -> FloatArray:
        """Return the force ``(3,)`` [N] that the tool exerts at the next instant.

        Args:
            place: of the tip from the undeformed surface, ``(3,)`` [m].
            velocity: of the tip relative to it, ``(3,)`` [m/s].
            factor: of the stiffness, then.
        """
        self._length[12:], self._speed[12:] = place, velocity
        self.contact.beat(factor, 0.0)
        self.contact.follow(1)
        force = np.empty(3)
        self.contact.force(force)
        return force


def indent(
    config: ContactConfig, path: FloatArray, step: float, factor: FloatArray | None = None
) -> FloatArray:
    """Return the force along a path of the tip from the undeformed surface, ``(n, 3)`` [N].

    Args:
        config: see there.
        path: ``(n, 3)`` [m], from rest.
        step: between its points [s].
        factor: by which the tissue is stiffer than its configuration says, ``(n,)``; 1 if not
            given.
    """
    path = np.asarray(path, dtype=np.float64)
    factor = np.ones(len(path)) if factor is None else factor
    velocity = np.gradient(path, step, axis=0)
    tool = Indentation(config, path[0], step, float(factor[0]))
    rows = zip(path, velocity, factor.tolist(), strict=True)
    return np.array([tool.go(*row) for row in rows])
