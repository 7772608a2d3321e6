"""What a film needs of a run, read from its folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from plant.config import CellConfig
from scenarios.errors import ScenarioError
from scenarios.load import load_scenario
from scenarios.scene.meshes import Array

_AXES = ("x", "y", "z")
_LEAST_JOINTS = 6


@dataclass(frozen=True, eq=False)
class Record:
    """A run, time-major; all arrays have a row for each cycle."""

    name: str
    """Of the scenario."""
    cell: CellConfig
    axes: tuple[int, ...]
    """Axes under force control: 0, 1, 2 for x, y, z."""
    time: Array
    """``(n,)`` [s]"""
    angles: Array
    """Of all joints, those of Robot_Heart first, ``(n, joints)`` [rad]."""
    touching: NDArray[np.bool_]
    """``(n,)``"""
    force: Array
    """That the tool exerts, without the sensor, ``(n, 3)`` [N]."""
    setpoint: Array
    """``(n, 3)`` [N]; NaN on axes that are not under force control."""
    held: Array
    """Force of the run with the tool held still, ``(n, 3)`` [N]; NaN where there is none."""
    tissue: Array
    """The tissue's surface at rest, ``(n, 3)`` [m]."""
    trip: tuple[str, float] | None
    """On what the protection tripped, and when [s]."""

    @property
    def start(self) -> float:
        """Time of the first cycle [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Time at which the last cycle ended [s]."""
        return float(self.time[-1]) + self.cell.period

    def cycle(self, time: float) -> int:
        """Number of the last cycle that began by a time [s]."""
        return max(0, int(np.searchsorted(self.time, time + 1e-9, side="right")) - 1)


def read_run(folder: Path) -> Record:
    """Read the folder of a run.

    Raises:
        ScenarioError: it is no such folder, or its files are not what a run writes.
    """
    _look(folder)
    scenario = load_scenario(str(folder / "config.toml"))
    path = folder / "log.parquet"
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise ScenarioError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    if table.num_rows == 0:
        raise ScenarioError(f"{path}: the run has no cycle")
    time = _column(table, "time", path)
    angles = np.hstack(
        [_joints(table, name, path) for name in ("heart_joint_angle", "joint_angle")]
    )
    for what, values in (("time", time), ("joint angles", angles)):
        if not np.isfinite(values).all():
            raise ScenarioError(f"{path}: {what}: not known in every cycle")
    if not (np.diff(time) > 0).all():
        raise ScenarioError(f"{path}: time: does not grow from row to row")
    setpoint = np.full((len(time), 3), np.nan)
    axes = tuple(_AXES.index(axis) for axis in scenario.axes)
    setpoint[:, axes] = _columns(table, [f"setpoint_{axis}" for axis in scenario.axes], path)
    return Record(
        name=scenario.name,
        cell=scenario.cell,
        axes=axes,
        time=time,
        angles=angles,
        touching=_column(table, "touching", path) > 0,
        force=_columns(table, [f"force_{axis}" for axis in _AXES], path),
        setpoint=setpoint,
        held=_columns(table, [f"force_uncompensated_{axis}" for axis in _AXES], path),
        tissue=_columns(table, [f"tissue_{axis}" for axis in _AXES], path),
        trip=_trip(table),
    )


def _look(folder: Path) -> None:
    if not folder.exists():
        raise ScenarioError(f"{folder}: no such folder; give one that pulsempc run has written")
    if not folder.is_dir():
        raise ScenarioError(f"{folder}: not a folder; give one that pulsempc run has written")
    for name in ("log.parquet", "config.toml"):
        if not (folder / name).is_file():
            runs = sorted(path.parent.name for path in folder.glob("*/log.parquet"))
            hint = f"; it holds several runs, give one: {', '.join(runs)}" if runs else ""
            raise ScenarioError(f"{folder}: not the folder of a run, it has no {name}{hint}")


def _joints(table: pa.Table, name: str, path: Path) -> Array:
    """Columns with a number behind their name, from 1 on, at least as many as a Viper has."""
    count = _LEAST_JOINTS
    while f"{name}_{count + 1}" in table.column_names:
        count += 1
    return _columns(table, [f"{name}_{j}" for j in range(1, count + 1)], path)


def _columns(table: pa.Table, names: list[str], path: Path) -> Array:
    return np.column_stack([_column(table, name, path) for name in names])


def _column(table: pa.Table, name: str, path: Path) -> Array:
    if name not in table.column_names:
        raise ScenarioError(
            f"{path}: has no column {name}: made by an older version, or not by a run; "
            "run its config.toml again"
        )
    try:
        values = table[name].to_numpy().astype(np.float64)
    except (ValueError, TypeError):
        raise ScenarioError(f"{path}: {name}: not a column of numbers") from None
    return np.asarray(values)


def _trip(table: pa.Table) -> tuple[str, float] | None:
    if "trip" not in table.column_names or str(table["trip"][-1].as_py()) == "none":
        return None
    told = (table.schema.field("trip").metadata or {}).get(b"time", b"")
    try:
        return str(table["trip"][-1].as_py()), float(told)
    except ValueError:
        return None
