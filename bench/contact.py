"""The contact laws by themselves and in the loop: ``python -m bench.contact [FOLDER]``.

Prints the force error of the default controller under each law, and draws the laws and a run that
loses contact into FOLDER, as ``contact-laws.png`` and ``lost-contact.png``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from bench.figures import shade_lost
from plant import ContactConfig, indent
from plant.errors import PlantError
from qpmpc.errors import QpmpcError
from scenarios import ScenarioError, load_scenario, run_experiment, summarise
from scenarios.log import Array, Log
from scenarios.metrics import Summary
from scenarios.motion import MotionConfig, load_motion

PUSHING = "cell.contact.unilateral=true"
CASES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("spring", ("cell.contact.law=spring",)),
    ("spring, only pushing", ("cell.contact.law=spring", PUSHING)),
    ("Kelvin-Voigt, D = 0.2", ("cell.contact.damping=0.2",)),
    ("Kelvin-Voigt, D = 1", ("cell.contact.damping=1.0",)),
    ("standard linear solid", ("cell.contact.law=standard_linear_solid",)),
    ("Hunt-Crossley", ("cell.contact.law=hunt_crossley", PUSHING)),
    (
        "Hunt-Crossley, dissipation 0.1",
        ("cell.contact.law=hunt_crossley", PUSHING, "cell.contact.dissipation=0.1"),
    ),
    (
        "K = 1750, systole + 50 %",
        (
            "cell.contact.law=spring",
            "cell.contact.stiffness=1750",
            "cell.contact.systolic_stiffening=0.5",
        ),
    ),
)
"""Laws with what is changed in the scenario ``paper``."""
DRAWN: tuple[tuple[str, ContactConfig], ...] = (
    ("spring", ContactConfig(law="spring")),
    ("Kelvin-Voigt, D = 8 N s/m", ContactConfig(damping=8.0)),
    (
        "standard linear solid, half relaxes in 0.1 s, only pushing",
        ContactConfig(
            law="standard_linear_solid", relaxation=0.5, relaxation_time=0.1, unilateral=True
        ),
    ),
    (
        "Hunt-Crossley, dissipation 1 s/m",
        ContactConfig(law="hunt_crossley", unilateral=True, dissipation=1.0),
    ),
)
_COLOURS = ("#222222", "#0072B2", "#009E73", "#D55E00", "#CC79A7")
_STEP = 1.25e-4


def measure(settings: tuple[str, ...], duration: float) -> Summary:
    """Return the summary of the scenario ``paper`` with settings, without the run held still."""
    scenario = load_scenario("paper", top={"duration": duration}, settings=settings)
    experiment = run_experiment(
        scenario,
        report=lambda *_: None,
        stop=lambda: False,
        held=np.zeros((scenario.cycles, 3)),
    )
    return summarise(experiment)


def table(duration: float) -> Table:
    """Run all cases and return the table of force errors."""
    result = Table(
        "law", "RMS x / y / z [N]", "largest x / y / z [N]", "command saturated", "tripped",
        "x real time",
        title=f"The default controller under each contact law, scenario paper, {duration:g} s",
        box=SIMPLE_HEAD,
    )  # fmt: skip
    for name, settings in CASES:
        summary = measure(settings, duration)
        axes = [figures["compensated"] for figures in summary["axes"].values()]
        result.add_row(
            name,
            " / ".join(f"{a['rms']:.3f}" for a in axes),
            " / ".join(f"{a['max']:.2f}" for a in axes),
            f"{summary['saturation']['command']:.1%}",
            "no" if summary["trip"] is None else summary["trip"]["cause"],
            f"{summary['timing']['real_time_factor']['compensated']:.1f}",
        )
    return result


def draw_laws(path: Path) -> None:
    """Draw force over depth, relaxation, bristles and the beat's stiffness."""
    figure = Figure(figsize=(12, 8), layout="constrained", dpi=110)
    (loops, hold), (aside, beat) = figure.subplots(2, 2)
    time = np.arange(0.0, 1.0, _STEP)
    depth = 2e-3 * (1.0 - np.cos(2.0 * np.pi * 4.0 * time))
    for colour, (name, law) in zip(_COLOURS, DRAWN, strict=False):
        force = -indent(law, _down(depth), _STEP)[:, 2]
        last = time > time[-1] - 0.25
        loops.plot(1e3 * depth[last], force[last], color=colour, label=name)
    loops.set(
        xlabel="depth [mm]", ylabel="normal force [N]", title="pressed to 4 mm, four times a second"
    )
    press = np.minimum(time / 0.02, 1.0) * 4e-3
    for colour, (name, law) in zip(_COLOURS, DRAWN, strict=False):
        hold.plot(time, -indent(law, _down(press), _STEP)[:, 2], color=colour, label=name)
    hold.set(
        xlabel="time [s]", ylabel="normal force [N]",
        title="pressed to 4 mm within 20 ms, and held", xlim=(0, 0.5),
    )  # fmt: skip
    way = 4e-3 * np.sin(2.0 * np.pi * 2.0 * time)
    for colour, deep in zip(_COLOURS, (6e-3, 4e-3, 2e-3), strict=False):
        law = DRAWN[-1][1]
        path3 = np.column_stack([way, np.zeros_like(way), np.full_like(way, -deep)])
        force = indent(law, path3, _STEP)
        label = f"{1e3 * deep:.0f} mm deep, {-force[10, 2]:.1f} N"
        shown = time > 0.4
        aside.plot(1e3 * way[shown], force[shown, 0], color=colour, label=label)
    aside.set(
        xlabel="way aside [mm]", ylabel="lateral force [N]",
        title="bristles: moved to and fro by 4 mm, twice a second",
    )  # fmt: skip
    motion = load_motion(MotionConfig(early_beat_probability=0.4), 5.0, 1e-3, 1)
    contraction = motion.contraction
    assert contraction is not None
    law = ContactConfig(stiffness=1750.0, systolic_stiffening=0.5)
    beat.plot(
        motion.time, law.stiffness * (1.0 + law.systolic_stiffening * contraction),
        color=_COLOURS[1], label="K = 1750 N/m, half as much again in systole",
    )  # fmt: skip
    for k, peak in enumerate(motion.beats.tolist()):
        beat.axvline(peak, color=_COLOURS[3], linewidth=0.8, label=None if k else "R peaks")
    beat.set(
        xlabel="time [s]",
        ylabel="stiffness [N/m]",
        title="stiffness over beats, some of them early",
    )
    for panel in (loops, hold, aside, beat):
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
    beat.legend(fontsize=8, loc="upper center", ncols=2)
    beat.set_ylim(1700.0, 2850.0)
    figure.savefig(path)


def draw_lost(log: Log, path: Path) -> None:
    """Draw a run that loses contact: whole above, one loss and its recovery below."""
    end = log.cycles
    time = log.time[:end]
    tool, tissue = 1e3 * log.tool[:end, 2], 1e3 * log.tissue[:end, 2]
    tissue, tool = tissue - tissue[0], tool - tissue[0]
    figure = Figure(figsize=(13, 8.5), layout="constrained", dpi=110)
    grid = figure.subplots(3, 2, sharex="col", width_ratios=(3, 2))
    for panels in grid.T:
        place, force, speed = panels
        place.plot(time, tissue, color=_COLOURS[3], linewidth=0.9, label="tissue at rest")
        place.plot(time, tool, color=_COLOURS[1], linewidth=0.9, label="tool")
        force.plot(time, -log.force[:end, 2], color=_COLOURS[1], linewidth=0.9, label="pressing")
        force.plot(
            time, -log.setpoint[:end, log.axes.index("z")], color=_COLOURS[0], linestyle="--",
            linewidth=0.9, label="setpoint",
        )  # fmt: skip
        speed.plot(time, log.tool_velocity[:end, 2], color=_COLOURS[1], linewidth=0.9)
        speed.set_xlabel("time [s]")
        shade_lost(log, panels.tolist())
        for panel in panels:
            panel.grid(alpha=0.3)
    for panel, label in zip(
        grid[:, 0], ("height [mm]", "force [N]", "tool velocity on z [m/s]"), strict=True
    ):
        panel.set_ylabel(label)
    grid[0, 0].set_title("grey: the tool counts as off the tissue", fontsize=10)
    grid[0, 0].legend(fontsize=8, loc="upper right")
    grid[1, 0].legend(fontsize=8, loc="upper right")
    event = next((e for e in log.contact_events or () if e.lost > 0 and e.found), None)
    if event is not None and event.found is not None:
        window = slice(max(0, event.lost - 120), min(end, event.found + 150))
        grid[0, 1].set_xlim(time[window.start], time[window.stop - 1])
        grid[0, 1].set_title(f"lost at {time[event.lost]:.3f} s", fontsize=10)
        for panel, values in zip(
            grid[:, 1],
            (np.stack([tool, tissue]), -log.force[:end, 2][None], log.tool_velocity[:end, 2][None]),
            strict=True,
        ):
            _fit(panel, values[:, window])
    figure.savefig(path)


def _down(depth: Array) -> Array:
    return np.column_stack([np.zeros((depth.size, 2)), -depth])


def _fit(panel: object, values: Array) -> None:
    room = 0.1 * float(np.ptp(values)) or 1.0
    panel.set_ylim(float(values.min()) - room, float(values.max()) + room)  # type: ignore[attr-defined]


def main() -> int:
    """Run the study; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.contact", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="where the pictures go")
    parser.add_argument("--duration", type=float, default=15.0, help="of each run [s]")
    asked = parser.parse_args()
    try:
        if asked.folder is not None:
            asked.folder.mkdir(parents=True, exist_ok=True)
            draw_laws(asked.folder / "contact-laws.png")
            scenario = load_scenario("lost-contact")
            experiment = run_experiment(
                scenario,
                report=lambda *_: None,
                stop=lambda: False,
                held=np.zeros((scenario.cycles, 3)),
            )
            draw_lost(experiment.log, asked.folder / "lost-contact.png")
        Console(width=130).print(table(asked.duration))
    except (QpmpcError, PlantError, ScenarioError, OSError) as error:
        print(f"bench.contact: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
