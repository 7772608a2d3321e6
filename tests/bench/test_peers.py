"""The runner of peers, shown with small peers of our own: right, wrong, crashing, hanging."""

import json
import os
import py_compile
import subprocess
import sys
import time
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from bench.instances import Instances
from bench.instances import instances as write_out
from bench.peers import command
from bench.peers.catalogue import OURS, PEERS, Peer
from bench.peers.environment import environment
from bench.peers.failure import PeerFailure, last_words
from bench.peers.measure import Effort, Row, bound_size, interpreter, judge, measure
from bench.peers.report import lines, ratio, summary
from bench.peers.session import HARNESS, Session
from bench.peers.task import write_task
from bench.stream import record
from scenarios import ScenarioError, load_scenario

CYCLES = 60

RIGHT = """
import numpy as np
PACKAGES = ()
def exact(task):
    answers = np.load(r"{answers}")
    k = 0
    def step(state, previous, reference, moved):
        nonlocal k
        k += 1
        return answers[k - 1] + {off}
    def begin():
        nonlocal k
        k = 0
    step.begin = begin
    return step
VARIANTS = {{"exact": ("all of it", exact)}}
"""
GAIN = """
import numpy as np
PACKAGES = ("numpy",)
def set_up(task):
    gain = np.linalg.solve(task.P, task.error_to_q)
    def step(state, previous, reference, moved):
        p = np.concatenate([state, previous])
        return -(gain @ (reference.reshape(-1) - task.free_map @ p))[: task.n_u]
    return step
VARIANTS = {"gain": ("no bounds", set_up)}
"""


@pytest.fixture(scope="module")
def recorded() -> Instances:
    scenario = load_scenario("latency", top={"duration": CYCLES * 1e-3}, settings=['axes=["z"]'])
    stream = record(scenario, report=lambda *_: None, stop=lambda: False)
    assert stream is not None
    return write_out(stream, 8)


@pytest.fixture
def task(recorded: Instances, tmp_path: Path) -> Path:
    path = tmp_path / "task.npz"
    write_task(recorded, path)
    return path


@pytest.fixture
def fake(recorded: Instances, tmp_path: Path):
    """Make a peer that runs in our own interpreter, from the text of its adapter."""
    answers = tmp_path / "answers.npy"
    np.save(answers, recorded.decision[:, :1])

    def make(name: str, text: str, *variants: str) -> Peer:
        adapter = tmp_path / f"{name}.py"
        adapter.write_text(dedent(text))
        return Peer(name, adapter, None, variants or ("only",))

    make.right = make("right", RIGHT.format(answers=answers, off=0.0), "exact")
    make.wrong = make("wrong", RIGHT.format(answers=answers, off=0.5), "exact")
    return make


def only(body: str) -> str:
    indented = "\n    ".join(dedent(body).strip().splitlines())
    return (
        "import numpy as np\nPACKAGES = ()\n"
        f"def set_up(task):\n    {indented}\n"
        'VARIANTS = {"only": ("all of it", set_up)}\n'
    )


def judged(peers, task, recorded, tmp_path, **effort):
    rows = measure(peers, task, tmp_path / "peers", Effort(**effort), lambda text: None)
    return [judge(row, recorded) for row in rows]


# What a peer is given


def test_task_gives_the_recorded_qp(recorded, task):
    with np.load(task) as t:
        p = np.hstack([t["state"], t["previous"]])
        error = t["reference"].reshape(len(p), -1) - p @ t["free_map"].T
        np.testing.assert_allclose(error @ t["error_to_q"].T, recorded.q, atol=1e-12)
        np.testing.assert_allclose(
            t["rows"][:, 0] - p @ t["row_map"].T, recorded.l, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_array_equal(np.isfinite(t["rows"][:, 1]), np.isfinite(recorded.u))


def test_task_states_bounds_as_configured(task):
    with np.load(task) as t:
        assert (t["command"][:, 0] == -6).all() or np.allclose(t["command"][:, 0], -6)
        force = t["output"][:, 1, :, 1]
        np.testing.assert_allclose(force[:, 1:], -0.5, atol=1e-9)
        assert not t["kept"][0].any()  # under one cycle of delay the first step is decided
        assert np.isinf(force[:, 0]).all()
        assert np.isinf(t["rate"]).all()
        assert np.flatnonzero(t["moved"]).tolist() == [0]


def test_task_holds_no_answers(recorded, task):
    with np.load(task) as t:
        assert not {"decision", "multipliers", "command_applied", "q"} & set(t.files)
        arrays = [t[key].ravel() for key in t.files if t[key].size == recorded.cycles]
    first = recorded.decision[:, 0]
    assert all(not np.array_equal(array, first) for array in arrays)


def test_task_follows_bounds_that_move(tmp_path):
    cap = [
        "bounds_steps=[{time=0.02, ramp=0.01, force={z=[-9.0, -0.5]}}]",
        'axes=["z"]',
    ]
    scenario = load_scenario("latency", top={"duration": 0.06}, settings=cap)
    stream = record(scenario, report=lambda *_: None, stop=lambda: False)
    assert stream is not None
    write_task(write_out(stream, 8), tmp_path / "task.npz")
    with np.load(tmp_path / "task.npz") as t:
        cap_at_end = t["output"][:, 0, -1, 1]
        assert t["moved"][0]
        assert 5 < t["moved"].sum() < 30
        np.testing.assert_allclose([cap_at_end[0], cap_at_end[-1]], [-12.0, -9.0], atol=1e-9)
        assert (np.diff(cap_at_end) >= -1e-9).all()


def test_task_refuses_what_peers_do_not_know(tmp_path):
    for setting, word in (
        ("controller.decision='absolute'", "increments"),
        ("controller.control_horizon=3", "control horizon"),
    ):
        scenario = load_scenario(
            "latency", top={"duration": 0.01}, settings=['axes=["z"]', setting]
        )
        stream = record(scenario, report=lambda *_: None, stop=lambda: False)
        assert stream is not None
        with pytest.raises(ScenarioError, match=word):
            write_task(write_out(stream, 8), tmp_path / "task.npz")


# Rows


def test_right_and_wrong_are_told_apart(fake, recorded, task, tmp_path):
    right, wrong = judged([fake.right, fake.wrong], task, recorded, tmp_path, passes=2)
    assert right["agreed"] == 1.0
    assert right["error"]["max"] < 1e-12
    assert wrong["agreed"] == 0.0
    assert wrong["error"]["p50"] == pytest.approx(0.5 / 6)
    assert right["answered"] == wrong["answered"] == 1.0
    assert 0 < right["floor_us"]["p50"] <= right["us"]["p50"] <= right["us"]["max"]
    assert right["solves"] == "all of it"
    assert right["reason"] is None


def test_a_gain_is_right_where_no_bound_acts(fake, recorded, task, tmp_path):
    (row,) = judged([fake("gain", GAIN, "gain")], task, recorded, tmp_path, passes=1)
    free = ~recorded.active.any(axis=1)
    assert row["agreed"] >= free.mean() - 1e-12
    assert row["versions"] == {"numpy": np.__version__}


def test_a_wrong_answer_in_one_pass_counts(recorded):
    row = Row(PEERS[0], "x")
    exact = recorded.decision[:, :1]
    row.increments = np.stack([exact, exact, exact])
    row.increments[1, 7] += 1.0
    row.times = np.full((3, len(exact)), 1000)
    result = judge(row, recorded)
    assert result["agreed"] == pytest.approx(1 - 1 / CYCLES)
    row.increments[1, 7] = np.nan
    result = judge(row, recorded)
    assert result["answered"] == result["agreed"] == pytest.approx(1 - 1 / CYCLES)


def test_floor_is_over_passes_of_each_instance(recorded):
    row = Row(PEERS[0], "x")
    row.increments = np.repeat(recorded.decision[None, :, :1], 2, axis=0)
    row.times = np.full((2, CYCLES), 5000)
    row.times[0, 3] = 900_000  # a stall in one pass only
    result = judge(row, recorded)
    assert result["floor_us"]["max"] == 5.0
    assert result["us"]["max"] == 900.0


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise RuntimeError('no such matrix')", "RuntimeError: no such matrix"),
        ("import nothing_of_that_name", "No module named 'nothing_of_that_name'"),
        ("import os; os._exit(7)", "exit code 7"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "exit code -11"),
        ("import time; time.sleep(60)", "set-up took longer than 3 s"),
        (
            """
            def step(*cycle):
                raise ValueError("not positive definite")
            return step
            """,
            "not positive definite",
        ),
        (
            """
            calls = []
            def step(*cycle):
                calls.append(0)
                if len(calls) > 100: import time; time.sleep(60)
                return 0.0
            return step
            """,
            "pass took longer than 3 s",
        ),
        ("return lambda *cycle: np.zeros(3)", "could not broadcast"),
    ],
)
def test_what_fails_gets_a_row_with_the_reason(body, words, fake, task, request):
    recorded, tmp_path = (request.getfixturevalue(n) for n in ("recorded", "tmp_path"))
    broken = fake("broken", only(body))
    rows = judged([broken, fake.right], task, recorded, tmp_path, passes=1, run=3.0)
    assert words in rows[0]["reason"]
    assert "\n" not in rows[0]["reason"]
    assert rows[0]["us"] is rows[0]["agreed"] is None
    assert rows[1]["agreed"] == 1.0  # the others go on
    assert any(words in line for line in lines(rows))


def test_what_packages_print_is_no_answer(fake, recorded, task, tmp_path):
    noisy = fake(
        "noisy",
        only(
            """
            import os
            print('{"seconds": 0}')
            def step(*cycle):
                print("hello"); os.write(1, b"from C\\n")
                return np.nan
            return step
            """
        ),
    )
    (row,) = judged([noisy], task, recorded, tmp_path, passes=1)
    assert row["reason"] is None
    assert row["answered"] == 0.0
    assert row["agreed"] == 0.0


def test_passes_are_taken_in_turn(fake, task, tmp_path):
    log = tmp_path / "order"
    text = only(
        f"""
        import pathlib
        def step(*cycle): return 0.0
        def begin():
            with open(r"{log}", "a") as file: file.write("NAME")
        step.begin = begin
        return step
        """
    )
    peers = [fake(name, text.replace("NAME", name)) for name in "ab"]
    measure(peers, task, tmp_path / "peers", Effort(passes=3), lambda text: None)
    assert log.read_text() == "ab" + "ababab"  # warm-up, then the passes


def test_nothing_is_left_running(fake, task, tmp_path):
    note = tmp_path / "pid"
    hangs = fake(
        "hangs",
        only(
            f"""
            import os, time, subprocess
            child = subprocess.Popen(["sleep", "60"])
            open(r"{note}", "w").write(f"{{os.getpid()}} {{child.pid}}")
            time.sleep(60)
            """
        ),
    )
    measure([hangs], task, tmp_path / "peers", Effort(run=2.0), lambda text: None)
    until = time.monotonic() + 10.0  # who is killed takes a moment to die
    for pid in map(int, note.read_text().split()):
        while running(pid) and time.monotonic() < until:
            time.sleep(0.01)
        assert not running(pid)


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state.rpartition(")")[2].split()[0] != "Z"


# Environments


def test_isolated_peers_do_not_see_our_packages(task, tmp_path, monkeypatch):
    """Caron's package has the import name of ours: no working directory, no PYTHONPATH."""
    root = Path(command.__file__).parents[2]
    monkeypatch.setenv("PYTHONPATH", str(root))
    monkeypatch.chdir(root)
    adapter = tmp_path / "adapter.py"
    adapter.write_text(
        only(
            """
            import sys
            from pathlib import Path
            found = [p for p in sys.path if (Path(p or ".") / "bench").is_dir()]
            raise RuntimeError(f"found {found}")
            """
        )
    )
    bare = tmp_path / "bare"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(bare)], check=True)
    numpy_home = Path(np.__file__).parents[1]
    site = next((bare / "lib").glob("python*/site-packages"))
    for name in ("numpy", "numpy.libs"):
        if (numpy_home / name).exists():
            (site / name).symlink_to(numpy_home / name)
    with (
        Session(
            [str(bare / "bin" / "python"), "-I"],
            adapter,
            task,
            tmp_path / "work",
            "only",
            environment=dict(os.environ),
            limit=30.0,
        ) as session,
        pytest.raises(PeerFailure, match=r"found \[\]"),
    ):
        session.ready()


def test_peers_start_isolated_and_ours_find_us(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setattr("bench.peers.measure.environment", lambda *_, **__: tmp_path / "python")
    python, variables = interpreter(PEERS[0], tmp_path, Effort())
    assert python == [str(tmp_path / "python"), "-I"]
    assert "PYTHONPATH" not in variables
    python, variables = interpreter(OURS, tmp_path, Effort())
    assert python[0] == sys.executable
    assert (Path(variables["PYTHONPATH"]) / "qpmpc" / "force_control.py").is_file()


def test_environment_that_cannot_be_made_says_why(tmp_path):
    requirements = tmp_path / "none.txt"
    requirements.write_text(f"# a comment\n{tmp_path}/no-such-wheel.whl\n")
    with pytest.raises(PeerFailure, match="no-such-wheel"):
        environment(tmp_path / "env", requirements, limit=60.0)
    assert not (tmp_path / "env" / "requirements.installed").exists()


def test_environment_is_made_once(tmp_path):
    requirements = tmp_path / "nothing.txt"
    requirements.write_text("# nothing at all\n")
    python = environment(tmp_path / "env", requirements, limit=60.0)
    mark = tmp_path / "env" / "mark"
    mark.touch()
    assert environment(tmp_path / "env", requirements, limit=60.0) == python
    assert mark.exists()
    requirements.write_text("# something else\n")
    environment(tmp_path / "env", requirements, limit=60.0)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("output", "words"),
    [
        (
            "ERROR: No matching distribution found for x==9\n[notice] new pip\n",
            "ERROR: No matching",
        ),
        ("Traceback\n  File x\nurllib.error.URLError: <no host>\n[pkg] looking\n", "URLError"),
        ("\x1b[31mfatal: gone\x1b[0m\n\n----\n", "fatal: gone"),
        ("", ""),
    ],
)
def test_last_words(output, words):
    assert words in last_words(output)
    assert len(last_words("x: " * 500)) <= 200


# The comparison


def figures(name, ours, agreed, floor):
    numbers = {"p50": floor, "p99": floor, "p999": 2 * floor, "max": 9 * floor}
    return {
        "peer": name, "variant": "", "ours": ours, "versions": {}, "reason": None,
        "us": numbers, "floor_us": numbers, "agreed": agreed,
    }  # fmt: skip


def test_only_those_at_equal_accuracy_are_compared():
    rows = [
        figures("closed form", True, 0.8, 1.0),
        figures("ours", True, 1.0, 2.0),
        figures("sloppy", False, 0.5, 3.0),
        figures("fast", False, 0.98, 30.0),
        figures("slow", False, 1.0, 90.0),
    ]
    found = ratio(rows, 0.95)
    assert found is not None
    assert found["floor_median"] == {"ours": "ours", "peer": "fast", "factor": 15.0}
    strict = ratio(rows, 0.999)
    assert strict is not None
    assert strict["p999"] == {"ours": "ours", "peer": "slow", "factor": 45.0}
    assert ratio(rows[:1] + rows[2:], 0.95) is None
    assert ratio(rows[:3], 0.95) is None


# The command line


def run_main(arguments, capsys, **peers):
    with pytest.raises(SystemExit) as exit_:
        sys.exit(command.main(arguments, **peers))
    return exit_.value.code, capsys.readouterr()


def test_json_has_its_keys(fake, recorded, tmp_path, capsys):
    file = tmp_path / "recorded.npz"
    recorded.save(file)
    arguments = ["--instances", str(file), "--passes", "1", "--json", "--folder", str(tmp_path)]
    broken = fake("broken", only("raise RuntimeError('broken')"))
    code, said = run_main(arguments, capsys, peers=[fake.wrong, broken], ours=fake.right)
    assert code == 0
    result = json.loads(said.out)
    assert set(result) == {"format", "instances", "passes", "rows", "ratio", "machine"}
    assert result["format"] == "pulsempc.peers/1"
    assert result["instances"]["count"] == CYCLES
    assert result["instances"]["axes"] == "z"
    for row in result["rows"]:
        assert set(row) == {
            "peer", "variant", "ours", "solves", "versions", "python", "reason", "us", "floor_us",
            "answered", "agreed", "error",
        }  # fmt: skip
    assert [row["agreed"] for row in result["rows"]] == [1.0, 0.0, None]
    assert result["rows"][2]["reason"].endswith("RuntimeError: broken")


def test_table_names_everybody(fake, recorded, tmp_path, capsys):
    file = tmp_path / "recorded.npz"
    recorded.save(file)
    arguments = ["--instances", str(file), "--passes", "1", "--folder", str(tmp_path)]
    broken = fake("broken", only("raise RuntimeError('broken')"))
    code, said = run_main(arguments, capsys, peers=[fake.wrong, broken], ours=fake.right)
    assert code == 0
    assert "right, exact" in said.out
    assert "100.00%" in said.out
    assert "wrong, exact" in said.out
    assert "no figures: broken, only: ended in set-up" in said.out
    assert "no comparison" in said.out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "nobody"], "there is no peer 'nobody'; there are qpmpc, affine-mpc"),
        (["--only", ""], "there is no peer ''"),
        (["--passes", "0"], "must be positive, got 0"),
        (["--passes", "many"], "must be positive, got many"),
        (["--limit", "-1"], "must be positive, got -1"),
        (["--limit", "nan"], "must be positive"),
        (["--instances", "no_such_file.npz"], "no_such_file.npz"),
        (["--instances", __file__], "not a file of instances"),
        (["--scenario", "no-such-scenario"], "no-such-scenario"),
        (["--axes", "w"], "axes"),
        (["--unknown"], "--unknown"),
    ],
)
def test_bad_arguments_are_told_in_one_line(arguments, words, capsys):
    code, said = run_main(arguments, capsys)
    assert code == 2
    assert said.out == ""
    assert words in said.err
    assert said.err.count("\n") == 1


# Adapters


@pytest.mark.parametrize("peer", [OURS, *PEERS], ids=lambda peer: peer.name)
def test_adapter_has_the_contract(peer, tmp_path):
    text = peer.adapter.read_text()
    py_compile.compile(str(peer.adapter), cfile=str(tmp_path / "x.pyc"), doraise=True)
    assert "PACKAGES = " in text
    assert "VARIANTS = " in text
    assert all(f'"{variant}"' in text for variant in peer.variants)
    if peer.requirements is not None:
        assert "import bench" not in text
        assert "from bench" not in text
        pins = [
            line for line in peer.requirements.read_text().splitlines() if not line.startswith("#")
        ]
        assert pins
        assert all("==" in line for line in pins)


def test_our_rows_agree(recorded, task, tmp_path):
    rows = judged([OURS], task, recorded, tmp_path, passes=1)
    figures = {row["variant"]: row for row in rows}
    assert figures["daqp"]["agreed"] == 1.0
    free = ~recorded.active.any(axis=1)
    assert figures["analytic"]["agreed"] == pytest.approx(free.mean())


def test_harness_needs_nothing_of_ours():
    text = HARNESS.read_text()
    assert "bench" not in [line.split()[1] for line in text.splitlines() if line[:5] == "from "]


def test_bound_size_is_the_commands(recorded):
    assert bound_size(recorded) == 6.0
    assert summary([], recorded, 1)["instances"]["active_share"] >= 0


@pytest.mark.peers
def test_a_real_peer_end_to_end(recorded, tmp_path, capsys):
    file = tmp_path / "recorded.npz"
    recorded.save(file)
    arguments = ["--instances", str(file), "--passes", "1", "--json", "--only", "qpmpc",
                 "--folder", str(tmp_path / "peers")]  # fmt: skip
    code, said = run_main(arguments, capsys)
    assert code == 0
    rows = {row["variant"]: row for row in json.loads(said.out)["rows"] if not row["ours"]}
    assert rows["slack inputs, DAQP"]["agreed"] == 1.0
