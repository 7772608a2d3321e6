"""Tables of margins for the terminal."""

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

Row = dict[str, Any]
_UNBOUNDED = 1e3
"""Gain from which on a margin counts as without end."""


def margin_table(told: dict[str, Any]) -> Table:
    """The loop as it is, and over a range of stiffness and delay."""
    plant = told["plant"]
    table = Table(
        title=f"Margins, scenario {told['scenario']}: model {told['model_stiffness']:g} N/m, true "
        f"{plant['stiffness']:g} N/m",
        box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True, pad_edge=False,
    )  # fmt: skip
    axes = list(told["nominal"]["rms"] or told["lower_bound"]["rms"])
    table.add_column("true\nplant", vertical="bottom", no_wrap=True)
    for heading in (
        "gain\ndown / up", "phase\n[deg]", "delay\n[ms]", "\nMs",
        f"reduction\n{'/'.join(axes)} [%]", "noise\n[mN]", "change\nof u",
    ):  # fmt: skip
        table.add_column(escape(heading), justify="right", no_wrap=True)
    rows = [("the cell", told["nominal"])]
    rows += [(f"K x {row['ratio']:.3g}", row) for row in told["stiffness"]]
    rows += [(f"+{1e3 * row['later']:.3g} ms", row) for row in told["later"]]
    for name, row in rows:
        table.add_row(name, *_cells(row, axes))
    return table


def _cells(row: Row, axes: Sequence[str]) -> list[str]:
    if not row["stable"]:
        return ["unstable", *[""] * 6]
    up = row["gain_up"]
    return [
        f"{row['gain_down']:.2f} / {'-' if up is None or up > _UNBOUNDED else f'{up:.2f}'}",
        _number(row["phase_deg"], ".0f"),
        _number(None if row["delay"] is None else 1e3 * row["delay"], ".2f"),
        f"{row['sensitivity']:.2f}",
        " / ".join(_number(row["reduction"][axis], ".1f") for axis in axes),
        f"{1e3 * row['noise_rms']:.1f}",
        f"{row['increment_rms']:.2f}",
    ]


def margin_lines(told: dict[str, Any]) -> list[str]:
    """Ranges of stability, rejection by frequency, and what nobody can do better."""
    lines = []
    for name, unit, scale in (("stiffness", "N/m", 1.0), ("delay", "ms", 1e3), ("gain", "", 1.0)):
        found = told["stable"][name]
        if found is None:
            lines.append(f"{name}: unstable as it is")
            continue
        low, high = (scale * value for value in found)
        lines.append(f"stable for {name} from {low:.4g} to {high:.4g} {unit}".rstrip())
    rejection = told["nominal"]["rejection"]
    if rejection is not None:
        shares = ", ".join(f"{f} Hz {100 * r:.2g} %" for f, r in rejection.items())
        lines.append(f"left of the tissue's motion: {shares}")
    bound = told["lower_bound"]
    errors = " / ".join(f"{1e3 * value:.2g}" for value in bound["rms"].values())
    lines.append(
        f"no controller that knows no rhythm can do better than {errors} mN RMS on "
        f"{'/'.join(bound['rms'])}: {bound['cycles']} cycles cannot be foreseen"
    )
    return lines


def tuning_lines(changed: dict[str, float], before: Row, after: Row) -> list[str]:
    """What a tuning gained."""
    return [
        f"largest Ms: {_number(before['sensitivity'], '.2f')} before, "
        f"{_number(after['sensitivity'], '.2f')} after",
        f"largest error over that of a tool held still: {before['error']:.3g} before, "
        f"{after['error']:.3g} after",
        "--set " + " ".join(f"controller.{key}={value:g}" for key, value in changed.items()),
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"
