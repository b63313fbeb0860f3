"""docs/paper_map.md names symbols and tests that exist, and every equation, algorithm and theorem of the paper."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "paper_map.md").read_text(encoding="utf-8")
SYMBOLS = sorted(set(re.findall(r"`(upslope[\w.]*:\w+)`", TEXT)))
TESTS = sorted(set(re.findall(r"`(tests/[\w/]+\.py)`", TEXT)))
NAMES = [
    "Def. 2.1",
    *(f"Eq. {number}," for number in range(1, 10)),
    *(f"Thm. {number}," for number in ("2.1", "3.1", "3.2")),
    "Algorithm 1,",
    "Algorithm 2,",
    "Fig. 1",
]


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_symbol_exists_and_says_what_it_is(symbol: str) -> None:
    module, name = symbol.split(":")
    found = getattr(importlib.import_module(module), name)
    assert found.__doc__, f"{symbol} has no docstring"


@pytest.mark.parametrize("path", TESTS)
def test_named_tests_exist(path: str) -> None:
    assert (ROOT / path).is_file()


@pytest.mark.parametrize("name", NAMES)
def test_nothing_of_the_paper_is_missing(name: str) -> None:
    rows = [line for line in TEXT.splitlines() if line.startswith(f"| {name}")]
    assert len(rows) == 1
    assert "`" in rows[0], f"{name} maps to nothing"
