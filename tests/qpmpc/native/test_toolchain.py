"""Compile, cache, refuse: what is loaded is what was compiled, by this user, and whole."""

from __future__ import annotations

import ctypes
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from qpmpc.native import (
    CacheError,
    CompilationError,
    CompilerUnavailableError,
    compile_library,
    toolchain,
)

TEXT = "double twice(double x) {{ return {factor} * x; }}\n"
TWICE = TEXT.format(factor="2.0")


def twice(library, x: float) -> float:
    function = library.handle.twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function(x)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    path = tmp_path / "cache"
    monkeypatch.setenv("PULSEMPC_CACHE", str(path))
    return path


@pytest.fixture
def counted(monkeypatch):
    """How often the compiler ran."""
    runs = []
    original = toolchain._compile

    def counting(*arguments):
        runs.append(arguments)
        original(*arguments)

    monkeypatch.setattr(toolchain, "_compile", counting)
    return runs


def test_the_second_load_does_not_compile(counted):
    first, second = compile_library(TWICE), compile_library(TWICE)
    assert (first.compiled, second.compiled, len(counted)) == (True, False, 1)
    assert twice(second, 21.0) == 42.0
    assert first.path == second.path


@pytest.mark.parametrize(
    "other",
    [
        {"source": TEXT.format(factor="2.00")},
        {"flags": ("-O1",)},
        {"depends": ["a library 1.1"]},
        {"libraries": ()},
    ],
)
def test_other_content_is_another_library(other, counted):
    first = compile_library(TWICE)
    second = compile_library(**({"source": TWICE} | other))
    assert first.path != second.path
    assert len(counted) == 2


def test_parts_of_the_key_do_not_run_into_each_other():
    one = compile_library(TWICE, depends=["ab", "c"])
    assert one.path != compile_library(TWICE, depends=["a", "bc"]).path


def test_native_code_of_another_processor_is_another_library(monkeypatch):
    first = compile_library(TWICE)
    plain = compile_library(TWICE, flags=("-O2",))
    monkeypatch.setattr(toolchain, "processor", lambda: "another")
    assert compile_library(TWICE).path != first.path
    assert compile_library(TWICE, flags=("-O2",)).path == plain.path


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
        lambda content: content + b"more",
    ],
    ids=["empty", "cut", "flipped", "longer"],
)
def test_a_damaged_file_is_made_anew(damage, counted):
    path = compile_library(TWICE, name="damaged").path
    content = path.read_bytes()
    path.unlink()  # the file is in this process's memory: it may be replaced, not written over
    path.write_bytes(damage(content))
    again = compile_library(TWICE, name="damaged")
    assert again.compiled
    assert twice(again, 4.0) == 8.0
    assert len(counted) == 2


def test_a_file_in_the_cache_that_others_may_write_to_is_refused():
    path = compile_library(TWICE).path
    path.chmod(0o722)
    with pytest.raises(CacheError, match="others may write"):
        compile_library(TWICE)


def test_the_folder_is_made_for_its_owner_alone_and_nothing_is_left_behind(own_cache):
    path = compile_library(TWICE).path
    assert stat.S_IMODE(own_cache.stat().st_mode) == 0o700
    assert list(own_cache.iterdir()) == [path]


def test_a_folder_that_others_may_write_to_is_refused(own_cache):
    own_cache.mkdir()
    own_cache.chmod(0o777)
    with pytest.raises(CacheError, match=r"others may write to it \(mode 0777\)") as caught:
        compile_library(TWICE)
    assert caught.value.path == own_cache
    assert list(own_cache.iterdir()) == []


def test_a_folder_of_someone_else_is_refused(own_cache, monkeypatch):
    own_cache.mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: own_cache.stat().st_uid + 1)
    with pytest.raises(CacheError, match="belongs to user"):
        compile_library(TWICE)


def test_a_link_in_place_of_the_folder_is_refused(own_cache, tmp_path):
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    own_cache.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CacheError, match="no folder"):
        compile_library(TWICE)


def test_a_folder_that_cannot_be_made_is_told(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PULSEMPC_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(CacheError, match="cannot be made"):
        compile_library(TWICE)


def test_where_the_cache_is(tmp_path, monkeypatch):
    monkeypatch.delenv("PULSEMPC_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert compile_library(TWICE).path.parent == tmp_path / "xdg" / "pulsempc"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert compile_library(TWICE).path.parent == tmp_path / "home" / ".cache" / "pulsempc"


def test_a_text_that_does_not_compile_is_told_in_one_line(own_cache):
    with pytest.raises(CompilationError, match="nonsense") as caught:
        compile_library("int f(void) { return nonsense; }\n")
    assert "\n" not in str(caught.value)
    assert "nonsense" in caught.value.output
    assert list(own_cache.iterdir()) == []


def test_without_a_compiler(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(CompilerUnavailableError, match="cc, gcc, clang"):
        compile_library(TWICE)
    monkeypatch.setenv("CC", "/nonexistent/cc -m64")
    with pytest.raises(CompilerUnavailableError) as caught:
        compile_library(TWICE)
    assert caught.value.tried == ("/nonexistent/cc",)
    assert "CC" in str(caught.value)


def test_a_compiler_that_is_none_is_told(tmp_path, monkeypatch):
    broken = tmp_path / "broken-cc"
    broken.write_text("#!/bin/sh\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(CompilerUnavailableError, match="does not tell its version"):
        compile_library(TWICE)


def test_the_compiler_named_by_cc_is_taken_with_its_words_and_no_shell(tmp_path, monkeypatch):
    real, proof = toolchain.compiler()[0][0], tmp_path / "proof; touch x"
    wrapper = tmp_path / "my cc"
    wrapper.write_text(f'#!/bin/sh\necho "$@" >> "{proof}"\nexec {real} "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", f"'{wrapper}' -DWORD=1")
    assert twice(compile_library(TWICE), 1.0) == 2.0
    assert "-DWORD=1" in proof.read_text()
    assert not Path("x").exists()


def test_two_processes_at_once_both_get_a_whole_library(own_cache):
    code = (
        "import sys, ctypes; from qpmpc.native import compile_library\n"
        f"lib = compile_library({TWICE!r})\n"
        "f = lib.handle.twice; f.restype = ctypes.c_double; f.argtypes = [ctypes.c_double]\n"
        "assert f(3.0) == 6.0\n"
    )
    started = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(4)]
    assert [process.wait(60) for process in started] == [0] * 4
    assert len(list(own_cache.iterdir())) == 1
