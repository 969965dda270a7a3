"""docs/reference/commands.md matches the parser."""

from bench.maintenance import commands_page


def test_the_document_is_up_to_date():
    assert commands_page.TARGET.read_text() == commands_page.commands_page(), "run bench.maintenance.commands_page"


def test_every_option_is_listed():
    page = commands_page.commands_page()
    assert page.count("\n## ") >= 10
    for option in ("--integrator", "--drop-strays", "--seconds", "--memory", "--json", "--splats"):
        assert f"`{option}" in page, option
