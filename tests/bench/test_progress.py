"""Progress on standard error, and a Ctrl-C that ends a run in order."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from bench.progress import Reporter, ctrl_c


def report(quiet, capsys) -> str:
    with Reporter(quiet=quiet) as reporter:
        reporter("setup", 0, 1)
        for done in range(0, 1001, 10):
            reporter("compensated", done, 1000)
        reporter("uncompensated", 0, 7)
        reporter("uncompensated", 7, 7)
    said = capsys.readouterr()
    assert said.out == ""
    return said.err


def test_off_a_terminal_every_tenth_is_a_line(capsys):
    lines = report(False, capsys).splitlines()
    assert lines[0] == "setup ..."
    assert lines[1:12] == [f"compensated: {p} %" for p in range(0, 101, 10)]
    assert lines[12:] == ["uncompensated: 0 %", "uncompensated: 100 %"]


def test_quiet_says_nothing(capsys):
    assert report(True, capsys) == ""


def test_the_first_ctrl_c_asks_the_second_interrupts():
    before = signal.getsignal(signal.SIGINT)
    with ctrl_c() as interrupt:
        assert not interrupt()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt()
        assert interrupt.pressed
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_the_handler_is_put_back_after_an_exception():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), ctrl_c() as interrupt:
        1 / interrupt.pressed
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("own_thread", [True, False])
def test_a_bar_without_a_thread_moves_when_it_is_told(own_thread, monkeypatch, capsys):
    """A thread takes the interpreter from a loop that is being timed."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    monkeypatch.setenv("TERM", "xterm")
    before = threading.active_count()
    with Reporter(quiet=False, own_thread=own_thread) as reporter:
        reporter("cycles", 0, 1000)
        assert threading.active_count() == before + own_thread
        capsys.readouterr()
        reporter("cycles", 500, 1000)
        if not own_thread:
            assert "50 %" in capsys.readouterr().err
