"""All commands and programs of README.md work."""

import re
import shlex
import warnings
from pathlib import Path

import pytest
from PIL import Image

import pointray as pr
from helpers.marks import long
from helpers.places import ROOT
from helpers.viewer_client import Browser, view
from pointray.cli import execute

README = (ROOT / "README.md").read_text()
SMALL = {"points": "points = 5000", "spp": "spp = 1"}  # of the examples
# Words of blocks that take long.
EXPENSIVE = "animate", "path", "--workers", "bake", "--fov", "prepare", "examples/", "--legend", "view"


def blocks(language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the scan and the examples that the README names; it is the current folder."""
    pr.write(tmp_path / "scan.ply", pr.procedural("statue", 2000))
    (tmp_path / "examples").mkdir()
    for path in (ROOT / "examples").glob("*.toml"):
        small = re.sub(r"^(points|spp) = .*", lambda word: SMALL[word[1]], path.read_text(), flags=re.MULTILINE)
        (tmp_path / "examples" / path.name).write_text(small)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def load_film(path: Path) -> None:
    """Load a film; raise an error if it is invalid."""
    import imageio_ffmpeg

    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] > 1


def see(arguments: list[str]) -> None:
    """Load the page of `pointray view`."""
    with view(*arguments) as url:
        browser = Browser(url, (40, 30))
        browser.arrive()
        browser.refined(64)
        browser.close()


def test_the_readme_has_commands_and_programs() -> None:
    assert len(blocks("sh")) >= 3 and len(blocks("python")) >= 2
    assert set(re.findall(r"^```(\w+)", README, re.MULTILINE)) <= {"sh", "python"}


@pytest.mark.parametrize("block", [long(b) if any(word in b for word in EXPENSIVE) else b for b in blocks("sh")])
def test_commands_of_the_readme_run(block: str, folder: Path) -> None:
    lines = block.replace("\\\n", " ").splitlines()
    for line in lines:
        program, *arguments = shlex.split(line, comments=True) or [""]
        assert program == "pointray", f"do not know how to test {line!r}"
        if arguments[0] == "view":
            see(arguments[1:])
            continue
        assert execute(arguments) == 0
        if "-o" in arguments:
            made = folder / arguments[arguments.index("-o") + 1]
            readers = {".ply": pr.read, ".pointray": pr.Model.load, ".mp4": load_film, ".bake": Path.stat}
            readers.get(made.suffix, lambda path: Image.open(path).load())(made)


@pytest.mark.parametrize("block", blocks("python"))
def test_programs_of_the_readme_run(block: str, folder: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        exec(compile(block, "README.md", "exec"), {"__name__": "__main__"})
    for name in re.findall(r'write_image\("([^"]+)"', block):
        Image.open(folder / name).load()


@pytest.mark.parametrize("link", re.findall(r"\]\((?!http)([^)#]+)\)", README))
def test_links_of_the_readme_exist(link: str) -> None:
    assert (ROOT / link).exists()
