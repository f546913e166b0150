"""The stubs say what the package has: names, arguments, defaults."""

import subprocess
import sys

import pytest


def test_the_stubs_agree_with_the_package(tmp_path):
    pytest.importorskip("mypy")
    call = [sys.executable, "-m", "mypy.stubtest", "snakeloop"]
    found = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr
