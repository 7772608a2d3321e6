"""The code of the documents runs, and prints what they say it prints.

Blocks marked ``python`` or ``sh`` are run, in their order, in a folder that is empty at first.
Notebooks run when the pages are built, by ``make docs``.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from qpmpc.backends import _registry, available

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *(
        page
        for page in sorted((ROOT / "docs").rglob("*.md"))
        if not {"_build", "notebooks"} & set(page.parts)
    ),
]
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A fragment that is not to be run is marked ``py``, or not at all."""
PRINTS = re.compile(r"^ *print\(.*\)  # (.*)$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#:]*)(?:#([^)]*))?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_of_a_page_runs_and_prints_what_it_says(
    page: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    available()  # all there are; what a page adds goes with the page
    monkeypatch.setattr(_registry, "_table", _registry.registered())
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    text = page.read_text(encoding="utf-8")
    for found in BLOCK.finditer(text):
        language, code = found.groups()
        line = text[: found.start()].count("\n") + 2
        if language == "sh":
            _in_a_shell(code, f"{page.name}:{line}")
            continue
        printed = StringIO()
        with redirect_stdout(printed):
            exec(compile("\n" * (line - 1) + code, str(page), "exec"), names)
        assert printed.getvalue().splitlines() == PRINTS.findall(code), f"{page.name}:{line}"


def _in_a_shell(code: str, where: str) -> None:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-e", "-c", code], capture_output=True, text=True, check=False,
        env=os.environ | {"PATH": path},
    )  # fmt: skip
    assert done.returncode == 0, f"{where}: {done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    for path, anchor in LINK.findall(page.read_text(encoding="utf-8")):
        target = page.parent / path if path else page
        assert target.exists(), path
        if anchor:
            headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {_anchor(heading) for heading in headings}, f"{path}#{anchor}"


def test_the_table_of_backends_says_what_their_traits_say() -> None:
    known = {info.name: info for info in available()}
    told: set[str] = set()
    for line in (ROOT / "docs" / "backends.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        names = re.findall(r"`([^`]+)`", cells[0])
        if len(cells) != 5 or not names or names[0] not in known:
            continue
        for name in names:
            told.add(name)
            info = known[name]
            assert cells[2].startswith("yes") == info.warm_starts, f"{name}: warm start"
            if name != "analytic":  # it takes no iteration
                limits = ", ".join(sorted(info.limits)) or "none"
                assert cells[3] == limits, f"{name}: limits"
    assert told == {name for name in known if not name.startswith("qpsolvers")}


def _anchor(heading: str) -> str:
    """What GitHub makes of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
