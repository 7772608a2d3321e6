"""``python -m bench.peers``: arguments, instances, measurement, table."""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from rich.console import Console

from bench.instances import Instances, instances
from bench.peers.catalogue import OURS, PEERS, Peer
from bench.peers.measure import Effort, judge, measure
from bench.peers.report import lines, summary, table
from bench.peers.task import write_task
from bench.stream import record
from plant.errors import PlantError
from qpmpc.errors import QpmpcError
from scenarios import ScenarioError, load_scenario

BAD_INPUT = 2
INTERRUPTED = 130


def main(
    arguments: Sequence[str] | None = None, peers: Sequence[Peer] = PEERS, ours: Peer = OURS
) -> int:
    """Measure and show; return the exit code, or leave with 2 for bad input.

    Args:
        arguments: of the command line; those of the process if not given.
        peers, ours: what can be measured.
    """
    asked = _parser(peers).parse_args(arguments)
    effort = Effort(passes=asked.passes, run=asked.limit)
    try:
        found = _instances(asked.instances, asked.scenario, asked.axes)
        with tempfile.TemporaryDirectory() as scratch:
            task = Path(scratch) / "task.npz"
            write_task(found, task)
            rows = measure([ours, *asked.only], task, asked.folder.resolve(), effort, _tell)
    except (QpmpcError, PlantError, ScenarioError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        print("bench.peers: interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    judged = [judge(row, found) for row in rows]
    if asked.json:
        print(json.dumps(summary(judged, found, effort.passes), indent=2))
    else:
        console = Console(width=None if sys.stdout.isatty() else 150)
        console.print(table(judged))
        for line in lines(judged):
            console.print(line, markup=False, highlight=False)
    return 0


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        _fail(f"{message}; see python -m bench.peers --help")


def _parser(peers: Sequence[Peer]) -> argparse.ArgumentParser:
    known = {peer.name: peer for peer in peers}

    def chosen(text: str) -> list[Peer]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(
                    f"there is no peer '{name}'; there are {', '.join(known)}"
                )
        return [known[name] for name in dict.fromkeys(names)]

    parser = _Parser(prog="python -m bench.peers", description=__doc__)
    parser.add_argument(
        "--only", type=chosen, default=list(peers), metavar="A,B", help="some of the peers"
    )
    parser.add_argument(
        "--instances", type=Path, metavar="FILE.npz", help="recorded instances, not a new recording"
    )
    parser.add_argument("--scenario", default="latency", help="what is recorded otherwise")
    parser.add_argument(
        "--axes", default="z", help="of the recording, such as z or x,y,z; most peers take one"
    )
    parser.add_argument("--passes", type=_positive(int), default=5, help="over all instances")
    parser.add_argument(
        "--limit", type=_positive(float), default=300.0, help="seconds for set-up and each pass"
    )
    parser.add_argument(
        "--folder", type=Path, default=Path(".peers"), help="of environments and generated code"
    )
    parser.add_argument("--json", action="store_true", help="JSON alone on standard output")
    return parser


def _positive(kind: Callable[[str], float]) -> Callable[[str], float]:
    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not 0 < value < math.inf:
            raise argparse.ArgumentTypeError(f"must be positive, got {text}")
        return value

    return read


def _instances(path: Path | None, scenario: str, axes: str) -> Instances:
    if path is not None:
        return Instances.load(path)
    letters = json.dumps(axes.split(","))
    asked = load_scenario(scenario, settings=[f"axes={letters}"])
    stream = record(asked, report=lambda *_: None, stop=lambda: False)
    assert stream is not None
    return instances(stream, asked.controller.horizon)


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _fail(message: str) -> NoReturn:
    print(f"bench.peers: {message}", file=sys.stderr)
    sys.exit(BAD_INPUT)
