"""Examples run as they are printed."""

import doctest
import re
import shutil
import subprocess
import sys

import pytest
from conftest import ROOT

import octrace
import octrace.trimesh_ray


@pytest.fixture
def folder(tmp_path, monkeypatch, bunny_obj):
    """A folder with nothing in it but the bunny, and a mesh of the name that the README has made before."""
    shutil.copy(bunny_obj, tmp_path)
    shutil.copy(bunny_obj, tmp_path / "planet.obj")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_docs(folder):
    pytest.importorskip("trimesh")
    done = doctest.testfile(str(ROOT / "docs" / "PYTHON.md"), module_relative=False)
    assert done.attempted > 20 and done.failed == 0


@pytest.mark.parametrize("module", [octrace, octrace.trimesh_ray])
def test_the_modules(folder, module):
    pytest.importorskip("trimesh")
    done = doctest.testmod(module)
    assert done.attempted >= 5 and done.failed == 0


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "tools" / "python" / "README.md"])
def test_the_readmes(folder, page):
    pytest.importorskip("trimesh")
    programs = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    assert programs
    for program in programs:
        done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
