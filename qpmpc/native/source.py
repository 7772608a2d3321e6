"""The C text of a controller's step, and the numbers that it reads.

Sizes are constants of the text, so that the compiler unrolls; numbers are not in it but in one
structure for each group. So a controller with other weights, another model of the same size or
other bounds finds its text compiled already, and equal axes share one structure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qpmpc.native.forms import CompiledForm, c_text
from qpmpc.native.groups import Group, Whole
from qpmpc.native.pack import (
    Bytes,
    Field,
    across,
    blocks,
    columns,
    declaration,
    image,
    integers,
    plain,
    stacked,
)

_ROUNDING = 1e-13
"""Share of a structure's member by which equal axes may differ and still be one."""


@dataclass(frozen=True, eq=False)
class Program:
    """What a compiled step is made of."""

    text: str
    """One C translation unit."""
    constants: list[Bytes]
    """Of each group; groups that are equal share theirs."""
    maps: list[Bytes]
    """Of each group: where its parts are in the whole."""


@dataclass(frozen=True, eq=False)
class _Kind:
    """Groups of one shape."""

    sizes: Mapping[str, int]
    constants: Sequence[Field]
    maps: Sequence[Field]

    @property
    def shape(self) -> tuple[object, ...]:
        fields = tuple((f.name, f.type, f.count) for f in (*self.constants, *self.maps))
        return (*sorted(self.sizes.items()), *fields)


def write(
    whole: Whole, found: Sequence[Group], form: CompiledForm, figures: Mapping[str, object]
) -> Program:
    """Write the program of a controller.

    Args:
        whole, found: the controller's parts, and its groups.
        form: how its backend solves.
        figures: macros beside those of the sizes, as C numbers.
    """
    problem = whole.problem
    macros = {
        "STATES": problem.model.n_states,
        "INPUTS": problem.model.n_inputs,
        "MEASURED": whole.observer.gain.shape[1],
        "OUTPUTS": problem.model.n_outputs,
        "HORIZON": problem.horizon,
        "MOVES": problem.moves,
        "ROWS": problem.qp.m,
        "INCREMENT": int(problem.decision == "increment"),
        "HEEDED": int(form.heeds_rows),
    } | dict(figures)
    text = [_defines(macros), c_text("common.h"), form.preamble]
    shapes: list[tuple[object, ...]] = []
    members, calls = [], []
    constants: list[tuple[int, _Kind, Bytes]] = []
    maps = []
    for i, group in enumerate(found):
        one = _Kind(_sizes(group) | dict(form.sizes(group)), _constants(group, form), _maps(group))
        if one.shape not in shapes:
            shapes.append(one.shape)
            text.append(_kind_text(len(shapes) - 1, one, form))
        kind = shapes.index(one.shape)
        members.append(f"  struct group_{kind} group_{i};")
        calls.append(f"A({kind}, {i})")
        constants.append((kind, one, _shared(kind, one, constants)))
        maps.append(image(one.maps))
    text += [
        "\n".join(["struct memory {", "  struct shared shared;", *members, "};\n"]),
        f"#define EACH(A) {' '.join(calls)}\n",
        c_text("main.c"),
    ]
    return Program("\n".join(text), [each for _, _, each in constants], maps)


def _shared(kind: int, one: _Kind, before: Sequence[tuple[int, _Kind, Bytes]]) -> Bytes:
    """Return the structure of an equal group before, or a new one."""
    for other, known, memory in before:
        if other == kind and all(
            _alike(a.data, b.data) for a, b in zip(known.constants, one.constants, strict=True)
        ):
            return memory
    return image(one.constants)


def _alike(a: np.ndarray, b: np.ndarray) -> bool:
    if a.size == 0:
        return True
    return bool(np.abs(a - b).max() <= _ROUNDING * np.abs(a).max())


def _kind_text(number: int, kind: _Kind, form: CompiledForm) -> str:
    structure = f"_{number}"
    return "\n".join(
        [
            _defines({"KIND": number} | dict(kind.sizes)),
            c_text("kind.h") if number == 0 else "",
            declaration(f"constants{structure}", kind.constants),
            declaration(f"maps{structure}", kind.maps),
            form.text,
            c_text("group.c"),
        ]
    )


def _defines(macros: Mapping[str, object]) -> str:
    return "".join(f"#undef {name}\n#define {name} {value}\n" for name, value in macros.items())


def _sizes(group: Group) -> dict[str, int]:
    qp = group.whole.problem.qp
    return {
        "NX": group.states.size,
        "NU": group.inputs.size,
        "NM": group.measured.size,
        "NY": group.outputs.size,
        "NR": group.rows.size,
        "SOFT": int(np.isfinite(qp.linear[group.rows]).any()),
    }


def _maps(group: Group) -> list[Field]:
    return [
        integers("state", group.states),
        integers("input", group.inputs),
        integers("measured", group.measured),
        integers("output", group.outputs),
        integers("row", group.rows),
    ]


def _constants(group: Group, form: CompiledForm) -> list[Field]:
    whole, x, z, rows = group.whole, group.states, group.decision, group.rows
    problem, observer, scaling = whole.problem, whole.observer, whole.scaling
    qp, maps, p = problem.qp, problem.maps, group.parameters
    n_u = group.inputs.size
    gain = observer.gain[np.ix_(x, group.measured)]
    head = np.hstack(
        [
            np.vstack(
                [
                    observer.measured[np.ix_(group.measured, x)],
                    problem.model.C[np.ix_(group.outputs, x)],
                ]
            ),
            np.zeros((group.measured.size + group.outputs.size, n_u)),
        ]
    )
    respond = stacked([head, maps.free[np.ix_(group.free, p)], maps.rows[np.ix_(rows, p)]])
    gradient = maps.gradient[np.ix_(z, group.free)]
    back = scaling.c * group.back.T
    A = qp.A[np.ix_(rows, z)]
    hard = np.isinf(qp.linear[rows])

    def soft(penalty: np.ndarray) -> np.ndarray:
        return np.where(hard, 0.0, penalty[rows])

    return [
        columns(
            "advance", np.hstack([observer.A[np.ix_(x, x)], observer.B[np.ix_(x, group.inputs)]])
        ),
        columns("respond", respond),
        columns("correct", gain),
        columns("innovate", respond[:, : x.size] @ gain),
        columns("gradient", gradient),
        columns("whitened", back @ gradient),
        columns("hessian", qp.P[np.ix_(z, z)]),
        columns("theta", problem.prediction.Theta[np.ix_(group.free, z)]),
        columns("scaled_gradient", back),
        columns("rows", A),
        across("rows_across", A),
        blocks("row_scale", scaling.E[rows]),
        blocks("hard", hard.astype(np.float64)),
        blocks("linear", soft(qp.linear)),
        blocks("quadratic", soft(qp.quadratic)),
        blocks("linear_scaled", soft(scaling.qp.linear)),
        blocks("quadratic_scaled", soft(scaling.qp.quadratic)),
        plain("multiplier", np.array([1.0 / scaling.c])),
        *form.constants(group),
    ]
