"""`pulsempc live` as a process: it answers, two may watch, and at the end nothing is left."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("viser")


@contextmanager
def running(folder, environment, *options):
    process = subprocess.Popen(
        [sys.executable, "-m", "bench", "live", "paper", "--duration", "2", *options],
        cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        line = process.stderr.readline()
        found = re.search(r"http://(127\.0\.0\.1):(\d+)", line)
        assert found, line + process.stderr.read()
        yield process, int(found[2])
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def alive_in(session):
    """Processes of a session that are no zombies."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, of = stat.read_text().rsplit(")", 1)[1].split()[:4]
        except OSError:
            continue
        if int(of) == session and state != "Z":
            found.append(int(stat.parent.name))
    return found


def gone(session, patience=20.0):
    until = time.monotonic() + patience
    while alive_in(session):
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


def refused(folder, environment, *options):
    done = subprocess.run(
        [sys.executable, "-m", "bench", "live", *options], cwd=folder, env=environment,
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("pulsempc: ")
    return done.stderr


def test_it_answers_and_leaves_nothing(tmp_path, environment):
    with running(tmp_path, environment) as (process, port):
        for _ in range(2):
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=10) as page:
                assert b"<html" in page.read().lower()
        assert len(alive_in(process.pid)) >= 2
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does it: to all of them
        assert process.wait(20) == 130
        out, err = process.communicate()
        assert (out, err) == ("", "")
        assert gone(process.pid)
        with socket.socket() as again:
            again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            again.bind(("127.0.0.1", port))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_where_it_is_killed(tmp_path, environment):
    with running(tmp_path, environment) as (process, _):
        process.kill()
        assert gone(process.pid)


def test_nobody_else_is_let_in(tmp_path, environment):
    with (
        running(tmp_path, environment) as (_, port),
        socket.socket() as other,
        pytest.raises(OSError, match="refused"),
    ):
        other.connect(("127.0.0.2", port))


def test_it_is_told_where_the_experiment_dies(tmp_path, environment):
    with running(tmp_path, environment) as (process, _):
        for child in alive_in(process.pid):
            command = Path(f"/proc/{child}/cmdline").read_bytes()
            if child != process.pid and b"spawn_main" in command:
                os.kill(child, signal.SIGKILL)
        assert process.wait(20) == 2
        assert "ended by itself" in process.communicate()[1]


def test_a_port_that_is_taken(tmp_path, environment):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"--port {port}: cannot listen" in refused(
            tmp_path, environment, "--port", str(port)
        )


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--port", "70000"), "between 0 and 65535"),
        (("--host", "no.such.host.invalid"), "cannot listen there"),
        (("papr",), "papr"),
        (("--controller", "nope"), "unknown controller"),
        (("--backend", "nope"), "unknown backend"),
        (("--set", "cell.contact.stiffness=-1"), "greater than 0"),
    ],
)
def test_bad_input_is_told_in_a_line(tmp_path, environment, options, word):
    assert word in refused(tmp_path, environment, *options)


def test_without_viser_it_says_what_to_install(tmp_path, environment):
    (tmp_path / "viser.py").write_text("raise ImportError\n")
    path = f"{tmp_path}{os.pathsep}{environment.get('PYTHONPATH', '')}"
    told = refused(tmp_path, environment | {"PYTHONPATH": path})
    assert "pip install 'pulsempc[live]'" in told
