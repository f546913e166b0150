"""The Python blocks of the book and of README.md run as they stand, in a folder that has what the pages speak of."""

import re
import shutil

import pytest
from conftest import BENDING, ROOT

import snakeloop


def blocks(path):
    return re.findall(r"^```python\n(.*?)^```", path.read_text(), flags=re.MULTILINE | re.DOTALL)


def uses_the_package(page):
    return any(re.search("^import .*snakeloop", block, flags=re.MULTILINE) for block in blocks(page))


ALL = [ROOT / "python/README.md", *sorted((ROOT / "docs/src").rglob("*.md"))]
PAGES = [page for page in ALL if uses_the_package(page)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("book")
    (folder / "fixtures").symlink_to(ROOT / "fixtures")
    (folder / "EXPERIMENT").symlink_to(BENDING)
    snakeloop.run(folder / "EXPERIMENT", folder / "out")
    (folder / "loaded").mkdir()
    for here in ["m.csv", "loaded/measurements.csv"]:
        shutil.copy(folder / "out/measurements.csv", folder / here)
    for here in ["e.csv", "loaded/encoders.csv"]:
        shutil.copy(BENDING / "encoders.csv", folder / here)
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_run(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {}
    for block in blocks(page):
        exec(compile(block, page, "exec"), names)


def test_pages_that_show_a_command_show_the_python_beside_it():
    expected = {"tutorial.md", "python.md", "discover.md", "command-from-c.md", "another-robot.md", "verdict.md", "real-robots.md"}
    expected |= {"flexible-stem.md", "loads.md", "straight-picture.md", "choose-an-experiment.md", "logs.md"}
    assert expected <= {page.name for page in PAGES}
