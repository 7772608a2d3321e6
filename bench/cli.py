"""The command line: ``pulsempc run``, ``pulsempc scenarios``, ``pulsempc backends``."""

import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from bench import ownership
from bench.figures import draw_forces
from bench.progress import Reporter, ctrl_c
from bench.table import backend_table, force_table, scenario_table, timing_lines
from plant.errors import PlantError
from qpmpc.backends import available, backend_class
from qpmpc.errors import QpmpcError
from scenarios import Scenario, load_scenario, run_experiment, shipped, summarise
from scenarios.errors import ScenarioError
from scenarios.results import check_target, to_json, write_run

BAD_INPUT, INTERRUPTED = 2, 130


def run(
    scenario: tyro.conf.Positional[str] = "paper",
    /,
    *,
    backend: str | None = None,
    motion: Path | None = None,
    beats: Path | None = None,
    duration: float | None = None,
    seed: int | None = None,
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = (),
    out: Path | None = None,
    json: bool = False,
) -> int:
    """Run a scenario and write its results into a folder.

    For example, `pulsempc run paper --backend analytic --seed 3 --out runs/seed3`, or
    `pulsempc run my.toml --motion heart.csv --set cell.sensor.model=mini45`.

    Args:
        scenario: Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file.
        backend: Solver, see `pulsempc backends`.
        motion: CSV file with columns t, x, y, z [s, m]: a recorded motion in place of the
            generated one.
        beats: CSV file with a column t [s]: times of heart beats that drive the generated motion.
        duration: Simulated time [s].
        seed: Of motion and sensor noise.
        set: Change one key of the scenario, key.path=value in TOML's notation; may be repeated.
        out: Folder for the results, new or empty; runs/<scenario>-<time> if not given.
        json: Print the summary as JSON, and nothing else, on standard output.
    """
    top = {"backend": backend, "duration": duration, "seed": seed}
    loaded = load_scenario(
        scenario,
        top={key: value for key, value in top.items() if value is not None},
        motion=motion,
        beats=beats,
        settings=set,
    )
    backend_class(loaded.backend)  # an unknown one is told before anything else is done
    folder = out if out is not None else _default_folder(loaded)
    check_target(folder)
    with Reporter(quiet=json) as reporter, ctrl_c() as interrupt:
        experiment = run_experiment(loaded, report=reporter, stop=interrupt)
        summary = summarise(experiment)
        write_run(
            experiment,
            summary,
            folder,
            lambda partial: draw_forces(experiment.log, partial / "forces.png"),
        )
    if json:
        sys.stdout.write(to_json(summary))
    else:
        console = Console()
        console.print(force_table(summary))
        for line in timing_lines(summary):
            console.print(line, highlight=False)
        console.print(f"results: {folder}", highlight=False, soft_wrap=True)
    if experiment.complete:
        return 0
    done, total = experiment.log.cycles, loaded.cycles
    print(
        f"interrupted after {done} of {total} controlled cycles; "
        f"what was done until then is in {folder}",
        file=sys.stderr,
    )
    return INTERRUPTED


def scenarios() -> int:
    """List the scenarios that are shipped.

    For example, `pulsempc scenarios`.
    """
    Console().print(scenario_table(load_scenario(name) for name in shipped()))
    return 0


def backends() -> int:
    """List the solver backends: which are installed, which version, what installs the others.

    For example, `pulsempc backends`.
    """
    Console().print(backend_table(available()))
    return 0


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code: 0, 2 for bad input, 130 for Ctrl-C."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    foreign = ownership.foreign_owners()
    if foreign:
        claims = "; ".join(f"'{root}' by {', '.join(names)}" for root, names in foreign.items())
        _fail(
            f"import packages of pulsempc are claimed by other distributions: {claims}. "
            f"pip uninstall {' '.join(sorted({n for names in foreign.values() for n in names}))} "
            "and reinstall pulsempc, or use an environment of its own"
        )
    try:
        code = tyro.extras.subcommand_cli_from_dict(
            {"run": run, "scenarios": scenarios, "backends": backends},
            prog="pulsempc",
            description="Predictive force control of a robot on a beating heart, simulated.",
            args=_one_setting_each(given),
        )
    except (QpmpcError, PlantError, ScenarioError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        print("pulsempc: interrupted; nothing was written", file=sys.stderr)
        sys.exit(INTERRUPTED)
    sys.exit(code)


def _fail(message: str) -> None:
    print(f"pulsempc: {message}", file=sys.stderr)
    sys.exit(BAD_INPUT)


def _one_setting_each(arguments: list[str]) -> list[str]:
    """Let ``--set a=1 b=2`` mean ``--set a=1 --set b=2``."""
    result: list[str] = []
    collecting = False
    for argument in arguments:
        if collecting and not argument.startswith("-") and "=" in argument:
            if result[-1] != "--set":
                result.append("--set")
        else:
            collecting = argument == "--set"
        result.append(argument)
    return result


def _default_folder(scenario: Scenario) -> Path:
    return Path("runs") / f"{scenario.name}-{datetime.now():%Y%m%d-%H%M%S}"
