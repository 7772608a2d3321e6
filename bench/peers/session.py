"""One adapter at work: a process in the peer's environment that makes a pass when told to."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.peers.failure import PeerFailure, last_words

HARNESS = Path(__file__).parent / "adapters" / "_harness.py"


class Session:
    """A peer that is set up and waits; use as a context, so that the process ends with it."""

    def __init__(
        self,
        python: Sequence[str],
        adapter: Path,
        task: Path,
        folder: Path,
        variant: str,
        *,
        environment: Mapping[str, str],
        limit: float,
    ) -> None:
        """Start the process; `ready` waits for it.

        Args:
            python: the peer's interpreter and its flags.
            adapter, task: see ``adapters/_harness.py``.
            folder: its working directory, where it may leave generated code.
            variant: of the adapter.
            environment: variables of the process.
            limit: seconds that set-up, and each pass, may take.
        """
        self._limit = limit
        folder.mkdir(parents=True, exist_ok=True)
        self._errors = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115
        self._result = folder / "result.npz"
        self._result.unlink(missing_ok=True)
        self._process = subprocess.Popen(
            [*python, str(HARNESS), str(adapter), str(task), str(self._result), variant],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            cwd=folder,
            env=dict(environment),
            start_new_session=True,  # so that compilers it starts end with it
        )
        self._selector = selectors.DefaultSelector()
        assert self._process.stdout is not None
        self._selector.register(self._process.stdout, selectors.EVENT_READ)
        self._received = b""

    def ready(self) -> dict[str, Any]:
        """Wait for set-up; return what the harness told: ``python``, ``versions``.

        Raises:
            PeerFailure: it ended, or did not come to an end in time.
        """
        return self._answer("set-up")

    def make_pass(self) -> float:
        """Let the peer solve every instance once; return the seconds that took on its clock.

        Raises:
            PeerFailure: see `ready`.
        """
        self._say(b"pass\n")
        return float(self._answer("pass")["seconds"])

    def finish(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """End the process; return times ``(passes, K)`` [ns] and increments ``(passes, K, n_u)``.

        Raises:
            PeerFailure: it left no result.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait(timeout=self._limit)
        except (OSError, subprocess.TimeoutExpired):
            raise PeerFailure("did not end after the last pass") from None
        try:
            with np.load(self._result, allow_pickle=False) as file:
                times, increments = file["times"], file["increments"]
        except (OSError, ValueError, KeyError):
            raise PeerFailure(self._last("left no result")) from None
        return times, increments

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()
        self._selector.close()

    def _say(self, line: bytes) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except BrokenPipeError:
            raise PeerFailure(self._last("ended by itself")) from None

    def _answer(self, what: str) -> dict[str, Any]:
        end = monotonic() + self._limit
        while b"\n" not in self._received:
            left = end - monotonic()
            if left <= 0 or not self._selector.select(left):
                raise PeerFailure(f"{what} took longer than {self._limit:g} s")
            assert self._process.stdout is not None
            chunk = os.read(self._process.stdout.fileno(), 65536)
            if not chunk:
                code = self._process.wait()
                raise PeerFailure(self._last(f"ended in {what} with exit code {code}"))
            self._received += chunk
        line, _, self._received = self._received.partition(b"\n")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise PeerFailure(f"{what}: said something that is no answer")
        return answer

    def _last(self, what: str) -> str:
        self._errors.seek(0)
        words = last_words(self._errors.read())
        return f"{what}: {words}" if words else what
