"""Contact laws against mathematics: energy, momentum, exact solutions, no jump, no pull."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from plant import (
    BristleConfig,
    Cell,
    CellConfig,
    ContactConfig,
    ImperfectionConfig,
    Indentation,
    PlantError,
    ProtectionConfig,
    SensorConfig,
    force_cap,
    indent,
)
from plant.tissue import GRIP, contradiction, power_coefficient, rest_displacement
from scenarios.physics import physics_loop

from . import hostile

STEP = 1.25e-4
LAWS = {
    "spring": ContactConfig(law="spring"),
    "spring, pushing": ContactConfig(law="spring", unilateral=True),
    "kelvin_voigt": ContactConfig(damping=8.0),
    "kelvin_voigt, pushing": ContactConfig(damping=8.0, unilateral=True),
    "standard_linear_solid": ContactConfig(
        law="standard_linear_solid", relaxation=0.5, relaxation_time=0.03
    ),
    "standard_linear_solid, pushing": ContactConfig(
        law="standard_linear_solid", relaxation=0.5, relaxation_time=0.03, unilateral=True
    ),
    "hunt_crossley": ContactConfig(
        law="hunt_crossley", unilateral=True, dissipation=0.5, damping=3.0
    ),
    "hunt_crossley, slippery": ContactConfig(
        law="hunt_crossley",
        unilateral=True,
        exponent=2.2,
        dissipation=0.1,
        bristles=BristleConfig(static=0.3, kinetic=0.1, break_away=0.4, stribeck_velocity=0.02),
    ),
}
PUSHING = {name: law for name, law in LAWS.items() if law.unilateral}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
every_pushing = pytest.mark.parametrize("law", PUSHING.values(), ids=PUSHING.keys())


def journey(seed: int, n: int, *, size: float = 1e-3, above: float = 1e-5) -> np.ndarray:
    """A closed path from just above the surface and back, ``(n + 1, 3)``: a few harmonics."""
    rng = np.random.default_rng(seed)
    t = 2.0 * np.pi * np.arange(n + 1)[:, None] / n
    path = sum(
        a * np.sin(i * t) + b * (np.cos(i * t) - 1.0)
        for i, (a, b) in enumerate(zip(*rng.normal(0.0, size, (2, 6, 3)), strict=True), start=1)
    )
    return path + np.array([0.0, 0.0, above])


def work(force: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Energy that the tool has put in up to each point but the first, by brute force."""
    return np.cumsum(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0), axis=1))


def stored(law: ContactConfig, depth: np.ndarray, factor: np.ndarray | float = 1.0) -> np.ndarray:
    """Least energy that the tissue must hold at a depth at which it has been forever."""
    if law.law == "hunt_crossley":
        n = law.exponent
        return factor * power_coefficient(law) * np.maximum(depth, 0.0) ** (n + 1.0) / (n + 1.0)
    return 0.5 * factor * law.stiffness * np.maximum(depth, 0.0) ** 2


# --- energy --------------------------------------------------------------------------------------


@every_law
@pytest.mark.parametrize("seed", range(3))
def test_no_law_gives_energy_away(law, seed):
    """What has come back never exceeds what was put in, at any time, over three equal rounds."""
    n, rounds = 3000, 3
    path = journey(seed, n)
    path = np.vstack([path[:1], *[path[1:]] * rounds])
    if not law.unilateral:
        path -= path[0]  # bonded where they meet: no force, nothing stored at the start
    done = work(indent(law, path, 2e-4), path)
    slack = 8e-5 * np.abs(np.diff(done)).sum()
    assert done.min() > -slack
    ends = done[n - 1 :: n]
    if law.law == "spring" and not law.unilateral:
        assert np.abs(ends).max() < slack  # it conserves
        np.testing.assert_allclose(done, 0.5 * law.stiffness * np.sum(path[1:] ** 2, 1), atol=1e-6)
    else:
        assert (np.diff(ends) > -slack).all()
        assert ends[-1] > 1e-4
    assert np.abs(np.diff(done)).sum() > 1e-3


@settings(max_examples=40, deadline=None)
@given(
    name=st.sampled_from(sorted(PUSHING)),
    seed=st.integers(0, 10**6),
    size=st.floats(1e-4, 4e-3),
    stiffness=st.floats(200.0, 5000.0),
    damping=st.floats(0.0, 20.0),
)
def test_whatever_is_set_nothing_pulls_and_no_energy_comes_out(
    name, seed, size, stiffness, damping
):
    law = replace(LAWS[name], stiffness=stiffness)
    if law.law in ("kelvin_voigt", "hunt_crossley"):
        law = replace(law, damping=damping)
    if law.law == "hunt_crossley":
        law = replace(law, dissipation=damping)
    path = journey(seed, 1500, size=size)
    force = indent(law, path, 2e-4)
    assert (force[:, 2] <= 0.0).all()
    grip = law.bristles.static if law.law == "hunt_crossley" else GRIP
    assert (np.hypot(*force[:, :2].T) <= grip * -force[:, 2] * (1.0 + 1e-9) + 1e-12).all()
    done = work(force, path)
    assert done.min() > -4e-4 * np.abs(np.diff(done)).sum() - 1e-12


@every_law
def test_a_stiffness_that_varies_does_exactly_the_work_of_the_heart(law):
    """Tool's work plus the heart's, dK/dt/K times what is stored, is stored or lost, never more.

    The spring's stored energy is known, so for it the sum holds to the letter.
    """
    n = 5000
    t = np.linspace(0.0, 1.0, n + 1)
    depth = 1e-3 + 5e-4 * np.sin(2 * np.pi * 3 * t)
    path = np.column_stack([np.zeros((n + 1, 2)), -depth])
    factor = 1.0 + 0.8 * np.sin(np.pi * t * 5) ** 2
    law = replace(law, systolic_stiffening=1.0)
    force = indent(law, path, 2e-4, factor)
    tools = work(force, path)
    held = stored(law, depth, 1.0)
    hearts = np.cumsum(0.5 * (held[1:] + held[:-1]) * np.diff(factor))
    change = factor[1:] * held[1:] - factor[0] * held[0]
    lost = tools + hearts - change
    scale = np.abs(np.diff(tools)).sum()
    assert np.abs(hearts).max() > 0.05 * scale
    if law.law == "spring":
        assert np.abs(lost).max() < 1e-4 * scale
        assert np.abs(tools - change).max() > 0.05 * scale  # without the heart it does not add up
    elif law.law != "standard_linear_solid":
        assert (np.diff(lost) > -1e-6 * scale).all()
    # Held at one depth, the heart stiffens the tissue against the tool, and no work is the tool's.
    still = np.repeat(path[:1], n + 1, axis=0)
    assert not work(indent(law, still, 2e-4, factor), still).any()


# --- agreement with high-resolution solutions ----------------------------------------------------


def bounce(law: ContactConfig, mass: float, speed: float, step: float, end: float):
    """A free mass falls on the surface: semi-implicit Euler, as MuJoCo integrates the cell."""
    tool = Indentation(law, np.array([0.0, 0.0, 1e-4]), step)
    z, v, rows = 1e-4, -speed, []
    for k in range(round(end / step)):
        force = tool.go(np.array([0.0, 0.0, z]), np.array([0.0, 0.0, v]))
        rows.append((k * step, z, v, force[2]))
        v -= step * force[2] / mass
        z += step * v
    return np.array(rows).T


def exact(law: ContactConfig, mass: float, speed: float, times: np.ndarray):
    """The same by an adaptive method of order 8, from the formulae of the page, with events."""
    K, D, n = law.stiffness, law.damping, law.exponent
    Kn, share, tau = power_coefficient(law), law.relaxation, law.relaxation_time
    own = law.unilateral

    def push(z, v, q):
        """Force on the mass, upwards."""
        d = -z
        if law.law == "hunt_crossley":
            return Kn * max(d, 0.0) ** n * max(1.0 - law.dissipation * v, 0.0)
        if law.law == "standard_linear_solid":
            total = (1.0 - share) * K * d - share * K * q
            return max(total, 0.0) if own else total
        damper = -D * v
        if own:
            return 0.0 if d <= 0.0 else K * d + min(max(damper, -K * d), K * d)
        return K * d + damper

    def rates(_, state):
        z, v, q = state
        d, solid = -z, law.law == "standard_linear_solid"
        # Where it only pushes and the tool is off it, the branch recovers by itself.
        off = solid and own and (1.0 - share) * K * d - share * K * q <= 0.0
        slope = -q * (1.0 - share) / tau if off else v - q / tau
        return [v, push(z, v, q) / mass, slope if solid else 0.0]

    z0 = 1e-4
    start = z0 / speed if own else 0.0  # in free flight until then
    first = times < start
    state = [0.0 if own else z0, -speed, 0.0]
    found = solve_ivp(
        rates, (start, times[-1]), state, method="DOP853", rtol=1e-10, atol=1e-13,
        t_eval=times[~first], max_step=2e-4,
    )  # fmt: skip
    z = np.concatenate([z0 - speed * times[first], found.y[0]])
    v = np.concatenate([np.full(first.sum(), -speed), found.y[1]])
    q = np.concatenate([np.zeros(first.sum()), found.y[2]])
    f = -np.array([0.0 if a else push(*s) for a, *s in zip(first, z, v, q, strict=True)])
    return z, v, f


@every_law
def test_a_free_mass_moves_as_an_exact_solution_says(law):
    """And the error is one of the step: a fifth of the step has a fifth of it."""
    mass, speed, end = 1.0, 0.15, 0.12
    errors = []
    for step in (STEP, STEP / 5.0):
        t, z, v, f = bounce(law, mass, speed, step, end)
        if not law.unilateral:  # bonded where they meet: shift the rest length to the start
            f_0 = f[0]
            assert abs(f_0 + law.damping * speed - law.stiffness * 1e-4) < 1.0
        z_exact, v_exact, f_exact = exact(law, mass, speed, t)
        errors.append(
            [np.abs(z - z_exact).max(), np.abs(v - v_exact).max(), np.abs(f - f_exact).max()]
        )
    coarse, fine = errors
    assert coarse[0] < 2e-5  # of 3 mm
    assert coarse[1] < 3e-3  # of 0.15 m/s
    assert coarse[2] < 0.06  # of 7 N
    assert (np.array(fine) < 0.4 * np.array(coarse)).all()


def test_the_maxwell_branch_is_exact_for_a_deformation_that_is_linear_over_a_step():
    law = LAWS["standard_linear_solid"]
    rng = np.random.default_rng(0)
    step, path = 0.01, np.cumsum(rng.normal(0.0, 1e-3, (50, 3)), axis=0)
    path -= path[0]
    force = indent(law, path, step)
    tau, share, K = law.relaxation_time, law.relaxation, law.stiffness
    t = step * np.arange(50)
    for k in (1, 7, 49):
        # q(t) = int exp(-(t - s) / tau) dx/ds ds, piece by piece
        q = sum(
            (path[i + 1] - path[i]) / step * tau
            * (math.exp(-(t[k] - t[i + 1]) / tau) - math.exp(-(t[k] - t[i]) / tau))
            for i in range(k)
        )  # fmt: skip
        np.testing.assert_allclose(
            force[k], (1 - share) * K * path[k] + share * K * q, rtol=0, atol=1e-12
        )


def test_a_held_deformation_relaxes_to_the_share_that_stays():
    law = LAWS["standard_linear_solid"]
    path = np.zeros((4000, 3))
    path[:, 2] = -2e-3 * np.minimum(np.arange(4000) / 40.0, 1.0)
    force = -indent(law, path, STEP)[:, 2]
    assert force.max() == pytest.approx(law.stiffness * 2e-3, rel=0.05)
    after = force[40:] - 0.5 * law.stiffness * 2e-3
    t = STEP * np.arange(after.size)
    np.testing.assert_allclose(after, after[0] * np.exp(-t / law.relaxation_time), atol=1e-9)


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("dissipation", [0.0, 0.3, 1.5])
def test_restitution_is_that_of_hunt_and_crossley(speed, dissipation):
    """Exactly c v (1 + e) = ln((1 + c v) / (1 - c v e)); 1 - 2/3 c v for slow impacts."""
    law = ContactConfig(law="hunt_crossley", unilateral=True, dissipation=dissipation, exponent=1.7)
    _, z, v, _ = bounce(law, 1.0, speed, 2e-5, 0.4)
    up = np.flatnonzero((z > 0) & (v > 0))
    assert up.size
    e, x = v[up[0]] / speed, dissipation * speed
    if x:
        assert x * (1 + e) == pytest.approx(math.log((1 + x) / (1 - x * e)), rel=5e-3, abs=1e-5)
    assert e == pytest.approx(1.0 - 2.0 / 3.0 * x, abs=2e-3 + 0.5 * x * x)


# --- no jump, no pull ----------------------------------------------------------------------------


@every_pushing
@pytest.mark.parametrize("seed", range(2))
def test_forces_start_and_end_at_zero(law, seed):
    """A finer step makes the largest change of the force between two steps as much smaller."""
    jumps = []
    for n in (1500, 6000):
        path = journey(seed, n)
        force = indent(law, path, 0.4 / n)
        jumps.append(np.abs(np.diff(force, axis=0)).max())
        touching = force[:, 2] < 0.0
        assert 0.02 < touching.mean() < 0.98
        assert not force[~touching].any()
    assert jumps[1] < 0.5 * jumps[0]


@pytest.mark.parametrize("law", [LAWS["kelvin_voigt"], LAWS["spring"]], ids=["damper", "spring"])
def test_a_bonded_law_pulls(law):
    path = np.column_stack([np.zeros((50, 2)), np.linspace(0.0, 1e-3, 50)])
    assert indent(law, path, 1e-3)[-1, 2] > 2.0


def test_a_dent_recovers_and_is_met_where_it_then_is():
    """Press, wait, leave quickly: the force is back where the tissue has come back to."""
    law = LAWS["standard_linear_solid, pushing"]
    depth = np.concatenate(
        [np.linspace(0, 3e-3, 200), np.full(2000, 3e-3), np.linspace(3e-3, 0.5e-3, 40),
         np.full(3000, 0.5e-3)]
    )  # fmt: skip
    path = np.column_stack([np.zeros((depth.size, 2)), -depth])
    force = -indent(law, path, STEP)[:, 2]
    off = np.flatnonzero(force[2200:] == 0.0) + 2200
    assert off.size > 20
    assert force[-1] == pytest.approx(0.5 * law.stiffness * 0.5e-3, rel=0.02)
    # The dent was about half the depth: it left there, and the force came back smoothly.
    assert 1e-3 < depth[off[0]] < 2e-3
    assert np.abs(np.diff(force[off[-1] :])).max() < 0.02


# --- bristles ------------------------------------------------------------------------------------


def slide(law: ContactConfig, depth: float, aside: np.ndarray, step: float = STEP) -> np.ndarray:
    path = np.column_stack([aside, np.zeros(aside.size), np.full(aside.size, -depth)])
    return indent(law, path, step)


def test_below_break_away_bristles_are_a_spring_and_do_not_creep():
    """Elasto-plastic, not LuGre: a load that oscillates below break-away leaves no drift."""
    law = LAWS["hunt_crossley"]
    depth = 4e-3
    normal = -slide(law, depth, np.zeros(2))[0, 2]
    most = 0.65 * law.bristles.break_away * law.bristles.kinetic * normal / law.stiffness
    aside = most * (1.0 - np.cos(np.arange(6000) * 0.05)) / 2.0
    speed = np.gradient(aside, STEP)
    force = slide(law, depth, aside)[:, 0]
    np.testing.assert_allclose(force, law.stiffness * aside + law.damping * speed, atol=1e-9)


def test_a_deflection_that_the_friction_no_longer_bears_is_lost():
    """Pressed, moved aside, all but lifted, pressed again: the lateral force does not come back."""
    law = LAWS["hunt_crossley"]
    n = 400
    depth = np.concatenate(
        [np.full(n, 4e-3), np.linspace(4e-3, 2e-4, n), np.linspace(2e-4, 4e-3, n)]
    )
    aside = np.concatenate([np.linspace(0.0, 0.8e-3, n), np.full(2 * n, 0.8e-3)])
    force = indent(law, np.column_stack([aside, np.zeros(3 * n), -depth]), 1e-2)
    assert force[n - 1, 0] == pytest.approx(law.stiffness * 0.8e-3, rel=0.05)
    assert force[-1, 0] < 0.1 * force[n - 1, 0]


@pytest.mark.parametrize("pace", [1e-3, 1e-2, 0.2])
def test_a_slide_has_the_friction_of_its_speed(pace):
    law = replace(LAWS["hunt_crossley"], damping=0.0)
    f, step = law.bristles, 0.02 / (pace * 3000)
    force = slide(law, 4e-3, pace * step * np.arange(3000), step)
    mu = f.kinetic + (f.static - f.kinetic) / (1 + (pace / f.stribeck_velocity) ** 2)
    ratio = force[-1, 0] / -force[-1, 2]
    assert ratio == pytest.approx(mu, rel=1e-6)


def test_friction_turns_with_the_slide():
    """Round a circle the friction is against the motion, with a lag of the bristles' length."""
    law = LAWS["hunt_crossley, slippery"]
    t = np.arange(0.0, 1.0, STEP)
    path = np.column_stack(
        [0.01 * np.cos(6.28 * t), 0.01 * np.sin(6.28 * t), np.full(t.size, -3e-3)]
    )
    force = indent(law, path, STEP)[4000:, :2]
    way = np.gradient(path, STEP, axis=0)[4000:, :2]
    cosine = (
        np.sum(force * way, axis=1) / np.linalg.norm(force, axis=1) / np.linalg.norm(way, axis=1)
    )
    assert cosine.min() > 0.95


def test_bristles_agree_with_an_adaptive_solution():
    """Elasto-plastic sliding to and fro at constant normal force, with the page's formula."""
    law = replace(LAWS["hunt_crossley"], damping=0.0)
    f, depth = law.bristles, 4e-3
    t = np.arange(0.0, 0.3, STEP / 4)
    aside = 4e-3 * np.sin(2 * np.pi * 4 * t)
    force = slide(law, depth, aside, STEP / 4)
    normal = -force[5, 2]

    def speed(now):
        return 4e-3 * 2 * np.pi * 4 * math.cos(2 * np.pi * 4 * now)

    def rate(now, state):
        b, v = state[0], speed(now)
        mu = f.kinetic + (f.static - f.kinetic) / (1 + (v / f.stribeck_velocity) ** 2)
        reach = mu * normal / law.stiffness
        alpha = 0.0
        if v * b > 0.0 and abs(b) > f.break_away * reach:
            s = min((abs(b) / reach - f.break_away) / (1 - f.break_away), 1.0)
            alpha = s * s * (3 - 2 * s)
        return [v - alpha * abs(v) * b / reach]

    found = solve_ivp(rate, (0.0, t[-1]), [0.0], method="RK45", rtol=1e-9, atol=1e-12,
                      t_eval=t, max_step=1e-4)  # fmt: skip
    exact_force = law.stiffness * found.y[0]
    # Where the friction falls faster than bristles slip, they are cut to it at once.
    assert np.sqrt(np.mean((force[:, 0] - exact_force) ** 2)) < 0.03 * np.abs(exact_force).max()


# --- in the cell: momentum, equilibrium, both loops ----------------------------------------------


def cell_config(law: ContactConfig, **protection) -> CellConfig:
    flaws = ImperfectionConfig(0.0, 0.0, 0.0, 0.0, 0, 0.0)
    return CellConfig(
        contact=law,
        sensor=SensorConfig("ideal"),
        imperfections=flaws,
        protection=ProtectionConfig(**protection),
    )


@every_law
def test_action_is_reaction_on_both_arms(law, beating, make_cell, check_force_on_both_arms):
    """The contact's share of the joint torques is that of equal and opposite forces at the tips."""
    law = replace(law, systolic_stiffening=0.5)
    n = 100
    cell = make_cell(
        cell_config(law), beating(n, scale=0.6), contraction=0.5 - 0.5 * np.cos(0.1 * np.arange(n))
    )
    sizes = []
    for k in range(n):
        cell.measure()
        sizes.append(np.linalg.norm(check_force_on_both_arms(cell)))
        cell.apply(np.array([4.0, 3.0, 5.0]) * np.sin(0.15 * k))
    assert np.ptp(sizes) > 1.0


@every_law
@pytest.mark.parametrize("force", [(0.3, 0.5, -3.0), (1.0, 2.0, -10.0)])
def test_a_cell_starts_in_equilibrium_and_stays(law, force, still, make_cell, drive):
    cell = make_cell(cell_config(replace(law, systolic_stiffening=0.5)), still(150),
                     force=np.array(force), contraction=np.full(150, 0.4))  # fmt: skip
    trace = drive(cell, 0.0)
    np.testing.assert_allclose(trace.force, np.tile(force, (150, 1)), atol=2e-4)


@every_law
def test_in_the_cell_a_law_does_what_it_does_by_itself(law, beating, make_cell):
    """The force of a run is that of the law along the run's own path, at the physics rate."""
    n = 200
    cell = Cell(
        replace(cell_config(law), substeps=1, period=STEP, protection=ProtectionConfig(False)),
        beating(n, scale=0.3), force=np.array([0.5, -0.5, -4.0]), seed=0,
    )  # fmt: skip
    data, rows = cell.data, []
    for k in range(n):
        cell.measure()
        along = data.site("heart_surface").xmat.reshape(3, 3).T @ cell.truth().force
        rows.append((*data.actuator_length[12:], *data.actuator_velocity[12:], *along))
        cell.apply(np.array([30.0, 20.0, 25.0]) * np.sin(0.08 * k))
    place, speed, found = np.split(np.array(rows), 3, axis=1)
    tool = Indentation(law, place[0], STEP)
    force = np.array([tool.go(p, v) for p, v in zip(place[1:], speed[1:], strict=True)])
    np.testing.assert_allclose(force, found[1:], rtol=0, atol=1e-12)
    assert np.ptp(found[:, 2]) > 0.3


@every_law
def test_the_compiled_loop_is_the_loop_in_python_bit_for_bit(law, beating, make_cell, drive):
    """Touch-down, slip, lift-off, a stiffness that varies, and a trip that releases the contact."""
    library = physics_loop(6).binary
    if library is None:
        pytest.skip(physics_loop(6).told)
    n = 260
    config = cell_config(replace(law, systolic_stiffening=0.7), force=14.0)
    runs = [
        drive(
            make_cell(
                config, beating(n, scale=0.8, phase=0.3), library=own, force=np.array([0, 0, -3.0]),
                contraction=0.5 - 0.5 * np.cos(0.06 * np.arange(n)),
            ),
            lambda k: np.array([12.0, -9.0, 14.0]) * np.sin(0.09 * k) - [0, 0, 0.015 * k],
        )
        for own in (None, library)
    ]  # fmt: skip
    assert runs[0].equals(runs[1])
    assert np.array_equal(runs[0].touching, runs[1].touching)
    assert np.ptp(runs[0].force[:, 2]) > 3.0


@every_law
def test_whatever_is_sent_the_force_stays_below_its_cap(law, monkeypatch):
    """Hostile controllers on random cells, the tissue stiffening and yielding with the beat."""
    usual, cycles = hostile.some_config, 250
    beat = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(cycles) / 130.0)

    def some_config(rng):
        config = usual(rng)
        law_here = replace(
            law,
            stiffness=config.contact.stiffness,
            gap=config.contact.gap if law.unilateral else 0.0,
            systolic_stiffening=float(rng.uniform(0.0, 2.0)),
        )
        return replace(config, contact=law_here)

    monkeypatch.setattr(hostile, "some_config", some_config)
    monkeypatch.setattr(hostile, "Cell", partial(Cell, contraction=beat))
    worst, n, library = hostile.Worst(), 0, physics_loop(6).binary
    for ring in hostile.rings([17, len(law.law), law.unilateral], 3, cycles, library):
        contact = ring.config.contact
        if contact.gap == 0:
            rest = rest_displacement(contact, ring.force, 1.0)
            ring.start = ring.motion.position[0] + rest
        for _ in range(4):
            ring.fight(hostile.CONTROLLERS[n % len(hostile.CONTROLLERS)](ring.rng), worst)
            n += 5
    assert worst.sequences == 12
    assert worst.share_of_cap < 1.0


# --- configuration -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "key", "told"),
    [
        (ContactConfig(law="spring", damping=1.0), "damping", "kelvin_voigt"),
        (ContactConfig(law="standard_linear_solid", damping=1.0), "damping", "no effect"),
        (ContactConfig(relaxation=0.5), "relaxation", "standard_linear_solid"),
        (ContactConfig(relaxation_time=0.5), "relaxation_time", "standard_linear_solid"),
        (ContactConfig(exponent=2.0), "exponent", "hunt_crossley"),
        (ContactConfig(dissipation=2.0), "dissipation", "hunt_crossley"),
        (ContactConfig(reference_depth=2e-3), "reference_depth", "hunt_crossley"),
        (ContactConfig(bristles=BristleConfig(0.9)), "bristles", "hunt_crossley"),
        (ContactConfig(law="hunt_crossley"), "law", "unilateral = true"),
        (
            ContactConfig(
                law="hunt_crossley", unilateral=True, bristles=BristleConfig(kinetic=0.9)
            ),
            "bristles.kinetic",
            "exceeds",
        ),
        (ContactConfig(gap=1e-3), "gap", "unilateral = true"),
    ],
)
def test_what_does_not_fit_is_told_with_its_key(law, key, told, still):
    found = contradiction(law)
    assert found is not None
    assert found[0] == key
    assert told in found[1]
    with pytest.raises(PlantError, match=key):
        Cell(cell_config(law), still(3), force=np.zeros(3), seed=0)


@pytest.mark.parametrize(
    "contraction", [None, np.zeros(4), np.full(5, 1.1), np.full(5, np.nan), np.full(5, -0.1)]
)
def test_stiffening_needs_a_contraction_for_every_instant(contraction, still):
    law = ContactConfig(systolic_stiffening=0.5)
    with pytest.raises(PlantError, match=r"stiffening|contraction"):
        Cell(cell_config(law), still(5), force=np.zeros(3), seed=0, contraction=contraction)


@every_law
def test_the_rest_displacement_gives_the_force(law):
    wished = np.array([0.4, -0.8, -7.0])
    place = rest_displacement(law, wished, 1.3)
    force = indent(law, np.tile(place, (2, 1)), STEP, np.full(2, 1.3))
    np.testing.assert_allclose(force[0], wished, atol=1e-9)


@every_law
def test_the_cap_grows_with_what_the_law_may_do(law):
    cell = CellConfig(contact=law)
    cap = force_cap(cell, 0.2)
    assert cap > 30.0
    assert force_cap(replace(cell, contact=replace(law, systolic_stiffening=0.5)), 0.2) > cap
