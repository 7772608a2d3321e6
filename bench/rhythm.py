"""Disturbance models side by side, ``python -m bench.rhythm``: the tables of docs/rhythm.md."""

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.rhythm_bound import prediction_bound
from plant.sensors import SENSORS
from qpmpc.force_control import ForceController
from qpmpc.protocol import ForceControl
from scenarios import load_scenario
from scenarios.config import Scenario
from scenarios.experiment import Assembly, assemble, hold_still
from scenarios.loop import control_loop, watch_loop
from scenarios.motion import load_motion

Array = NDArray[np.float64]
_AGILE = ("controller.reference_time=0.002", "controller.increment_weight=0.001")
"""Weights for a preview that can be trusted: errors need not be left to die out slowly."""
_KIND = "controller.observer.disturbance"
MODELS: dict[str, tuple[str, ...]] = {
    "fused": (f"{_KIND}='fused'",),
    "fused, agile": (f"{_KIND}='fused'", "controller.observer.tissue_jerk_drift=20.0", *_AGILE),
    "tracked": (f"{_KIND}='tracked'", *_AGILE),
    "beats": (f"{_KIND}='beats'", *_AGILE),
}
"""Settings of each disturbance model that is compared; the first is the default."""
MOTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "realistic mix": ("paper", ()),
    "early beats": ("paper", ("motion.early_beat_probability=0.15",)),
    "irregular": ("paper", ("motion.rate_irregularity=0.25",)),
    "rate step": ("paper", ("motion.rate_steps=[{time=6.0, rate=1.8}]",)),
    "no respiration": (
        "paper",
        ("motion.respiration_excursion=0.0", "motion.breath_modulation=0.0"),
    ),
    "real ECG": ("ecg", ()),
    "recording": ("paper", ()),
}
"""Scenario and settings of each motion; the recording is written first, see `_record`."""
_RECORDED = ("motion.heart_rate=1.4", "motion.rate_variability_hf=0.01")
KNOWN = "motion known"
"""The run in which the controller is told the tissue's motion, present and to come."""


@dataclass(frozen=True)
class Row:
    """One motion, sensor and disturbance model, over all seeds; a figure for each of x, y, z."""

    motion: str
    sensor: str
    model: str
    rms: tuple[float, ...]
    """Root of the mean square over seeds [N]."""
    worst: tuple[float, ...]
    """Largest error of any seed [N]."""
    reduction: tuple[float, ...]
    """Of the RMS, mean over seeds [%]."""
    least: tuple[float, ...]
    """Of any seed [%]."""
    increment: tuple[float, ...]
    """RMS of the command's change [m/s^2]."""
    bound: tuple[float, ...]
    """Reduction that no linear time-invariant controller exceeds, see `prediction_bound` [%]."""


class KnownMotion:
    """In the place of a `MotionEstimator`: knows the motion from a run before."""

    def __init__(self, motion: Array) -> None:
        """Take the force that the motion causes, ``(cycles + N, n_axes)`` [N]."""
        self._motion, self._cycle = motion, 0

    def reset(self) -> None:
        """Begin anew."""
        self._cycle = 0

    def beat(self) -> None:
        """Heed no beat."""

    def correct(self, sample: Array) -> None:
        """Heed no sample."""

    def preview(self, out: Array) -> Array:
        """Write the motion from now on into ``out``; return it."""
        out[:] = self._motion[self._cycle : self._cycle + out.shape[0]]
        return out

    def advance(self) -> None:
        """Go on by a cycle."""
        self._cycle += 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for and print a table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.rhythm", description=__doc__)
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=["nano17", "mini45"])
    parser.add_argument(
        "--models", nargs="+", choices=[*MODELS, KNOWN], default=[*MODELS], metavar="MODEL"
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=15.0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args(arguments)
    if asked.seeds < 1 or not 1.0 <= asked.duration <= 15.0:
        parser.error("--seeds must be at least 1, --duration 1 to 15 s")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for row in _rows(asked, Path(folder)):
            rows.append(row)
            if not asked.json:
                sys.stdout.write(_line(row, header=len(rows) == 1))
                sys.stdout.flush()
    if asked.json:
        sys.stdout.write(json.dumps([asdict(row) for row in rows], indent=2) + "\n")
    return 0


def _rows(asked: argparse.Namespace, folder: Path) -> Iterator[Row]:
    for motion in asked.motions:
        for sensor in asked.sensors:
            models = [m for m in asked.models if not (m == "beats" and motion == "recording")]
            found: dict[str, list[Array]] = {model: [] for model in models}
            place = folder, asked.duration
            for seed in range(asked.seeds):
                for model, figures in _compare(motion, sensor, seed, models, place):
                    found[model].append(figures)
            for model, each in found.items():
                seeds = np.stack(each)  # (seeds, 5, 3): rms, worst, reduction, increment, bound
                yield Row(
                    motion, sensor, model,
                    tuple(np.sqrt(np.mean(seeds[:, 0] ** 2, axis=0)).tolist()),
                    tuple(seeds[:, 1].max(axis=0).tolist()),
                    tuple(seeds[:, 2].mean(axis=0).tolist()),
                    tuple(seeds[:, 2].min(axis=0).tolist()),
                    tuple(np.sqrt(np.mean(seeds[:, 3] ** 2, axis=0)).tolist()),
                    tuple(seeds[:, 4].mean(axis=0).tolist()),
                )  # fmt: skip


def _compare(
    motion: str, sensor: str, seed: int, models: Sequence[str], place: tuple[Path, float]
) -> Iterator[tuple[str, Array]]:
    """Run every model on one motion; the run with the brakes closed is made once.

    Args:
        motion, sensor, seed, models: what is run.
        place: folder for a recording, and duration [s].
    """
    folder, duration = place
    name, settings = MOTIONS[motion]
    recorded = _record(folder, seed, duration) if motion == "recording" else None

    def scenario(model: str) -> Scenario:
        return load_scenario(
            name,
            top={"seed": seed, "duration": duration},
            motion=recorded,
            settings=[*settings, f"cell.sensor.model='{sensor}'", *MODELS[model]],
        )

    base = scenario("fused")
    made = assemble(base, _quiet)
    still, held = made.another_cell(), np.zeros((base.cycles, 3))
    hold_still(still, made.setpoint)
    watch_loop(still, held, base.cycles, progress=_quiet, stop=_never)
    before = np.sqrt(np.mean((held - made.setpoint.force[0]) ** 2, axis=0))
    stiffness = base.cell.contact.stiffness
    bound = prediction_bound(
        -stiffness * load_motion(base.motion, base.duration, base.cell.period, seed).position,
        SENSORS[base.cell.sensor.model].deviation,
        base.cell.imperfections.delay + 1,
    )
    tissue: Array | None = None
    for model in models:
        if model == KNOWN:
            if tissue is None:
                tissue = _run(made, base)[1]
            made = assemble(scenario("tracked"), _quiet)
            motion_force = made.setpoint.start - stiffness * (tissue - tissue[0])
            _tell(made.controller, motion_force)
        else:
            made = assemble(scenario(model), _quiet)
        figures, tissue = _run(made, base)
        rms = figures[0]
        yield (
            model,
            np.stack(
                [rms, figures[1], 100 * (1 - rms / before), figures[2], 100 * (1 - bound / before)]
            ),
        )


def _run(made: Assembly, scenario: Scenario) -> tuple[Array, Array]:
    """Return RMS error, largest error and RMS increment ``(3, 3)``, and where the tissue was."""
    log = made.log
    control_loop(
        made.cell, made.controller, made.setpoint, log, scenario.cycles,
        schedule=made.schedule, beats=made.beats, progress=_quiet, stop=_never,
    )  # fmt: skip
    error = (log.force - log.setpoint)[: log.counted]
    change = np.diff(log.command[: log.counted], axis=0)
    rms = [np.sqrt(np.mean(values**2, axis=0)) for values in (error, change)]
    return np.stack([rms[0], np.abs(error).max(axis=0), rms[1]]), log.tissue.copy()


def _tell(controller: ForceControl, motion: Array) -> None:
    """Let a controller with a preview know the motion of the tissue."""
    assert isinstance(controller, ForceController)
    preview = controller.preview
    assert preview is not None
    ends = np.repeat(motion[-1:], preview.motion.shape[0], axis=0)
    preview.estimator = KnownMotion(np.vstack([motion, ends]))  # type: ignore[assignment]


def _record(folder: Path, seed: int, duration: float) -> Path:
    """Write another heart as a recording would have it: at 200 Hz, to a micrometre."""
    path = folder / f"recording-{seed}.csv"
    if not path.exists():
        heart = load_scenario("paper", settings=_RECORDED).motion
        motion = load_motion(heart, duration + 0.1, 1e-3, seed + 1000)
        table = np.column_stack([motion.time, motion.position])[::5]
        np.savetxt(path, table, "%.6f", ",", header="t,x,y,z", comments="")
    return path


def _line(row: Row, *, header: bool) -> str:
    text = ""
    if header:
        text = (
            "| motion | sensor | model | RMS reduction x / y / z [%] | least of all seeds [%] | "
            "RMS error [N] | largest error [N] | RMS of command's change [m/s^2] | "
            "bound, time-invariant [%] |\n|---|---|---|---|---|---|---|---|---|\n"
        )

    def cell(values: Sequence[float], digits: int) -> str:
        return " / ".join(f"{value:.{digits}f}" for value in values)

    return text + (
        f"| {row.motion} | {row.sensor} | {row.model} | {cell(row.reduction, 1)} | "
        f"{cell(row.least, 1)} | {cell(row.rms, 3)} | {cell(row.worst, 2)} | "
        f"{cell(row.increment, 2)} | {cell(row.bound, 1)} |\n"
    )


def _quiet(*_: object) -> None:
    """Take no notice of progress."""


def _never() -> bool:
    return False


if __name__ == "__main__":
    sys.exit(main())
