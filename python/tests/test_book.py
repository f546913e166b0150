"""The Python blocks of the book and of README.md run as they stand, from the repository's folder."""

import re

import pytest
from conftest import ROOT

PAGES = ["docs/src/how-to/python.md", "python/README.md"]


@pytest.mark.parametrize("page", PAGES)
def test_the_blocks_of_a_page_run(page, monkeypatch):
    text = (ROOT / page).read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    assert blocks
    monkeypatch.chdir(ROOT)
    names = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
