"""Line numbers of keys in scene files, compared with a reference that runs tomllib up to each line."""

from __future__ import annotations

import tomllib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from helpers.places import ROOT
from pointray.scenefile import lines
from pointray.scenefile.lines import line_of
from pointray.scenefile.source import Source

LINES = """a.b = 1 # [
"c.d" = '''
[e]
x = 1
''' # '''
'e f'.g = "]#" # "
points = [ # [
  [1, 2,
   3], "''']", # ,
  { k = [4,
  5], "l" = '}' },
  '''
]]''' ,
  \"\"\"a"" \\\\\\"\"\"\"\"\",
  [[6], [
]],
]
last = 2020-01-01 00:00:00

[h.i] # ]
j = [ ]
"k" . l = [[
7]]
[[m]]
[[ m . "n]" ]]
o = ["\\\\"]
[[m."n]"]]
p = 1
o = ""

[m.q]
r = {s = 1, t = [{u = 2}]}
[[m]]
o = [1,
[2, '''
'''],
3]
"""


def naive_line_of(text: str, key: tuple[str | int, ...]) -> int:
    """Return the first line after which the text, truncated at the next valid place, contains the key."""
    while key and not holds(tomllib.loads(text), key):
        key = key[:-1]
    count = text.count("\n") + 1
    for number in range(count) if key else ():
        data = next(data for end in range(number, count + 1) if (data := parsed(text, end)) is not None)
        if holds(data, key):
            return number
    return 0


def holds(data: Any, key: tuple[str | int, ...]) -> bool:
    for part in key:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return False
    return True


@cache
def parsed(text: str, end: int) -> Any:
    """Return the data of the first lines of a text; None if it cannot be truncated there."""
    text = "\n".join(text.split("\n")[:end])
    with suppress(ValueError):
        return tomllib.loads(text)
    return None


def all_keys(data: Any, key: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """All keys in data, at any depth."""
    parts = list(data) if isinstance(data, dict) else list(range(len(data))) if isinstance(data, list) else []
    return [key, *(inner for part in parts for inner in all_keys(data[part], (*key, part)))]


def test_lines_equal_those_of_the_reference() -> None:
    keys = all_keys(tomllib.loads(LINES))
    assert len(keys) > 40
    for key in keys:
        for longer in (key, (*key, 7), (*key, "no")):
            assert line_of(LINES, longer) == naive_line_of(LINES, longer), longer


EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize("name", ["01_statue.toml", "03_area_lights.toml"])
def test_lines_of_keys_in_examples_are_found(name: str) -> None:
    text = (EXAMPLES / name).read_text()
    for key in all_keys(tomllib.loads(text)):
        assert line_of(text, key) == naive_line_of(text, key), key


def test_a_text_that_takes_long_has_no_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scene.toml").write_text("a = [\n" + "  [1, 2, 3],\n" * 2_000 + ']\n[b]\n"c.d" = 3\n')
    source = Source(tmp_path / "scene.toml")
    read, loads = 0, tomllib.loads

    def counting(text: str) -> dict[str, Any]:
        nonlocal read
        read += len(text)
        return loads(text)

    monkeypatch.setattr(tomllib, "loads", counting)
    monkeypatch.setattr(lines, "LIMIT", 10**5)
    assert str(source.error(("b", "c.d"), "is wrong")) == f"{tmp_path}/scene.toml: b.c.d: is wrong"
    assert 0 < read <= 10**5
