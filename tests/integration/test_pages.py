"""The code of README and of all pages of the documentation runs, and their pictures are the stored ones."""

import re
import shlex

import pytest
from PIL import Image

import pointray as pr
from docs.site.inputs import known_scans
from docs.site.pages import DOCS, LANGUAGES, ROOT, Page, all_pages, blocks_of, load_page
from docs.site.pictures import compare, store
from docs.site.run_page import PageError, PageRun, check_installing, check_output
from docs.site.runs import run
from helpers.viewer_client import Browser, view

PAGES = all_pages()
VIEWS = sorted(
    {
        line
        for page in PAGES
        for block in page.blocks
        for line in block.text.replace("\\\n", " ").splitlines()
        if block.language == "sh" and line.startswith("pointray view")
    }
)


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page in PAGES if page.run], ids=lambda page: page.name)
def test_the_code_of_a_page_runs(page: Page):
    result = run(page)
    assert result["problems"] == []
    if result["lacking"] == ["chromium is not installed"]:
        pytest.skip("chromium is not here")
    assert result["lacking"] == []


@pytest.mark.long
@pytest.mark.parametrize("line", VIEWS)
def test_commands_that_view_open_the_viewer(line, tmp_path, monkeypatch):
    arguments = shlex.split(line)[2:]
    scans = [word for word in arguments if re.fullmatch(r"[\w/*.]+\.\w+", word) and not word.startswith("-")]
    for path in [tmp_path / name for name in scans]:
        path.parent.mkdir(exist_ok=True)
        if path.suffix == ".pointray":
            pr.prepare(pr.procedural("statue", 2000), path, in_parts=True)
        else:
            pr.write(path, pr.procedural("statue", 2000))
    monkeypatch.chdir(tmp_path)
    with view(*arguments) as url:
        browser = Browser(url, (40, 30))
        browser.arrive()
        browser.close()


def test_blocks_have_languages_that_are_run_or_only_shown():
    shown = {"text", "console", "none", "powershell", "dockerfile", "yaml", "json", "bibtex"}
    for path in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        for language in re.findall(r"^ *```(\w+)$", path.read_text(), re.MULTILINE):
            assert language in {*LANGUAGES, *shown}, f"{path}: {language}"


def test_every_stored_picture_is_on_a_page():
    on_pages = {picture for page in PAGES for picture in page.pictures}
    assert set((DOCS / "pictures").rglob("*.webp")) <= on_pages


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_belong_to_their_page(page: Page):
    for picture in page.pictures:
        assert picture.parent == DOCS / "pictures" / page.name and picture.suffix == ".webp", picture


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_scans_of_a_page_are_described(page: Page):
    for name in page.scans.values():
        assert {"title", "licence", "source"} <= set(known_scans()[name])


def test_blocks_outputs_and_pictures_of_a_page():
    text = "# A\n```sh\npointray info a.ply\n```\n\n```text\npoints 5\n```\n"
    text += "- b\n  ```python\n  x = 1\n  ```\nno\n```text\n1\n```\n"
    assert [(b.language, b.text, b.line, b.output) for b in blocks_of(text)] == [
        ("sh", "pointray info a.ply\n", 3, "points 5\n"),
        ("python", "x = 1\n", 11, None),
    ]


def test_output_is_compared_without_numbers():
    check_output("points  12,000\n...\nend\n", "points 7\nsize 1e-05\n\nend\n")
    with pytest.raises(PageError, match="other output"):
        check_output("points 12\n", "colors 12\n")


def test_commands_of_installing_name_existing_extras_and_targets():
    check_installing(["pip", "install", "pointray[film,files]"])
    check_installing(["make", "wheel", "SYSTEM=macos-arm64"])
    with pytest.raises(PageError, match="films does not exist"):
        check_installing(["pip", "install", "pointray[films]"])
    with pytest.raises(PageError, match="wheelz does not exist"):
        check_installing(["make", "wheelz"])


def test_pictures_that_differ_are_found(tmp_path):
    shades = Image.linear_gradient("L").resize((400, 300))
    shades.save(tmp_path / "new.png")
    store(tmp_path / "new.png", tmp_path / "old.webp")
    assert compare(tmp_path / "new.png", tmp_path / "old.webp", False) is None
    shades.transpose(Image.Transpose.FLIP_TOP_BOTTOM).save(tmp_path / "new.png")
    assert "differs" in compare(tmp_path / "new.png", tmp_path / "old.webp", True)
    shades.resize((300, 300)).save(tmp_path / "new.png")
    assert "aspect" in compare(tmp_path / "new.png", tmp_path / "old.webp", True)
    assert "not stored" in compare(tmp_path / "new.png", tmp_path / "none.webp", True)


def test_wrong_pages_are_reported(tmp_path, monkeypatch):
    path = DOCS / "wrong_page_of_a_test.md"
    code = "```sh\npointray info none.ply\n```\n```python\nimport none\n```\n```python\nprint(undefined)\n```\n"
    monkeypatch.setattr(type(path), "read_text", lambda self, *_: code + "![a](pictures/wrong/x.webp)\n")
    page = load_page(path)
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    run = PageRun(page, set())
    run.run()
    assert len(run.problems) == 1 and "line 2" in run.problems[0] and "exit status 2" in run.problems[0]
    assert run.lacking == ["No module named 'none'"]


def test_what_blocks_produce_from_stand_ins_is_not_compared(tmp_path):
    blocks = blocks_of(
        "```sh\npointray info a.ply\n```\n```text\nno\n```\n```sh\npointray info b.ply\n```\n```text\nno\n```\n"
    )
    page = Page("a", tmp_path, blocks, [], {"a.ply": "statue", "b.ply": "statue"})
    for absent, lines in ({"a.ply"}, [8]), ({"a.ply", "b.ply"}, []), (set(), [2, 8]):
        run = PageRun(page, absent)
        run._command = lambda arguments: print("yes")
        run.run()
        assert [int(re.search(r"line (\d+)", problem)[1]) for problem in run.problems] == lines


def test_pictures_of_a_build_are_narrower(tmp_path, monkeypatch):
    given = []
    monkeypatch.setattr("docs.site.run_page.execute", lambda arguments: given.append(arguments) or 0)
    run = PageRun(Page("a", tmp_path, [], [], quick={"--size": 256, "--spp": 1}), set())
    for line in "render a --size 1600x1200 --spp 8", "render a", "render a --size=1600x1200", "info a":
        run._command(line.split())
    narrow = ["render a --size 256x192 --spp 1", "render a --size 256x192", "render a --size=1600x1200", "info a"]
    assert [" ".join(arguments) for arguments in given] == narrow


def test_programs_of_a_build_get_more_arguments(tmp_path, monkeypatch, capsys):
    (tmp_path / "say.py").write_text("import sys; print(*sys.argv[1:])")
    monkeypatch.chdir(tmp_path)
    PageRun(Page("a", tmp_path, [], [], quick={"python": 5}), set())._shell("python say.py film.webp")
    assert capsys.readouterr().out.split() == ["film.webp", "5"]


def test_every_public_name_is_in_the_reference():
    text = "".join(path.read_text() for path in (DOCS / "reference" / "api").glob("*.md"))
    documented = set(re.findall(r"^\.\. auto(?:class|function|exception):: (\w+)$", text, re.MULTILINE))
    assert documented == {*pr.__all__, "RaycastingScene"} - {"__version__"}
