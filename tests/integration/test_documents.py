"""Documents: paths and links in them exist, and ARCHITECTURE.md matches the rooms."""

import ast
import re
from pathlib import Path

import pytest

from helpers.architecture import PACKAGE, TOWER, arrows
from helpers.places import ROOT

MOST_LINES = 162  # of ARCHITECTURE.md
ARCHITECTURE = (ROOT / "ARCHITECTURE.md").read_text()
DOCUMENTS = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
]
OF_THE_CODE = [
    path for path in DOCUMENTS if path.name not in ("README.md", "CHANGELOG.md") or path.parent.name == "decisions"
]
# What looks like a path of code, of a document, or of a folder.
PATH = re.compile(r"[\w.-]+(?:/[\w.-]+)*(?:\.(?:py|md|js|cpp)|/)")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def title(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def paths_in(text: str) -> set[str]:
    """The paths that are named in backticks."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return {name for name in re.findall(r"`([^`]+)`", prose) if PATH.fullmatch(name)}


def programs_in(text: str) -> set[str]:
    """The paths of the programs of `bench/` that are named as files or as modules."""
    modules = re.findall(r"-m (bench(?:\.\w+)+)", text)
    return {*re.findall(r"bench/[\w/]+\.py", text), *(f"{module.replace('.', '/')}.py" for module in modules)}


def missing(names: set[str]) -> list[str]:
    """Paths that exist neither in the package nor in the project."""
    return sorted(name for name in names if not ((PACKAGE / name).exists() or (ROOT / name).exists()))


def anchors(text: str) -> set[str]:
    """The anchors of a document that links may name: its headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def rooms() -> list[tuple[str, list[str]]]:
    """The rows of the table of rooms: name, and what it may import."""
    table = ARCHITECTURE.split("## The rooms")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("| `")]
    return [(row[0].strip("`/").removesuffix(".py"), re.findall(r"[a-z_]+", row[2])) for row in rows]


def test_the_checks_detect_errors():
    assert (
        missing(paths_in("`surface/tree/build.py`, `tree/build.p`, `bench/`, `docs/decisions/tree.md`, `x = 1`")) == []
    )
    assert missing(paths_in("`tree/built.py`, `house/`, `bench/none.py`")) == [
        "bench/none.py",
        "house/",
        "tree/built.py",
    ]
    programs = programs_in("python -m bench.tracing.embree --size 2, `bench/none.py`, `python -m bench.tracing.none`.")
    assert missing(programs) == ["bench/none.py", "bench/tracing/none.py"]
    assert anchors("# Its own server, instead of viser\n") == {"its-own-server-instead-of-viser"}


def test_the_architecture_is_short():
    assert len(ARCHITECTURE.splitlines()) <= MOST_LINES


def test_the_table_lists_the_rooms_in_order():
    assert [name for name, _ in rooms()] == TOWER


def test_rooms_import_exactly_what_the_table_lists():
    may = dict(rooms())
    for file, imported in arrows().items():
        room = file.split(".")[0]
        others = {name.split(".")[0] for name in imported} & set(TOWER) - {room}
        assert others <= set(may[room]), f"{file} imports {others - set(may[room])}"


@pytest.mark.parametrize("document", OF_THE_CODE, ids=title)
def test_every_path_exists(document: Path):
    assert missing(paths_in(document.read_text())) == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=title)
def test_every_script_of_a_command_exists(document: Path):
    assert missing(programs_in(document.read_text())) == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=title)
def test_every_link_has_a_target(document: Path):
    for link in LINK.findall(document.read_text()):
        if link.startswith(("http:", "https:")):
            continue
        path, _, anchor = link.partition("#")
        target = document.parent / path if path else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target.read_text()), link


def test_every_document_is_listed():
    folder = ROOT / "docs" / "decisions"
    listed = re.findall(r"^\| \[(\S+\.md)\]", (folder / "README.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(path.name for path in folder.glob("*.md") if path.name != "README.md")


def modules_in(text: str) -> set[str]:
    """Return the modules that a folder's docstring lists: `a, b : what they do; c : what it does`."""
    lists = re.findall(r"(?:^|; )([a-z_0-9]+(?:, [a-z_0-9]+)*) : ", text, re.MULTILINE)
    return {name for names in lists for name in names.split(", ")}


def test_the_docstring_of_each_folder_lists_its_modules():
    assert modules_in("Rooms.\n\na, b : this; c : that\nBegin with a: it is short.") == {"a", "b", "c"}
    for path in PACKAGE.rglob("__init__.py"):
        text = ast.get_docstring(ast.parse(path.read_text())) or ""
        here = {other.stem for other in path.parent.glob("*.py") if not other.name.startswith("_")}
        here |= {other.parent.name for other in path.parent.glob("*/__init__.py")}
        named = modules_in(text)
        assert named <= {other.stem for other in path.parent.iterdir()}, f"{path.parent.name}: {named - here}"
        missing = {name for name in here if not re.search(rf"\b{name}\b", text)}
        assert path.parent == PACKAGE or not missing, f"{path.parent.name}: {missing}"
