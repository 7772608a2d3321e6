"""What types and ranges cannot say about a scenario: whether its values fit one another."""

import math
from dataclasses import is_dataclass
from typing import get_args

from plant.tissue import contradiction
from plant.viper import TOOL, VIPER_S650
from qpmpc.config import INFINITE, Band, Interval, PerAxis, SoftBoundName
from scenarios.config import AxesChange, Scenario, SetpointConfig
from scenarios.errors import ScenarioKeyError

_AXES = ("x", "y", "z")


def check_consistent(scenario: Scenario, source: str) -> None:
    """Check that the values of a scenario fit one another; ``source`` is what errors name.

    Raises:
        ScenarioKeyError: they do not.
    """
    _check_bounds(scenario, source)
    if scenario.controller.observer.disturbance == "beats" and scenario.motion.file is not None:
        raise ScenarioKeyError(
            source,
            "controller.observer.disturbance",
            "'beats' needs R peaks, and motion.file has none; take 'tracked'",
        )
    moves, horizon = scenario.controller.control_horizon, scenario.controller.horizon
    if moves is not None and moves > horizon:
        raise ScenarioKeyError(
            source, "controller.control_horizon", f"{moves} exceeds the horizon of {horizon}"
        )
    if len(set(scenario.axes)) != len(scenario.axes):
        raise ScenarioKeyError(source, "axes", f"names an axis twice: {list(scenario.axes)}")
    for axis in scenario.axes:
        low, high = band(scenario.controller.bounds.force, axis)
        if scenario.setpoint.file is not None:
            break  # held to them when it is read
        wished = [("setpoint", getattr(scenario.setpoint, axis))]
        if not scenario.bounds_steps:
            for i, step in enumerate(scenario.setpoint.steps):
                wished.append((f"setpoint.steps.{i}", getattr(step, axis)))
        for place, value in wished:
            if value is not None and not low <= value <= high:
                raise ScenarioKeyError(
                    source,
                    f"{place}.{axis}",
                    f"{value:g} N lies outside controller.bounds.force.{axis} = "
                    f"[{low:g}, {high:g}] N",
                )
    for place, timed in (
        ("setpoint.steps", scenario.setpoint.steps),
        ("bounds_steps", scenario.bounds_steps),
        ("motion.rate_steps", scenario.motion.rate_steps),
    ):
        times = [step.time for step in timed]
        if times != sorted(times):
            raise ScenarioKeyError(source, place, "must be in the order of their times")
    _check_protection(scenario, source)
    _check_one_setpoint(scenario, source)
    _check_imperfections(scenario, source)
    _check_contact(scenario, source)
    _check_approach(scenario, source)


def _check_contact(scenario: Scenario, source: str) -> None:
    """Check that the contact law has what it is given, and the beats that it follows."""
    contact = scenario.cell.contact
    found = contradiction(contact)
    if found is not None:
        raise ScenarioKeyError(source, f"cell.contact.{found[0]}", found[1])
    if contact.systolic_stiffening > 0 and scenario.motion.file is not None:
        raise ScenarioKeyError(
            source,
            "cell.contact.systolic_stiffening",
            "motion.file tells no beats; motion.beats or a generated motion does",
        )


def _check_approach(scenario: Scenario, source: str) -> None:
    """Check that the sensor can tell the pressing force that is wished for from none."""
    setpoint, least = scenario.setpoint, scenario.contact_found_above
    if not scenario.cell.contact.unilateral or not scenario.approach.enabled:
        return
    if "z" not in scenario.axes or setpoint.file is not None:
        return
    wished = [("setpoint.z", setpoint.z)]
    wished += [(f"setpoint.steps.{i}.z", step.z or 0.0) for i, step in enumerate(setpoint.steps)]
    for place, z in wished:
        if 0.0 < -z <= least:
            raise ScenarioKeyError(
                source,
                place,
                f"presses with {-z:g} N; contact is found above {least:.3g} N (twice "
                "approach.threshold): press harder, lower that, or set approach.enabled = false",
            )


def _check_one_setpoint(scenario: Scenario, source: str) -> None:
    """Refuse keys that a recorded or a live setpoint leaves without effect."""
    setpoint = scenario.setpoint
    if setpoint.live is not None:
        for key, given in (("steps", setpoint.steps), ("file", setpoint.file)):
            if given:
                raise ScenarioKeyError(source, f"setpoint.{key}", "no effect beside setpoint.live")
    if setpoint.file is None:
        return
    default = SetpointConfig()
    if setpoint.steps:
        raise ScenarioKeyError(source, "setpoint.steps", "no effect beside setpoint.file")
    for axis in scenario.axes:
        if getattr(setpoint, axis) != getattr(default, axis):
            raise ScenarioKeyError(source, f"setpoint.{axis}", "no effect beside setpoint.file")


def _check_imperfections(scenario: Scenario, source: str) -> None:
    """Check that what is wrong with the tool fits the tool there is."""
    flaws, place = scenario.cell.imperfections, "cell.imperfections"
    if scenario.cell.arm is not None:
        return  # told when the arm is read
    links, carried = len(VIPER_S650.link_mass.si) - 1, float(TOOL.effector.mass.si)
    if isinstance(flaws.inertia_error, tuple) and len(flaws.inertia_error) != links + 1:
        raise ScenarioKeyError(
            source,
            f"{place}.inertia_error",
            f"must be one value, or {links + 1}: one for each link and one for what the flange "
            f"carries, got {len(flaws.inertia_error)}",
        )
    if flaws.tip_mass > carried:
        raise ScenarioKeyError(
            source,
            f"{place}.tip_mass",
            f"{flaws.tip_mass:g} kg exceed the instrument's {carried:g} kg",
        )


def band(value: Band | AxesChange, axis: str) -> Interval:
    """Return the interval of one axis."""
    found: Interval = getattr(value, axis) if is_dataclass(value) else value
    return found


def _check_protection(scenario: Scenario, source: str) -> None:
    """Check that what is wished for does not trip the protection."""
    limit = scenario.cell.protection.force
    if not scenario.cell.protection.enabled:
        return
    wished = {axis: float(getattr(scenario.setpoint, axis)) for axis in _AXES}
    # Where bounds move a later setpoint may lie outside them, and the bound is what is held.
    steps = () if scenario.bounds_steps else scenario.setpoint.steps
    for place, step in [
        ("setpoint", scenario.setpoint),
        *((f"setpoint.steps.{i}", step) for i, step in enumerate(steps)),
    ]:
        changed = {axis: getattr(step, axis) for axis in _AXES}
        wished |= {axis: float(value) for axis, value in changed.items() if value is not None}
        size = math.hypot(*wished.values())
        if size >= limit:
            raise ScenarioKeyError(
                source, place, f"{size:g} N in all reach cell.protection.force = {limit:g} N"
            )


def _check_bounds(scenario: Scenario, source: str) -> None:
    """Check what the types cannot: that lower does not exceed upper, and rest is allowed."""
    bounds = scenario.controller.bounds
    placed: list[tuple[str, str, Band | AxesChange | None]] = [
        (f"controller.bounds.{name}", name, getattr(bounds, name))
        for name in ("command", "rate", "velocity", "force")
    ]
    for i, step in enumerate(scenario.bounds_steps):
        placed += [
            (f"bounds_steps.{i}.{name}", name, getattr(step, name))
            for name in ("velocity", "force")
        ]
    for place, name, value in placed:
        margin = getattr(bounds, f"{name}_margin", 0.0)
        if isinstance(value, PerAxis | AxesChange):
            for axis in _AXES:
                interval = band(value, axis)
                if interval is not None:
                    _check_interval(source, f"{place}.{axis}", name, interval, margin)
        elif value is not None:
            _check_interval(source, place, name, value, margin)
    cone, order = bounds.tangential, bounds.order
    if cone.limit < INFINITE and scenario.axes != _AXES:
        raise ScenarioKeyError(
            source,
            "controller.bounds.tangential",
            "needs force control on x, y and z, in this order",
        )
    if cone.friction > 0 and cone.limit == INFINITE:
        raise ScenarioKeyError(
            source,
            "controller.bounds.tangential.friction",
            "needs controller.bounds.tangential.limit, 0 for friction alone",
        )
    if sorted(order) != sorted(get_args(SoftBoundName)):
        names = ", ".join(get_args(SoftBoundName))
        raise ScenarioKeyError(
            source, "controller.bounds.order", f"must name each of {names} once, got {list(order)}"
        )


def _check_interval(source: str, place: str, name: str, interval: Interval, margin: float) -> None:
    low, high = interval
    at_rest = name != "force"
    if low > high:
        reason = f"lower {low:g} exceeds upper {high:g}"
    elif low == INFINITE or high == -INFINITE:
        reason = f"no number lies in [{low:g}, {high:g}]"
    elif at_rest and not low <= 0 <= high:
        reason = f"must contain 0, got [{low:g}, {high:g}]"
    elif low + margin > high - margin or (at_rest and not low + margin <= 0 <= high - margin):
        reason = f"a margin of {margin:g} leaves no room in it"
    else:
        return
    raise ScenarioKeyError(source, place, reason)
